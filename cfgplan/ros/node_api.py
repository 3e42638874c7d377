"""The protocol of masters and nodes of ROS 1: calls of their interfaces, and the headers of their connections."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from http.client import HTTPConnection, HTTPException
from typing import Any
from xmlrpc.client import Error, ServerProxy, Transport

from cfgplan.errors import InputError

ANSWER_LIMIT_S = 3.0
"""The most seconds for an answer of a master or node."""
LARGEST_HEADER = 2**20
SUCCESS, FAILURE = 1, 0
"""The status codes that begin an answer."""


class SilentError(Exception):
    """A master or node that gives no answer, or an unusable one."""


class _Limited(Transport):
    """Calls that end after ANSWER_LIMIT_S."""

    def make_connection(self, host: Any) -> HTTPConnection:
        connection: HTTPConnection = super().make_connection(host)
        connection.timeout = ANSWER_LIMIT_S
        return connection


def peer(address: str) -> ServerProxy:
    """A master or node by its address, for one thread. Raises InputError."""
    try:
        return ServerProxy(address, transport=_Limited())
    except OSError:
        mend = "write it as http://host:11311"
        raise InputError.of(f"`{address}` is not the address of a ROS 1 master", mend=mend) from None


def asked(of: ServerProxy, caller: str, method: str, *arguments: object) -> Any:
    """The value that a call of a master's or node's interface gives. Raises SilentError."""
    try:
        code, message, value = getattr(of, method)(caller, *arguments)
    except (OSError, Error, HTTPException, TypeError, ValueError) as error:
        raise SilentError(getattr(error, "strerror", None) or str(error) or type(error).__name__) from None
    if code != SUCCESS:
        raise SilentError(message)
    return value


def header_of(fields: Mapping[str, str]) -> bytes:
    """The header of a connection: its length, then each field with its length."""
    lines = [f"{key}={value}".encode() for key, value in fields.items()]
    header = b"".join(struct.pack("<I", len(line)) + line for line in lines)
    return struct.pack("<I", len(header)) + header


def fields_of_header(header: bytes) -> Iterator[tuple[str, str]]:
    """The fields of a header, without its length. Raises struct.error if it is cut off."""
    while header:
        (size,) = struct.unpack_from("<I", header)
        key, _, value = header[4 : 4 + size].decode(errors="replace").partition("=")
        yield key, value
        header = header[4 + size :]
