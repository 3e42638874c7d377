"""Messages between a program and its unit: lines of JSON, or frames of msgpack (the manual's page `programs`).

A frame is `MARK`, the length of its payload as 4 bytes (little-endian), and a payload as streams have it: 4 bytes with
the length of the msgpack, the msgpack, padding, and the bytes of the arrays. No UTF-8 text and no msgpack has the byte
with which `MARK` begins, so that a frame is found again after anything that a program writes in between.
"""

from __future__ import annotations

import os
import struct
import sys
from collections import deque
from contextlib import suppress
from typing import Annotated, Any, Protocol

import msgspec

from cfgplan_runtime.errors import EncodingError, ProgramFaultError
from cfgplan_runtime.streams.channel import Buffers
from cfgplan_runtime.streams.element import Buffer
from cfgplan_runtime.streams.payload import PayloadEncoder, decode

LARGEST = 1 << 26
"""Bytes of a line or of a frame's payload."""
MARK = b"\xc1CFG"
_LENGTH = struct.Struct("<I")
_HEAD = len(MARK) + _LENGTH.size
_SHOWN = 200
"""Bytes of a wrong message that are told."""
_PER_READ = 1 << 16


_MOST_NS = (1 << 63) - 1


class Answer(msgspec.Struct, forbid_unknown_fields=True):
    """Results of a step or of a source, one for each port at most; `quality` is that of each, by port and attribute."""

    step: int | None = None
    outputs: dict[str, Any] = {}
    quality: dict[str, dict[str, float]] = {}
    time_ns: Annotated[int, msgspec.Meta(ge=-_MOST_NS, le=_MOST_NS)] | None = None


class Readiness(msgspec.Struct, forbid_unknown_fields=True):
    """The first message: the program is ready for steps."""

    ready: bool


class Request(msgspec.Struct):
    """A step that a program is to take."""

    step: int
    time_ns: int
    inputs: dict[str, Any]


_Answers = Answer | list[Answer]


class Message:
    """A message of a program; a message that is too large keeps only its beginning.

    Text that can't have been meant as an answer `is_stray`.
    """

    __slots__ = ("body", "is_stray", "is_too_large")

    def __init__(self, body: Buffer, *, is_stray: bool, is_too_large: bool = False) -> None:
        self.body = body
        self.is_stray = is_stray
        self.is_too_large = is_too_large

    @property
    def shown(self) -> str:
        """Its beginning, without bytes that a terminal would obey."""
        text = bytes(self.body[:_SHOWN]).decode(errors="backslashreplace")
        clean = "".join(each if each.isprintable() else ascii(each)[1:-1] for each in text)
        return f"{clean}..." if len(self.body) > _SHOWN or self.is_too_large else clean


class ProgramOutput(Protocol):
    """A program's output as messages, and the messages for its input, in one format."""

    complete: deque[Message]
    has_ended: bool

    def read(self, end: int) -> bool:
        """Read some of the available output. Returns whether something was, or the end."""

    def encode(self, request: Request) -> list[Buffer]:
        """The parts of a message. Raises EncodingError."""

    def answers(self, message: Message) -> list[Answer]:
        """The answers in a message. Raises ProgramFaultError."""

    def is_readiness(self, message: Message) -> bool: ...


def program_output(form: str) -> ProgramOutput:
    return Frames() if form == "msgpack" else Lines()


class Lines:
    """Lines of JSON."""

    def __init__(self) -> None:
        self.complete: deque[Message] = deque()
        self.has_ended = False
        self._rest = bytearray()
        self._is_too_large = False
        self._encoder = msgspec.json.Encoder(enc_hook=_plain)
        self._answers = msgspec.json.Decoder(_Answers)

    def read(self, end: int) -> bool:
        if self.has_ended:
            return True
        try:
            data = os.read(end, _PER_READ)
        except BlockingIOError:
            return False
        first, *others = data.split(b"\n")
        self._add(first)
        for each in others:
            self._complete()
            self._add(each)
        if not data:
            self.has_ended = True
            self._complete()
        return True

    def encode(self, request: Request) -> list[Buffer]:
        try:
            return [self._encoder.encode(request) + b"\n"]
        except (TypeError, ValueError, OverflowError, RecursionError, msgspec.MsgspecError) as error:
            raise EncodingError(f"step {request.step} can't be a line of JSON: {error}") from None

    def answers(self, message: Message) -> list[Answer]:
        _refuse_too_large(message)
        try:
            return _as_list(self._answers.decode(message.body))
        except msgspec.ValidationError as error:
            raise ProgramFaultError("no answer", str(error), message.shown) from None
        except (msgspec.MsgspecError, RecursionError) as error:
            raise ProgramFaultError("no JSON", str(error), message.shown) from None

    def is_readiness(self, message: Message) -> bool:
        with suppress(msgspec.MsgspecError, RecursionError):
            return msgspec.json.decode(message.body, type=Readiness).ready
        return False

    def _add(self, segment: bytes) -> None:
        self._rest += segment
        if len(self._rest) > LARGEST or self._is_too_large:
            self._is_too_large = True
            del self._rest[_SHOWN:]

    def _complete(self) -> None:
        if self._rest.strip():
            is_stray = not self._rest.startswith((b"{", b"["))
            self.complete.append(Message(bytes(self._rest), is_stray=is_stray, is_too_large=self._is_too_large))
        self._rest, self._is_too_large = bytearray(), False


