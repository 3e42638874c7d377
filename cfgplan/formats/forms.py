"""The forms of values in files, and the readers that take plain data by them.

A form is a type with notes, such as `Annotated[str, Limits(min_length=1), After(normal)]`. A reader only takes or
refuses a value. Why a value is refused is the business of `models`, which makes a pydantic model of the same forms:
most files have no faults, and pydantic takes longer to import than a small file to load.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Mapping
from functools import lru_cache
from math import inf
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

Reader = Callable[[Any], Any]
_KNOWN_KEYS = 4096
"""The most keys of a kind of mapping that are read once: ports have the same few names in most transformations."""


class RefusedError(Exception):
    """A value has another form. `kind` is pydantic's name for the error; `mend` is None if `kind` says enough."""

    def __init__(self, text: str = "", mend: str | None = None, kind: str = "value") -> None:
        super().__init__(text)
        self.text = text
        self.mend = mend
        self.kind = kind


class _Note:
    """A remark about a type."""

    __slots__ = ("told",)

    def __init__(self, told: Any) -> None:
        self.told = told


class Before(_Note):
    """A function that a value passes before it is read."""


class After(_Note):
    """A function that a read value passes. It raises RefusedError."""


class Instead(_Note):
    """A function that reads the value, whatever the type. It raises RefusedError."""


class Schema(_Note):
    """The JSON Schema of a form, in place of that of its type."""


class MoreSchema(_Note):
    """Keys that the JSON Schema of a form has besides those of its type."""


class Described(_Note):
    """What a form means."""


class Form(_Note):
    """The name of one form of several."""


class Choice(_Note):
    """A function that returns the name of the form that an author chose, so that faults are about that one only.

    It goes by the type of the value.
    """


class Limits(_Note):
    """The limits of a text, a list or a number: `pattern`, `min_length`, `max_length`, `ge`, `le`."""

    __slots__ = ()

    def __init__(self, **limits: Any) -> None:
        super().__init__(limits)


def reader_of(form: Any, parts: Callable[[Any], Reader]) -> Reader:
    """Return the reader of a form; `parts` returns that of a class that stands in it. Raises TypeError."""
    origin, inner = get_origin(form), get_args(form)
    if origin is Annotated:
        return _noted(inner[0], inner[1:], parts)
    if origin in (Union, UnionType):
        (said,) = (each for each in inner if each is not NoneType)
        return _or_none(reader_of(said, parts))
    if origin is Literal:
        return _one_of(inner)
    if origin is list:
        return _list(reader_of(inner[0], parts))
    if origin is dict:
        return _mapping(*(reader_of(each, parts) for each in inner))
    if form in (str, int, bool):
        return _exactly(form)
    return parts(form)


def _noted(form: Any, notes: tuple[Any, ...], parts: Callable[[Any], Reader]) -> Reader:
    read: Reader | None = None
    if choice := next((note.told for note in notes if isinstance(note, Choice)), None):
        read = _chosen(choice, {name: reader_of(each, parts) for name, each in _named(form)})
    elif form is str and isinstance(notes[0], Limits):
        read, notes = _text(notes[0].told), notes[1:]
    elif not any(isinstance(note, Instead) for note in notes):
        read = reader_of(form, parts)
    for note in notes:
        match note:
            case Instead(told=function):
                read = function
            case After(told=function) if read is not None:
                read = _after(read, function)
            case Before(told=function) if read is not None:
                read = _after(function, read)
            case Limits(told=limits) if read is not None:
                read = _after(read, _within(limits))
    assert read is not None
    return read


def _named(form: Any) -> list[tuple[str, Any]]:
    """The forms of a union by their names."""
    return [(note.told, each) for each in get_args(form) for note in get_args(each) if isinstance(note, Form)]


def _chosen(choice: Callable[[Any], str], readers: Mapping[str, Reader]) -> Reader:
    by_type: dict[type, Reader] = {}

    def read(value: Any) -> Any:
        reader = by_type.get(type(value))
        if reader is None:
            reader = by_type[type(value)] = readers[choice(value)]
        return reader(value)

    return read


def _after(first: Reader, then: Reader) -> Reader:
    return lambda value: then(first(value))


def _or_none(read: Reader) -> Reader:
    return lambda value: None if value is None else read(value)


def _exactly(kind: type) -> Reader:
    def read(value: Any) -> Any:
        if type(value) is not kind:
            raise RefusedError
        return value

    return read


def _one_of(values: tuple[Any, ...]) -> Reader:
    kinds, allowed = {type(value) for value in values}, frozenset(values)

    def read(value: Any) -> Any:
        if type(value) not in kinds or value not in allowed:
            raise RefusedError
        return value

    return read


def _list(read_item: Reader) -> Reader:
    def read(value: Any) -> Any:
        if type(value) is not list:
            raise RefusedError
        return [read_item(each) for each in value]

    return read


def _mapping(read_key: Reader, read_value: Reader) -> Reader:
    def read(value: Any) -> Any:
        if type(value) is not dict:
            raise RefusedError
        return {read_known_key(key): read_value(each) for key, each in value.items()}

    read_known_key = lru_cache(maxsize=_KNOWN_KEYS)(read_key)
    return read


def _within(limits: Mapping[str, Any]) -> Reader:
    """Return a reader that refuses lists and numbers outside of some limits."""
    if "min_length" in limits or "max_length" in limits:
        shortest, longest = limits.get("min_length", 0), limits.get("max_length", sys.maxsize)
        return _if(lambda value: shortest <= len(value) <= longest)
    least, most = limits.get("ge", -inf), limits.get("le", inf)
    return _if(lambda value: value is None or least <= value <= most)


def _text(limits: Mapping[str, Any]) -> Reader:
    """Return a reader of texts that fit a pattern or are not empty, and have no half of a surrogate pair."""
    fits = re.compile(limits["pattern"]).fullmatch if "pattern" in limits else None
    shortest = limits.get("min_length", 0)

    def read(value: Any) -> Any:
        if type(value) is not str or (fits(value) is None if fits is not None else len(value) < shortest):
            raise RefusedError
        if not (value.isascii() or _is_unicode(value)):
            raise RefusedError
        return value

    return read


def _if(fits: Callable[[Any], bool]) -> Reader:
    def read(value: Any) -> Any:
        if not fits(value):
            raise RefusedError
        return value

    return read


def _is_unicode(text: str) -> bool:
    """Whether a text has no half of a surrogate pair."""
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True
