"""Frozen values in a canonical order: two are equal exactly when they mean the same, however they were written."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import MISSING, fields
from functools import cache
from typing import Any, TypeVar
from unicodedata import normalize

from cfgplan.errors import InvalidValueError

T = TypeVar("T")


def normal(text: str) -> str:
    """A text in Unicode's normal form NFC, so that a name is the same however its accents are encoded."""
    return text if text.isascii() else normalize("NFC", text)


def store_sorted(holder: object, name: str, values: Iterable[T], key: Callable[[T], object]) -> None:
    """Sort a tuple of a frozen dataclass during its construction."""
    object.__setattr__(holder, name, tuple(sorted(values, key=key)))  # type: ignore[arg-type]


def store_resources(holder: object, name: str, fields: Mapping[str, str]) -> None:
    """Sort amounts of resources by name, and move those that have a field of their own into it.

    `fields` maps such a resource to its field. Raises InvalidValueError if both have an amount.
    """
    amounts = dict(sorted(getattr(holder, name).items()))
    for resource, field in fields.items():
        if resource in amounts:
            if getattr(holder, field) is not None:
                raise InvalidValueError(f"`{resource}` is said twice, by itself and in `{name}`")
            object.__setattr__(holder, field, amounts.pop(resource))
    object.__setattr__(holder, name, amounts)


def fields_of(value: Any) -> dict[str, Any]:
    """Return the fields of a frozen dataclass, without derived attributes, for pickling and copying."""
    return {name: getattr(value, name) for name in _names_of(type(value))}  # type: ignore[arg-type]


def with_fields(value: T, **changed: object) -> T:
    """Return a copy of a frozen dataclass with other values of some fields. They must be valid: nothing checks them."""
    copy, put = object.__new__(type(value)), object.__setattr__
    for name in _names_of(type(value)):  # type: ignore[arg-type]
        put(copy, name, changed[name] if name in changed else getattr(value, name))
    return copy


def unchecked(kind: type[T], said: Mapping[str, object]) -> T:
    """Return a frozen dataclass with these fields. They must be valid and in canonical form: nothing checks them.

    Other fields have their defaults; values may share one object as their default, such as an empty mapping.
    """
    value, put = object.__new__(kind), object.__setattr__
    for name, usual in _stored_defaults(kind):  # type: ignore[arg-type]
        if name not in said:
            put(value, name, usual)
    for name, each in said.items():
        put(value, name, each)
    return value


@cache
def _stored_defaults(kind: type[Any]) -> tuple[tuple[str, Any], ...]:
    """The defaults that each value has to store; those of a class without slots are attributes of the class already."""
    usual = [(each.name, each.default) for each in fields(kind) if each.default is not MISSING]
    made = [(each.name, each.default_factory()) for each in fields(kind) if each.default_factory is not MISSING]
    return (*(usual if hasattr(kind, "__slots__") else ()), *made)


@cache
def _names_of(kind: type[Any]) -> tuple[str, ...]:
    """The names of a dataclass's fields."""
    return tuple(field.name for field in fields(kind))


def refuse_duplicates(what: str, names: list[str]) -> None:
    """Raise InvalidValueError if a name occurs twice; `what` is the noun in its message."""
    if len(set(names)) != len(names):
        twice = sorted(name for name, times in Counter(names).items() if times > 1)
        raise InvalidValueError(f"each {what} must be named once, but {', '.join(map(repr, twice))} is named again")