class Frames:
    """Frames of msgpack. The body of a frame is read to where it stays: the arrays of an answer are views of it."""

    def __init__(self) -> None:
        self.complete: deque[Message] = deque()
        self.has_ended = False
        self._rest = bytearray()
        """What was read and belongs to no frame yet."""
        self._frame: memoryview | None = None
        """The payload of the frame that is being read, of which there are so many bytes:"""
        self._filled = 0
        self._buffers = Buffers()
        self._wanted = _PER_READ
        """How many bytes to read at once: after a large frame only a head, so that the next one is not copied."""
        self._encoder = PayloadEncoder()

    def read(self, end: int) -> bool:
        if self.has_ended:
            return True
        try:
            if self._frame is not None:
                count = os.readv(end, [self._frame[self._filled :]])
                self._filled += count
                if self._filled == len(self._frame):
                    self.complete.append(Message(self._frame, is_stray=False))
                    self._frame, self._wanted = None, _HEAD
            else:
                data = os.read(end, self._wanted)
                count, self._wanted = len(data), _PER_READ
                self._rest += data
                self._split()
        except BlockingIOError:
            return False
        if not count:
            self.has_ended = True
            self._add_stray(self._rest)
        return True

    def encode(self, request: Request) -> list[Buffer]:
        parts = self._encoder.encode(request)
        length = sum(map(len, parts))
        if length > LARGEST:
            raise EncodingError(f"step {request.step} can't be a frame: it has more than {LARGEST >> 20} MB")
        return [MARK + _LENGTH.pack(length), *parts]

    def answers(self, message: Message) -> list[Answer]:
        _refuse_too_large(message)
        if message.is_stray:
            raise ProgramFaultError("no msgpack", "outside of all frames", message.shown)
        try:
            said = decode(message.body)
        except EncodingError as error:
            raise ProgramFaultError("no msgpack", str(error), message.shown) from None
        try:
            return _as_list(msgspec.convert(said, _Answers))
        except msgspec.ValidationError as error:
            raise ProgramFaultError("no answer", str(error), message.shown) from None

    def is_readiness(self, message: Message) -> bool:
        with suppress(EncodingError, msgspec.MsgspecError):
            return not message.is_stray and msgspec.convert(decode(message.body), Readiness).ready
        return False

    def _split(self) -> None:
        """Take complete frames out of the bytes that were read. Bytes between frames are stray."""
        at = 0
        rest = self._rest
        while True:
            found = rest.find(MARK, at)
            if found < 0:
                found = len(rest) - _begun(rest)
            self._add_stray(rest[at:found])
            at = found
            if len(rest) - at < _HEAD:
                break
            (length,) = _LENGTH.unpack_from(rest, at + len(MARK))
            if length > LARGEST:
                # Its length may be wrong too, so that the next frame is looked for instead of so many bytes skipped.
                self.complete.append(Message(bytes(rest[at : at + _SHOWN]), is_stray=False, is_too_large=True))
                at += _HEAD
                continue
            at += _HEAD
            if len(rest) - at < length:
                self._filled = len(rest) - at
                self._frame = self._buffers.take(length)
                self._frame[: self._filled] = rest[at:]
                at = len(rest)
                break
            self.complete.append(Message(rest[at : at + length], is_stray=False))
            at += length
        del rest[:at]

    def _add_stray(self, text: bytearray) -> None:
        if text.strip():
            self.complete.append(Message(bytes(text[: _SHOWN + 1]), is_stray=True))


def _begun(text: bytearray) -> int:
    """How many bytes at the end of a text may begin a mark."""
    return next((count for count in range(len(MARK) - 1, 0, -1) if text.endswith(MARK[:count])), 0)


def _as_list(answer: Answer | list[Answer]) -> list[Answer]:
    return answer if isinstance(answer, list) else [answer]


def _refuse_too_large(message: Message) -> None:
    if message.is_too_large:
        raise ProgramFaultError("too large", f"more than {LARGEST >> 20} MB in one message", message.shown)


def _plain(value: Any) -> object:
    """The JSON value in place of an array or a number of numpy."""
    numpy = sys.modules.get("numpy")
    if numpy is not None and isinstance(value, (numpy.ndarray, numpy.generic)):
        return value.tolist()
    raise TypeError(f"JSON has no {type(value).__name__}")
