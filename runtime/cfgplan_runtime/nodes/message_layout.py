"""The layout of ROS messages as they are on the wire, and numbers that are read from there without decoding the rest.

ROS 2 aligns values (CDR), ROS 1 does not. Both have four bytes before the message: CDR how it is encoded, ROS 1 its
length. The helper in the user's ROS Python imports this module, which needs nothing but the standard library.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Union

_BODY = 4
"""The bytes before a message."""
_CODES = {
    "bool": "?",
    "boolean": "?",
    "byte": "B",
    "octet": "B",
    "char": "B",
    "int8": "b",
    "uint8": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "float": "f",
    "float32": "f",
    "double": "d",
    "float64": "d",
}
"""How `struct` calls the numbers of ROS 1, of ROS 2 and of IDL."""
_SEQUENCE = re.compile(r"sequence<(?P<of>.+?)(, *\d+)?>")
_ARRAY = re.compile(r"(?P<of>[^\[]+)\[(?P<size>\d*)\]")
_TEXT = re.compile(r"(?P<wide>w?)string(<\d+>|<=\d+)?")
_RULE = "=" * 80
"""The line between the definitions of a message and of its fields in ROS 1."""
_ROS1_TIMES = {"time": "uint32", "duration": "int32"}


class UnreadableError(Exception):
    """A message is shorter than its layout, or has a part that can't be skipped."""


@dataclass(frozen=True, eq=False)
class Number:
    """A number or a flag: its code for `struct`, and its size in bytes."""

    code: str
    size: int


@dataclass(frozen=True, eq=False)
class Text:
    """A text. The size of a wide one differs between middlewares: nothing behind it can be read."""

    is_wide: bool = False


@dataclass(frozen=True, eq=False)
class Several:
    """Values of one kind: `number` of them, or as many as the message says if that is None."""

    of: Kind
    number: int | None


@dataclass(frozen=True, eq=False)
class Layout:
    """The fields of a message type, in their order."""

    name: str
    fields: Mapping[str, Kind]


Kind = Union[Number, Text, Several, Layout]  # noqa: UP007 - the helper may run in Python 3.10, and `Kind` is a value
_NUMBERS = {name: Number(code, struct.calcsize(f"={code}")) for name, code in _CODES.items()}


def kind_of(text: str, layout: Callable[[str], Layout]) -> Kind:
    """Return the kind of a field by how a definition writes it: `double[9]`, `sequence<uint8>`, `std_msgs/Header`.

    `layout` gives the layout of a message type by its name.
    """
    if text in _NUMBERS:
        return _NUMBERS[text]
    if found := _TEXT.fullmatch(text):
        return Text(bool(found["wide"]))
    if found := _SEQUENCE.fullmatch(text):
        return Several(kind_of(found["of"], layout), None)
    if found := _ARRAY.fullmatch(text):
        return Several(kind_of(found["of"], layout), int(found["size"]) if found["size"] else None)
    return layout(text)


def ros1_layout(kind: str, definition: str) -> Layout:
    """Return the layout of a ROS 1 type by the full text of its definition. Raises UnreadableError."""
    first, *others = definition.split(f"{_RULE}\n")
    parts: dict[str, str] = {}
    for other in others:
        head, _, lines = other.partition("\n")
        parts[head.partition("MSG:")[2].strip()] = lines

    def inner(package: str, name: str) -> Layout:
        if name in _ROS1_TIMES:
            number = _NUMBERS[_ROS1_TIMES[name]]
            return Layout(name, {"secs": number, "nsecs": number})
        full = "std_msgs/Header" if name == "Header" else name if "/" in name else f"{package}/{name}"
        if full not in parts:
            raise UnreadableError(f"the definition of {kind} lacks that of {full}")
        return of(full, parts[full])

    def of(name: str, lines: str) -> Layout:
        package = name.partition("/")[0]
        words = [line.partition("#")[0].split(maxsplit=1) for line in lines.splitlines()]
        fields = [(each[1].strip(), each[0]) for each in words if len(each) == 2 and "=" not in each[1]]
        return Layout(name, {field: kind_of(text, lambda other: inner(package, other)) for field, text in fields})

    return of(kind, first)


def field_fault(layout: Layout, path: str) -> str:
    """Return why a path does not lead to a number of each message with a layout; empty if it may."""
    kind: Kind = layout
    walked: list[str] = []
    for step in path.split("."):
        at = ".".join(walked)
        if isinstance(kind, Layout):
            if step not in kind.fields:
                return f"{kind.name} has no field `{step}`; it has {', '.join(kind.fields) or 'none'}"
            if any(map(_is_wide, _before(kind, step))):
                return f"{kind.name} has a text of wide characters before `{step}`, behind which nothing can be read"
            kind = kind.fields[step]
        elif isinstance(kind, Several):
            if not step.isdecimal() or (kind.number is not None and int(step) >= kind.number):
                last = "" if kind.number is None else f" to {kind.number - 1}"
                return f"`{at}` has several values: name one by its number, from 0{last}"
            kind = kind.of
        else:
            return f"`{at}` has no parts"
        walked.append(step)
    if isinstance(kind, Number):
        return ""
    inside = f"; name one of its fields: {', '.join(kind.fields)}" if isinstance(kind, Layout) else ""
    inside = "; name one of its values by its number, from 0" if isinstance(kind, Several) else inside
    return f"`{path}` is not a number{inside}"


