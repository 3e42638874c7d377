"""A field is a row: a note beside the attribute of a domain's value, from which all lists of fields are derived.

Schema, readers, writers, digests, limits, features, the manual's table and the fields that restart a unit read the row.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import MISSING, dataclass, fields, is_dataclass
from enum import Flag, StrEnum
from functools import cache
from typing import Any, Final, get_args

from cfgplan.arguments import noted

ELEMENT, UNSAID = "<>", ""
"""How the XML format has a key that is no attribute: as an element, or not at all."""
LARGEST_AMOUNT = 1_000_000_000
MOST_IN_A_QUEUE = 1_000_000
ALL = 0
"""The `count` of an input that takes every matching stream."""


class Use(Flag):
    """The readers of a field: a change of its value makes saved plans stale (PLANNING), or restarts units (RUNNING)."""

    NONE = 0
    PLANNING = 1
    RUNNING = 2
    BOTH = 3


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


@dataclass(frozen=True, slots=True)
class Row:
    """A field: its meaning, and what does not follow from the attribute beside which the row stands.

    `key` is the key of environment files; by default the attribute's name without its unit. A row without a meaning is
    in no file. `form` names the values in files (`formats.schema_values`, `formats.fields`); by default it follows from
    the attribute's type. Whole numbers are at least `least` and at most `most`. An `absent` key has the attribute's
    default, unless it is declared here: None means that another rule decides. `xml` is the attribute of the XML format,
    ELEMENT or UNSAID. In files the key stands below the one of the previous attribute, or below `below`.

    A value other than the default asks for a `feature`. If it `is_limit`, it can only forbid plans. A field that
    `limits_units` says how many units of its transformation may be there: a number, or a number for each selector of
    hosts. If a field `is_by_host`, several hosts may satisfy it where one can't. If it `is_of_hosts`, it has no effect
    without declared hosts. `shown` gives lines for a picture of a unit.
    """

    meaning: str = ""
    key: str = ""
    form: str = ""
    use: Use = Use.PLANNING
    least: int | None = None
    most: int = LARGEST_AMOUNT
    absent: object = ...
    xml: str | None = None
    below: str = ""
    feature: Feature | None = None
    is_limit: bool = False
    limits_units: bool = False
    is_by_host: bool = False
    is_of_hosts: bool = False
    shown: Callable[[Any], Iterable[str]] | None = None


FOUND = Row(use=Use.NONE)
"""The row of an attribute that a run finds out: it is in no file, and no plan is stale for it."""
QOS = Row(
    "in ROS 2: the quality of service, such as `best_effort` or `reliable transient_local deadline=0.1`; "
    "`cfgplan check` names ports that it keeps from connecting",
    form="QosText",
    use=Use.RUNNING,
)
"""The row of a port or a topic of ROS 2."""


@dataclass(frozen=True, slots=True)
class Attribute:
    """An attribute of a domain's value, its type as an annotation says it, its default, and its row.

    An attribute without a row is in no file, and planning uses it.
    """

    name: str
    type: Any
    default: Any
    row: Row

    @property
    def key(self) -> str:
        """The key in environment files."""
        base, _, unit = self.name.rpartition("_")
        return self.row.key or (base if base and unit in ("us", "mb", "hz", "uhz", "bytes") else self.name)


def attributes(kind: Any) -> tuple[Attribute, ...]:
    """The attributes of a dataclass, in the order of their declaration."""
    return _attributes(kind)


@cache
def _attributes(kind: Any) -> tuple[Attribute, ...]:
    hints = noted(kind)
    return tuple(
        Attribute(
            each.name,
            hints[each.name],
            each.default if each.default_factory is MISSING else each.default_factory(),
            next((note for note in get_args(hints[each.name]) if isinstance(note, Row)), Row()),
        )
        for each in fields(kind)
    )


def planned(value: Any) -> Any:
    """Return all that planning uses of a domain's value, without defaults, as plain data by the domain's names."""
    if isinstance(value, _PLAIN):
        return value
    if isinstance(value, tuple):
        return [planned(each) for each in value]
    if isinstance(value, Mapping):
        return {key: planned(each) for key, each in value.items()}
    if not is_dataclass(value):
        return value
    kind: Any = type(value)
    found = {}
    for name, usual in _planned(kind):
        part = getattr(value, name)
        if part is not usual and part != usual and (plain := planned(part)) != {}:
            found[name] = plain
    return found


_PLAIN: Final = (str, int, float, type(None))


@cache
def _planned(kind: Any) -> list[tuple[str, Any]]:
    """The attributes of a dataclass that planning uses, with their defaults."""
    return [(each.name, each.default) for each in attributes(kind) if Use.PLANNING in each.row.use]


def running(value: object) -> tuple[object, ...]:
    """Return the attributes of a domain's value that running uses."""
    return tuple(getattr(value, each.name) for each in attributes(type(value)) if Use.RUNNING in each.row.use)


def features(kind: Any, values: Iterable[object]) -> frozenset[Feature]:
    """The features that some values of a dataclass ask for by themselves, without their parts."""
    asked = {one for value in values for name, usual, one in _featured(kind) if getattr(value, name) != usual}
    return frozenset(asked) if asked else _NO_FEATURES


_NO_FEATURES: Final = frozenset[Feature]()


@cache
def _featured(kind: Any) -> list[tuple[str, Any, Feature]]:
    """The attributes of a dataclass that ask for a feature unless they have their defaults, with these."""
    return [(each.name, each.default, each.row.feature) for each in attributes(kind) if each.row.feature is not None]


def limits(kind: type[Any]) -> Mapping[str, Attribute]:
    """The attributes of a dataclass that can only forbid plans, by key."""
    return {each.key: each for each in attributes(kind) if each.row.is_limit}


def least_limit(value: int | Mapping[str, int] | None) -> int | None:
    """The least number in the value of a field that limits units; None if it limits nothing."""
    return min(value.values(), default=None) if isinstance(value, Mapping) else value


def shown_of(part: object) -> list[str]:
    """The lines that pictures show of the fields of a part."""
    rows = [(each.name, each.row.shown) for each in attributes(type(part)) if each.row.shown is not None]
    return [line for name, shown in rows for line in shown(getattr(part, name))]
