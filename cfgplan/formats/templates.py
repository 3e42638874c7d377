"""Template variables in transformations and targets: `${NAO}`, `${NAO:x}`, and `$${` for a plain `${`."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from itertools import product
from typing import Any

from cfgplan.canonical import normal
from cfgplan.formats.fields import Part
from cfgplan.formats.places import Path

_MARK = re.compile(r"\$(\$\{)|\$\{([^\s${}:]+)(?::([^\s${}:]+))?\}|(\$\{)")
MOST_EXPANSIONS = 1_000_000


class BadTemplateError(ValueError):
    """A `${` that begins no variable; `column` counts from 1 inside the text."""

    def __init__(self, column: int) -> None:
        super().__init__("`${` begins no template variable here")
        self.column = column


Variable = tuple[str, str]
"""A class, and a name to distinguish variables over the same class; it may be empty."""


def variables(text: str) -> Iterator[tuple[Variable, int]]:
    """The variables of a text, each with its column; raises BadTemplateError."""
    for mark in _MARK.finditer(text):
        if mark.group(4):
            raise BadTemplateError(mark.start() + 1)
        if mark.group(2):
            yield _variable(mark), mark.start() + 1


def shown(variable: Variable) -> str:
    """A variable as it is written in a text."""
    name, tail = variable
    return f"${{{name}:{tail}}}" if tail else f"${{{name}}}"


def substitute(text: str, values: Mapping[Variable, str]) -> str:
    """The text with every variable replaced by its value and `$${` by `${`."""
    return _MARK.sub(lambda mark: _replacement(mark, values), text) if "$" in text else text


def substitute_all(value: Any, values: Mapping[Variable, str]) -> Any:
    """Parts and plain data with every text in them, keys too, substituted."""
    if isinstance(value, str):
        return substitute(value, values)
    if isinstance(value, dict):
        return {substitute(key, values): substitute_all(item, values) for key, item in value.items()}
    if isinstance(value, list):
        return [substitute_all(item, values) for item in value]
    if isinstance(value, Part):
        return type(value)(**{key: substitute_all(item, values) for key, item in vars(value).items()})
    return value


def texts(value: object, path: Path) -> Iterator[tuple[Path, str]]:
    """Every text in parts and plain data, keys too, with its place."""
    if isinstance(value, str):
        yield path, value
    elif isinstance(value, dict):
        for key, item in value.items():
            yield (*path, key), key
            yield from texts(item, (*path, key))
    elif isinstance(value, list):
        for index, item in enumerate(value):
            yield from texts(item, (*path, index))
    elif isinstance(value, Part):
        for key in value.all_keys():
            if (item := getattr(value, key)) is not None:
                yield from texts(item, (*path, key))


def escaped(value: Any) -> Any:
    """The plain data that `substitute_all` turns into this one."""
    if isinstance(value, str):
        return value.replace("${", "$${")
    if isinstance(value, Mapping):
        return {escaped(key): escaped(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [escaped(item) for item in value]
    return value


def original_column(text: str, values: Mapping[Variable, str], column: int) -> int:
    """The column in a template's text that a column of its substitution comes from; both from 1."""
    added = 0
    for mark in _MARK.finditer(text):
        start = mark.start() + added
        replacement = _replacement(mark, values)
        if column - 1 < start:
            break
        if column - 1 < start + len(replacement):
            return mark.start() + 1
        added += len(replacement) - len(mark.group())
    return column - added


def pattern(text: str) -> re.Pattern[str]:
    """A pattern that every expansion of a text matches, whatever its variables stand for."""
    pieces = re.split(r"\$?\$\{[^}]*\}?", text)
    return re.compile(".*".join(map(re.escape, pieces)), re.DOTALL)


def assignments(instances: Mapping[Variable, Iterable[str]]) -> Iterator[dict[Variable, str]]:
    """Every way to give the variables a value: the product over all of them."""
    for values in product(*instances.values()):
        yield dict(zip(instances, values, strict=True))


def _variable(mark: re.Match[str]) -> Variable:
    return normal(mark.group(2)), normal(mark.group(3) or "")


def _replacement(mark: re.Match[str], values: Mapping[Variable, str]) -> str:
    if mark.group(1):
        return mark.group(1)
    return values[_variable(mark)]