class NumberReader:
    """Reads the number at a path from messages of a layout; `field_fault` has found none in it.

    `is_aligned` says whether messages are of ROS 2 (CDR) or of ROS 1.
    """

    def __init__(self, layout: Layout, path: str, *, is_aligned: bool) -> None:
        self._layout, self._steps, self._is_aligned = layout, path.split("."), is_aligned
        self._spans: dict[tuple[Kind, int], int | None] = {}
        """The sizes of values that have the same size in each message, by how they are aligned."""

    def number(self, message: bytes | bytearray) -> float | None:
        """Return the number or flag; None if the message has too few values. Raises UnreadableError."""
        order = ">" if self._is_aligned and not message[1] & 1 else "<"
        try:
            return self._found(message, order)
        except struct.error:
            raise UnreadableError(f"a message is too short for a {self._layout.name}") from None

    def _found(self, message: bytes | bytearray, order: str) -> float | None:
        kind, at = self._layout, _BODY  # type: Kind, int
        for step in self._steps:
            if isinstance(kind, Layout):
                for name, field in kind.fields.items():
                    if name == step:
                        kind = field
                        break
                    at = self._after(field, message, at, order)
            else:
                assert isinstance(kind, Several)
                number, at = self._number_of(kind, message, at, order)
                if int(step) >= number:
                    return None
                at = self._after_several(kind.of, int(step), message, at, order)
                kind = kind.of
        assert isinstance(kind, Number)
        (value,) = struct.unpack_from(order + kind.code, message, self._aligned(at, kind.size))
        return value  # type: ignore[no-any-return]

    def _after(self, kind: Kind, message: bytes | bytearray, at: int, order: str) -> int:
        """Return where the value ends that begins at a place."""
        span = self._span(kind, at % 8)
        if span is not None:
            return at + span
        if isinstance(kind, Layout):
            for field in kind.fields.values():
                at = self._after(field, message, at, order)
            return at
        if isinstance(kind, Text):
            at = self._aligned(at, 4)
            return at + 4 + int(struct.unpack_from(f"{order}I", message, at)[0])
        assert isinstance(kind, Several)
        number, at = self._number_of(kind, message, at, order)
        return self._after_several(kind.of, number, message, at, order)

    def _after_several(self, kind: Kind, number: int, message: bytes | bytearray, at: int, order: str) -> int:
        if isinstance(kind, Number):
            return self._aligned(at, kind.size) + number * kind.size if number else at
        for _ in range(number):
            if at > len(message):
                raise UnreadableError(f"a message is too short for a {self._layout.name}")
            at = self._after(kind, message, at, order)
        return at

    def _number_of(self, kind: Several, message: bytes | bytearray, at: int, order: str) -> tuple[int, int]:
        """Return how many values there are, and where the first one may begin."""
        if kind.number is not None:
            return kind.number, at
        at = self._aligned(at, 4)
        return struct.unpack_from(f"{order}I", message, at)[0], at + 4

    def _span(self, kind: Kind, phase: int) -> int | None:
        """Return the bytes from a place with this remainder by 8 to the value's end; None if messages differ in it."""
        key = kind, phase
        if key not in self._spans:
            self._spans[key] = self._new_span(kind, phase)
        return self._spans[key]

    def _new_span(self, kind: Kind, phase: int) -> int | None:
        if isinstance(kind, Number):
            return self._aligned(phase, kind.size) + kind.size - phase
        if isinstance(kind, Text) or (isinstance(kind, Several) and kind.number is None):
            return None
        if isinstance(kind, Layout) and not kind.fields:
            return int(self._is_aligned)  # ROS 2 fills a message without fields with a byte
        parts: Iterable[Kind] = kind.fields.values() if isinstance(kind, Layout) else [kind.of] * (kind.number or 0)
        at = phase
        for part in parts:
            span = self._span(part, at % 8)
            if span is None:
                return None
            at += span
        return at - phase

    def _aligned(self, at: int, size: int) -> int:
        """Return the first place for a value of a size: a multiple of it, counted from the message's beginning."""
        return at + -(at - _BODY) % size if self._is_aligned else at


def _before(layout: Layout, name: str) -> Sequence[Kind]:
    names = list(layout.fields)
    return [layout.fields[each] for each in names[: names.index(name)]]


def _is_wide(kind: Kind) -> bool:
    """Whether a value has a text of wide characters."""
    if isinstance(kind, Layout):
        return any(map(_is_wide, kind.fields.values()))
    return _is_wide(kind.of) if isinstance(kind, Several) else isinstance(kind, Text) and kind.is_wide
