"""The form of a type's messages: it converts values with its field names to serialised messages, and back."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from operator import index
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy

from cfgplan.errors import did_you_mean
from cfgplan.ros.types import MessageType
from cfgplan_runtime.errors import EncodingError
from cfgplan_runtime.nodes.message_values import FILLER, MessageValues

if TYPE_CHECKING:
    from rosbags.interfaces.typing import FieldDesc
    from rosbags.typesys.store import Typestore

_Change: TypeAlias = Callable[[Any], Any]
_Empty: TypeAlias = Callable[[], Any]
_HEADER, _TIME = "std_msgs/msg/Header", "builtin_interfaces/msg/Time"
_MOST_SHOWN = 40


class MisfitError(EncodingError):
    """A value that does not fit its message type. `path` leads to it: `.pose.position.x`, `.points[3].y`."""

    def __init__(self, what: str, path: str = "") -> None:
        super().__init__(f"{path.removeprefix('.')}: {what}" if path else what)
        self.what = what
        self.path = path

    def within(self, place: str) -> MisfitError:
        """The same error, seen from the value that contains this one."""
        return MisfitError(self.what, place + self.path)


class MessageForm:
    """The messages of one type; a value is a mapping from field to value, or any object with such attributes.

    For an array of numbers, a value may have anything that numpy converts to an array; for an array of bytes, also
    bytes. Missing fields become zero, empty or false; a missing stamp of a `header` becomes the time of the element. If
    a type has a single field, a value may be that field's.
    """

    def __init__(self, type: MessageType, type_hash: str, store: Typestore) -> None:  # noqa: A002
        self.type = type
        self.type_hash = type_hash
        self._store = store
        self._name = type.ros2
        store.get_msgdef(self._name)
        self._message = _Messages(store).change(self._name)
        self._value = MessageValues(store).change(self._name)
        fields = dict(store.fielddefs[self._name][1])
        self._only = next(iter(fields)) if len(fields) == 1 else None
        self._has_header = "header" in fields and fields["header"][1] == _HEADER

    def encode(self, value: object, time_ns: int) -> bytes | bytearray:
        """The message in CDR of a value that was made at `time_ns`. Raises MisfitError."""
        if self._only is not None and not (isinstance(value, Mapping) or hasattr(value, self._only)):
            value = {self._only: value}
        message = self._message(value)
        if self._has_header and _inner(_inner(value, "header"), "stamp") is None:
            message.header.stamp = self._store.types[_TIME](*divmod(time_ns, 10**9))
        # rosbags gives a view, which Zenoh does not take: this is what the view is of.
        return self._store.serialize_cdr(message, self._name).obj  # type: ignore[return-value]

    def decode(self, data: bytes) -> dict[str, Any]:
        """The value of a message in CDR; its arrays of numbers are views of `data`. Raises EncodingError."""
        from rosbags.serde import SerdeError

        try:
            message = self._store.deserialize_cdr(memoryview(data), self._name)
        except SerdeError as error:
            raise EncodingError(f"a message can't be read: {error}") from None
        return self._value(message)  # type: ignore[no-any-return]


def _inner(value: object, field: str) -> object:
    return value.get(field) if isinstance(value, Mapping) else getattr(value, field, None)


class _Messages:
    """Makes messages of values, by type."""

    def __init__(self, store: Typestore) -> None:
        self._store = store
        self._made: dict[str, _Change] = {}

    def change(self, name: str) -> _Change:
        """How a value becomes a message of a type."""
        if name not in self._made:
            self._made[name] = self._new(name)
        return self._made[name]

    def _new(self, name: str) -> _Change:
        make: Any = self._store.types[name]
        rows = [(field, *self._field(what)) for field, what in self._store.fielddefs[name][1]]
        fields = {field for field, _, _ in rows} - {FILLER}

        def change(value: Any) -> Any:
            if isinstance(value, Mapping):
                if not fields.issuperset(value):
                    strange = next(str(key) for key in value if key not in fields)
                    mend = did_you_mean(strange, fields, f"there is {', '.join(sorted(fields)) or 'none'}")
                    raise MisfitError(f"{name} has no such field ({mend})", f".{strange}")
            elif fields and not any(hasattr(value, field) for field in fields):
                raise MisfitError(f"{name} needs a mapping from field to value, not {_shown(value)}")
            made = []
            for field, change, empty in rows:
                inner = _inner(value, field)
                try:
                    made.append(empty() if inner is None else change(inner))
                except MisfitError as error:
                    raise error.within(f".{field}") from None
            return make(*made)

        return change

    def _field(self, what: FieldDesc) -> tuple[_Change, _Empty]:
        """The conversion of a field's value, and the value of a missing field."""
        from rosbags.interfaces import Nodetype

        if what[0] == Nodetype.NAME:
            change = self.change(what[1])
            return change, lambda: change({})
        if what[0] == Nodetype.BASE:
            name, limit = what[1]
            return _one(name, limit), {"string": str, "bool": bool, "float32": float, "float64": float}.get(name, int)
        (inner, size), is_fixed = what[1], what[0] == Nodetype.ARRAY
        length = size if is_fixed else 0
        if inner[0] == Nodetype.BASE and inner[1][0] != "string":
            numbers = _Numbers(inner[1][0], size, is_fixed)
            return numbers, lambda: numbers(numpy.zeros(length, numbers.kind))
        change, empty = self._field(inner)
        return partial(_several, change=change, size=size, is_fixed=is_fixed), lambda: [empty() for _ in range(length)]


