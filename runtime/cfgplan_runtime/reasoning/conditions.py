"""The conditions of a formula on one state, and their evaluation: comparisons, regions, and relations between regions.

A missing value makes a condition unknown. An unsuitable value does so too, and is also reported.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple, TypeAlias

from cfgplan.errors import CfgplanError
from cfgplan_runtime.reasoning.program import Program, truth_of
from cfgplan_runtime.reasoning.regions import NotAPointError, NotARegionError, Region, point_from, rcc8, region_from
from cfgplan_runtime.reasoning.truth import FALSE, TRUE, UNKNOWN, Truth

RCC8 = ("dc", "ec", "po", "tpp", "ntpp", "tppi", "ntppi", "eq")
"""Disconnected, externally connected, partially overlapping, (non-)tangential proper part and its inverse, equal."""

_COMPARE: Final[Mapping[str, Callable[[Any, Any], bool]]] = {
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
    "==": operator.eq,
    "!=": operator.ne,
}
_CALCULATE: Final[Mapping[str, Callable[[float, float], float]]] = {
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "/": operator.truediv,
}
_MOST_LISTED = 12


class NoValueError(CfgplanError):
    """A feature that has no value in a state."""


class UnsuitableValueError(CfgplanError):
    """A value that can't decide a condition, such as one without the field."""


class FeatureValues(NamedTuple):
    """The value of each feature in a state, except missing ones, and the named regions."""

    features: Mapping[str, Any]
    regions: Mapping[str, Region]


@dataclass(frozen=True, slots=True)
class Field:
    """A feature's value, or the entry of it under these keys and list positions."""

    feature: str
    keys: tuple[str | int, ...] = ()

    def __str__(self) -> str:
        return self.feature + "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in self.keys)

    def value(self, values: FeatureValues) -> Any:
        """The entry's value. Raises NoValueError, UnsuitableValueError."""
        value = values.features.get(self.feature)
        for position, key in enumerate(self.keys):
            if value is None:
                break
            whole = Field(self.feature, self.keys[:position])
            if isinstance(key, int):
                if isinstance(value, (str, bytes, Mapping)) or not hasattr(value, "__getitem__"):
                    raise UnsuitableValueError(f"{whole} is {_shown(value)}, not a list")
                if key >= len(value):
                    raise UnsuitableValueError(f"{whole} has only {len(value)} members")
            elif not isinstance(value, Mapping):
                raise UnsuitableValueError(f"{whole} is {_shown(value)} and has no field `{key}`")
            elif key not in value:
                names = ", ".join(sorted(map(str, value))[:_MOST_LISTED]) or "none"
                raise UnsuitableValueError(f"{whole} has no field `{key}`; it has {names}")
            value = value[key]
        if value is None:
            raise NoValueError
        return value

    def point(self, values: FeatureValues) -> tuple[float, float]:
        """The entry as a point. Raises NoValueError, UnsuitableValueError."""
        try:
            point = point_from(self.value(values))
        except NotAPointError as error:
            raise UnsuitableValueError(f"{self} is {error}") from None
        if any(map(math.isnan, point)):
            raise NoValueError
        return point

    def region(self, values: FeatureValues) -> Region:
        """The entry as a region. Raises NoValueError, UnsuitableValueError."""
        try:
            return region_from(self.value(values))
        except NotARegionError as error:
            raise UnsuitableValueError(f"{self} is not a region: {error}") from None


@dataclass(frozen=True, slots=True)
class Literal:
    """A number, a text or a truth value."""

    written: float | str | bool

    def __str__(self) -> str:
        if isinstance(self.written, float):
            return f"{self.written:.15g}"
        return f'"{self.written}"' if isinstance(self.written, str) else str(self.written).lower()

    def value(self, _: FeatureValues) -> float | str | bool:
        return self.written


@dataclass(frozen=True, slots=True)
class Arithmetic:
    """Two numbers joined by +, -, * or /."""

    sign: str
    left: Value
    right: Value

    def __str__(self) -> str:
        return f"({self.left} {self.sign} {self.right})"

    def value(self, values: FeatureValues) -> float:
        left, right = _number(self.left, values), _number(self.right, values)
        if self.sign == "/" and right == 0:
            raise UnsuitableValueError(f"{self.right} is 0")
        return _CALCULATE[self.sign](left, right)


@dataclass(frozen=True, slots=True)
class Absolute:
    """A number without its sign."""

    part: Value

    def __str__(self) -> str:
        return f"abs({self.part})"

    def value(self, values: FeatureValues) -> float:
        return abs(_number(self.part, values))


@dataclass(frozen=True, slots=True)
class Distance:
    """The distance between two points."""

    left: Field
    right: Field

    def __str__(self) -> str:
        return f"distance({self.left}, {self.right})"

    def value(self, values: FeatureValues) -> float:
        return math.dist(self.left.point(values), self.right.point(values))


Value: TypeAlias = Field | Literal | Arithmetic | Absolute | Distance


