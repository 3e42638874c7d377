"""Features: what a problem may ask beyond the paper; and rows, which say what rule a field of the domain states."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import MISSING, dataclass, field, fields
from enum import StrEnum
from functools import cache
from operator import attrgetter
from typing import Any, Final


class Feature(StrEnum):
    """An extension of the paper's problem; the value is its name in error messages."""

    QUALITY = "quality of streams"
    HOSTS = "hosts"
    CONFLICTS = "conflicts"
    BESIDE = "units that run with others"
    INSTANCES = "numbers of instances"
    SURVIVAL = "survival of failures"
    OPTIONAL = "optional inputs"
    COUNTS = "inputs that take several streams"
    LIMITS = "outputs that serve only so many"
    RUNS = "targets that want a unit, not a stream"
    ORDER = "an order of objectives"
    LATENCY = "latencies of links"


def _not_shown(_: Any) -> Iterable[str]:
    return ()


@dataclass(frozen=True)
class RuleRow:
    """The rule that a field states.

    A problem in which the field is not `default` asks for the `feature`. If the field can forbid plans, `limit` is its
    key in files; explanations lift it by the default. A field that `limits_units` says how many units of its
    transformation may be there: a number, or a number for each selector of hosts. A field that `is_by_host` may be kept
    by several hosts where one could not keep it. One that `is_of_hosts` says nothing where no hosts are declared.
    `shown` gives lines for a picture of a unit.
    """

    feature: Feature | None = None
    limit: str = ""
    limits_units: bool = False
    is_by_host: bool = False
    is_of_hosts: bool = False
    shown: Callable[[Any], Iterable[str]] = _not_shown
    default: Any = None


_ROW: Final = "rule"


def states(*, default: Any = MISSING, default_factory: Any = MISSING, hash: bool | None = None, **row: Any) -> Any:  # noqa: A002
    """A field of a frozen dataclass that states a rule; `row` has the values of its `RuleRow`."""
    usual = default if default_factory is MISSING else default_factory()
    said = {_ROW: RuleRow(**row, default=usual)}
    if default_factory is MISSING:
        return field(default=default, hash=hash, metadata=said)
    return field(default_factory=default_factory, hash=hash, metadata=said)


@cache
def rule_rows(kind: type[Any]) -> Mapping[str, RuleRow]:
    """The rows of a class, by attribute."""
    return {each.name: each.metadata[_ROW] for each in fields(kind) if _ROW in each.metadata}


def asked_features(kind: type[Any], parts: Iterable[object]) -> Iterator[Feature]:
    """Yield the features that parts of one class ask for."""
    these = list(parts)
    for name, row in rule_rows(kind).items():  # type: ignore[arg-type]
        if row.feature is not None and any(value != row.default for value in map(attrgetter(name), these)):
            yield row.feature


def least_limit(value: int | Mapping[str, int] | None) -> int | None:
    """The least number in the value of a field that limits units; None if it limits nothing."""
    return min(value.values(), default=None) if isinstance(value, Mapping) else value


def shown_of(part: object) -> list[str]:
    """The lines that pictures show of the rules that a part states."""
    rows = rule_rows(type(part)).items()  # type: ignore[arg-type]
    return [line for name, row in rows for line in row.shown(getattr(part, name))]
