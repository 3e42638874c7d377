"""Values in the payloads of messages: JSON, a field of it, a text, a number, or bytes as they are."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from numbers import Real
from typing import Any, Literal, get_args

from cfgplan.errors import InputError
from cfgplan_runtime.outside.once import Once

_MOST_SHOWN = 20
"""The bytes of an unreadable payload that are shown."""
PayloadForm = Literal["json", "text", "number", "bytes"]


class PayloadReader:
    """Reads the values in payloads of one form. `field` is a key in JSON, or a list of keys that lead further in.

    A payload that can't be read is told by `say`, once for each place. Raises InputError.
    """

    def __init__(self, form: str, field: str | list[str | int] | None, say: Callable[[str], None]) -> None:
        check_form(form)
        self._form, self._keys = form, _keys(field, form)
        self._once = Once(say)

    def values(self, place: str, payload: bytes) -> tuple[object, ...]:
        """The value in a payload that came at a place, such as a topic; empty if it can't be read."""
        try:
            return (_within(_decoded(payload, self._form), self._keys),)
        except LookupError as error:
            self._once.tell(place, f"{place}: a message has no such field, and is left out: {error}")
        except (ValueError, RecursionError) as error:
            told = f"a message can't be read as {self._form}, and is left out: {error}"
            self._once.tell(place, f"{place}: {told} (it begins {payload[:_MOST_SHOWN]!r}; {_other_form(payload)})")
        return ()


def _other_form(payload: bytes) -> str:
    """Return the form that accepts a payload which another form rejects, as a hint."""
    try:
        return f"`payload: {'text' if payload.decode().isprintable() else 'bytes'}` accepts it"
    except UnicodeDecodeError:
        return "`payload: bytes` accepts it"


def check_form(form: str) -> None:
    """Raise InputError for an unknown form."""
    if form not in get_args(PayloadForm):
        mend = f"write one of {', '.join(get_args(PayloadForm))}"
        raise InputError.of(f"`{form}` is not a form of payload", mend=mend)


def encoded(value: object, form: str = "json") -> bytes:
    """The payload of a value. Raises TypeError or ValueError for what JSON has no form for."""
    match form:
        case "json":
            return json.dumps(value, default=_plain, allow_nan=False).encode()
        case "number" if isinstance(value, Real) and not math.isfinite(value):
            raise ValueError(f"{value} is not a number, and is not published")
        case "bytes" if isinstance(value, bytes | bytearray | memoryview):
            return bytes(value)
        case _:
            return str(value).encode()


def _decoded(payload: bytes, form: str) -> object:
    """The value that a payload holds. Raises ValueError."""
    match form:
        case "json":
            return json.loads(payload, parse_constant=_finite)
        case "number":
            return _finite(payload.decode())
        case "text":
            return payload.decode()
        case _:
            return payload


def _finite(text: str) -> float:
    """Return the number that a text spells. Raises ValueError, also for NaN and infinite ones, which JSON lacks."""
    number = float(text)
    if not math.isfinite(number) or "_" in text:
        raise ValueError(f"{text} is not a number")
    return number


def _keys(field: object, form: str) -> tuple[str | int, ...]:
    """The keys that lead to a field. Raises InputError."""
    if field is None:
        return ()
    keys = tuple(field) if isinstance(field, list) else (field,)
    if not keys or not all(isinstance(key, str | int) for key in keys):
        raise InputError.of(f"`{field}` is not a field", mend="write a key, or a list of those that lead to it")
    if form != "json":
        raise InputError.of(f"a message that is a {form} has no fields", mend="write `payload: json`")
    return keys


def _within(value: Any, keys: tuple[str | int, ...]) -> object:
    """The value at the end of a path of keys. Raises LookupError."""
    for key in keys:
        try:
            value = value[key]
        except (LookupError, TypeError):
            raise LookupError(key) from None
    return value


def _plain(value: Any) -> object:
    """The JSON value in place of an array or a number of numpy."""
    if hasattr(value, "tolist"):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} has no form in JSON")