class _Numbers:
    """Arrays of numbers or flags of one kind."""

    def __init__(self, name: str, size: int, is_fixed: bool) -> None:
        self.kind = numpy.dtype("uint8" if name == "byte" else name)
        self._size = size
        self._is_fixed = is_fixed
        self._one = _one(name, 0)

    def __call__(self, value: Any) -> Any:
        if isinstance(value, bytes | bytearray | memoryview) and self.kind.itemsize == 1:
            array = numpy.frombuffer(value, self.kind)
        else:
            array = numpy.ascontiguousarray(self._array(value)).reshape(-1)
        _check_length(len(array), self._size, self._is_fixed)
        return array

    def _array(self, value: Any) -> Any:
        if isinstance(value, str | bytes | Mapping):
            raise MisfitError(f"an array of {self.kind} is needed, not {_shown(value)}")
        try:
            array = numpy.asarray(value)
        except ValueError:
            raise MisfitError("its rows are of different lengths") from None
        if array.dtype == self.kind or not array.size:
            return array.astype(self.kind, copy=False)
        if not array.ndim:
            raise MisfitError(f"an array of {self.kind} is needed, not {_shown(value)}")
        if self._fits(array):
            return array.astype(self.kind)
        # Checking each number tells which one does not fit. If a list has a text, numpy makes texts of all numbers.
        given = value if array.ndim == 1 and isinstance(value, Sequence) else array.reshape(-1).tolist()
        return numpy.array(_each(self._one, given), self.kind)

    def _fits(self, array: Any) -> bool:
        """Whether all numbers of another kind certainly fit."""
        if self.kind.kind == "f":
            return array.dtype.kind in "iu" or (array.dtype.kind == "f" and self.kind.itemsize == 8)
        if array.dtype.kind not in "iu" or self.kind.kind == "b":
            return False
        limits = numpy.iinfo(self.kind)
        return bool(limits.min <= int(array.min()) and int(array.max()) <= limits.max)


def _several(value: Any, change: _Change, size: int, is_fixed: bool) -> list[Any]:
    """A list of texts or of messages."""
    if isinstance(value, str | bytes) or not isinstance(value, Sequence):
        raise MisfitError(f"a list is needed, not {_shown(value)}")
    _check_length(len(value), size, is_fixed)
    return _each(change, value)


def _each(change: _Change, values: Sequence[Any]) -> list[Any]:
    made = []
    for value in values:
        try:
            made.append(change(value))
        except MisfitError as error:
            raise error.within(f"[{len(made)}]") from None
    return made


def _check_length(length: int, size: int, is_fixed: bool) -> None:
    if is_fixed and length != size:
        raise MisfitError(f"{size} elements are needed, not {length}")
    if size and length > size:
        raise MisfitError(f"at most {size} elements may be there, not {length}")


def _one(name: str, limit: int) -> _Change:
    """The check of a text, a flag or a number. `limit` is the most bytes of a text; 0: any."""
    if name == "string":
        return partial(_text, limit=limit)
    if name == "bool":
        return _flag
    if name.startswith("float"):
        return partial(_real, name=name, most=float(numpy.finfo(name).max))
    limits = numpy.iinfo("uint8" if name == "byte" else name)
    whole = partial(_whole, name=name, least=int(limits.min), most=int(limits.max))
    # rosbags has bytes as signed numbers.
    return (lambda value: (whole(value) ^ 0x80) - 0x80) if name == "byte" else whole


def _text(value: Any, limit: int) -> str:
    if not isinstance(value, str):
        raise MisfitError(f"a text is needed, not {_shown(value)}")
    try:
        length = len(value.encode())
    except UnicodeEncodeError:
        raise MisfitError("this text can't be encoded as UTF-8") from None
    if limit and length > limit:
        raise MisfitError(f"a text of at most {limit} bytes is needed, not of {length}")
    return value


def _flag(value: Any) -> bool:
    if not isinstance(value, bool | numpy.bool_):
        raise MisfitError(f"true or false is needed, not {_shown(value)}")
    return bool(value)


def _real(value: Any, name: str, most: float) -> float:
    if isinstance(value, bool | numpy.bool_) or not isinstance(value, int | float | numpy.number):
        raise MisfitError(f"a number ({name}) is needed, not {_shown(value)}")
    try:
        number = float(value)
    except (OverflowError, TypeError):  # a whole number of hundreds of digits, or a complex one
        raise MisfitError(f"a number ({name}) is needed, not {_shown(value)}") from None
    if math.isfinite(number) and abs(number) > most:
        raise MisfitError(f"{_shown(value)} is too large for {name}")
    return number


def _whole(value: Any, name: str, least: int, most: int) -> int:
    if isinstance(value, bool | numpy.bool_) or not isinstance(value, int | numpy.integer):
        raise MisfitError(f"a whole number ({name}) is needed, not {_shown(value)}")
    number = index(value)
    if not least <= number <= most:
        raise MisfitError(f"{number} is not within {least} and {most} ({name})")
    return number


def _shown(value: object) -> str:
    text = repr(value)
    return text if len(text) <= _MOST_SHOWN else f"{text[:_MOST_SHOWN]} ..."
