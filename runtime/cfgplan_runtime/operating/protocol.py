"""The control protocol's words: lines of JSON over a unix socket in the run's folder (see `manual/control.md`)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict
from typing import Any, TypeAlias

import msgspec

from cfgplan.errors import Fault

VERSION = 1
LONGEST_LINE = 16 << 20
"""The most bytes of a request, and of a reply."""

Record: TypeAlias = "dict[str, Any]"
"""A JSON object."""


class Request(msgspec.Struct, frozen=True):
    """One line from a client; the reply repeats the `id`."""

    method: str
    id: int | str | None = None
    params: dict[str, Any] = msgspec.field(default_factory=dict)
    version: int = VERSION


class RefusedError(Exception):
    """A request that can't be done: the `code` for programs, the rest for people."""

    def __init__(self, code: str, message: str, mend: str | None = None, faults: Iterable[Fault] = ()) -> None:
        super().__init__(message)
        self.code = code
        self.message = message
        self.mend = mend
        self.faults = tuple(faults)


def line(record: Mapping[str, Any]) -> bytes:
    """A record as a line."""
    return msgspec.json.encode(record) + b"\n"


def greeting(run: str, environment: str, pid: int, name: str | None) -> Record:
    """The first line that a server says: the run's id, environment file and process, and its name if it has one."""
    return {"cfgplan_control": VERSION, "run": run, "environment": environment, "pid": pid, "name": name}


def result(request_id: int | str | None, given: Mapping[str, Any]) -> Record:
    """The reply to a request that was done."""
    return {"id": request_id, "result": given}


def refusal(request_id: int | str | None, error: RefusedError) -> Record:
    """The reply to a request that was not done."""
    told: Record = {"code": error.code, "message": error.message, "mend": error.mend}
    if error.faults:
        told["faults"] = [asdict(fault) for fault in error.faults]
    return {"id": request_id, "error": told}


def refused(told: Mapping[str, Any]) -> RefusedError:
    """A refusal as a client reads it."""
    faults = [Fault(**fault) for fault in told.get("faults", ())]
    return RefusedError(told["code"], told["message"], told.get("mend"), faults)


def parse_request(data: bytes) -> Request:
    """Raise RefusedError for a line that is no request."""
    form = 'write {"id": 1, "method": "state", "params": {}} on one line'
    try:
        request = msgspec.json.decode(data, type=Request)
    except msgspec.MsgspecError as error:
        raise RefusedError("bad_request", f"this is not a request: {error}", form) from None
    if request.version != VERSION:
        raise RefusedError(
            "bad_version", f"version {request.version} of the protocol is not supported", f"use version {VERSION}"
        )
    return request