@dataclass(frozen=True, slots=True)
class Comparison:
    """Two numbers, or two texts, compared by `<=`, `>=`, `==`, `!=`, `<` or `>`."""

    sign: str
    left: Value
    right: Value

    def __str__(self) -> str:
        return f"{self.left} {self.sign} {self.right}"

    def holds(self, values: FeatureValues) -> bool:
        left, right = self.left.value(values), self.right.value(values)
        if isinstance(left, str) and isinstance(right, str):
            return _COMPARE[self.sign](left, right)
        if _is_truth_value(left) and _is_truth_value(right) and self.sign in ("==", "!="):
            return _COMPARE[self.sign](bool(left), bool(right))
        numbers = _float(left), _float(right)
        if numbers[0] is None or numbers[1] is None:
            for part, value in ((self.left, left), (self.right, right)):
                if isinstance(value, Mapping) and value:
                    field = f"{part}.{next(iter(value))}"
                    raise UnsuitableValueError(f"{part} is a mapping: compare one of its fields, such as {field}")
            raise UnsuitableValueError(f"{_shown(left)} and {_shown(right)} are compared by {self.sign}")
        if math.isnan(numbers[0]) or math.isnan(numbers[1]):
            raise NoValueError
        return _COMPARE[self.sign](*numbers)


@dataclass(frozen=True, slots=True)
class Flag:
    """A field that is true or false."""

    field: Field

    def __str__(self) -> str:
        return str(self.field)

    def holds(self, values: FeatureValues) -> bool:
        value = self.field.value(values)
        if not _is_truth_value(value):
            raise UnsuitableValueError(f"{self.field} is {_shown(value)}, not true or false")
        return bool(value)


@dataclass(frozen=True, slots=True)
class RegionName:
    """A region that the features file or the command line names."""

    name: str

    def __str__(self) -> str:
        return self.name

    def region(self, values: FeatureValues) -> Region:
        return values.regions[self.name]


@dataclass(frozen=True, slots=True)
class Membership:
    """A point in a region or on its edge."""

    point: Field
    area: RegionName | Field

    def __str__(self) -> str:
        return f"in({self.point}, {self.area})"

    def holds(self, values: FeatureValues) -> bool:
        return self.area.region(values).has(self.point.point(values))


@dataclass(frozen=True, slots=True)
class Relation:
    """One of the RCC8 relations between two regions."""

    name: str
    left: RegionName | Field
    right: RegionName | Field

    def __str__(self) -> str:
        return f"{self.name}({self.left}, {self.right})"

    def holds(self, values: FeatureValues) -> bool:
        return rcc8(self.left.region(values), self.right.region(values)) == self.name


Condition: TypeAlias = Comparison | Flag | Membership | Relation


def _number(part: Value, values: FeatureValues) -> float:
    found = part.value(values)
    number = _float(found)
    if number is None:
        raise UnsuitableValueError(f"{part} is {_shown(found)}, not a number")
    return number


def _float(value: Any) -> float | None:
    """A value as a number; None for a text, a truth value and every other value that is no number."""
    if _is_truth_value(value) or isinstance(value, (str, bytes)):
        return None
    try:
        return float(value)
    except (TypeError, ValueError, OverflowError):
        return None


def _is_truth_value(value: Any) -> bool:
    return isinstance(value, bool) or (getattr(value, "ndim", 1) == 0 and str(value.dtype) == "bool")


def _shown(value: Any) -> str:
    if isinstance(value, str):
        return f'"{value[:20]}"'
    if isinstance(value, (bool, int, float)):
        return str(value)
    return f"a {type(value).__name__}"


_MOST_TOLD = 12


class Evaluator:
    """Decides the propositions of a program; calls `tell` once for each kind of unsuitable value."""

    def __init__(self, program: Program, regions: Mapping[str, Region], tell: Callable[[str], None]) -> None:
        self._propositions = program.propositions
        self._regions = regions
        self._tell = tell
        self._told: set[str] = set()
        self.last: Mapping[object, Truth] = {}
        """The truth of each condition that was evaluated in the last state."""

    def truths(self, features: Mapping[str, Any]) -> Sequence[Truth]:
        """The truth of each proposition in a state; features that are not in the mapping are missing."""
        values = FeatureValues(features, self._regions)
        known: dict[object, Truth] = {}

        def atom(condition: Any) -> Truth:
            if condition not in known:
                known[condition] = self._truth(condition, values)
            return known[condition]

        found = [truth_of(proposition, atom) for proposition in self._propositions]
        self.last = known
        return found

    def _truth(self, condition: Condition, values: FeatureValues) -> Truth:
        try:
            return TRUE if condition.holds(values) else FALSE
        except NoValueError:
            return UNKNOWN
        except UnsuitableValueError as error:
            text = f"{condition} is unknown where {error}"
            if text not in self._told and len(self._told) < _MOST_TOLD:
                self._told.add(text)
                self._tell(text)
            return UNKNOWN
