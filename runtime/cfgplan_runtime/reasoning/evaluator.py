"""The truth of conditions in a state: what is missing or unsuitable is unknown, and what is unsuitable is also told."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, TypeAlias

from cfgplan.errors import CfgplanError
from cfgplan_runtime.reasoning.conditions import (
    Absolute,
    Arithmetic,
    Comparison,
    Condition,
    Distance,
    Field,
    Flag,
    Literal,
    Membership,
    RegionName,
    Relation,
    Value,
)
from cfgplan_runtime.reasoning.program import Program, truth_of
from cfgplan_runtime.reasoning.regions import (
    NotAPointError,
    NotARegionError,
    Region,
    point_from,
    rcc8,
    region_from,
)
from cfgplan_runtime.reasoning.truth import FALSE, TRUE, UNKNOWN, Truth

FeatureValues: TypeAlias = Mapping[str, Any]
"""The value of each feature in a state; a feature without one is missing."""

_COMPARE: Final[Mapping[str, Callable[[Any, Any], bool]]] = {
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
    "==": operator.eq,
    "!=": operator.ne,
}
_MOST_LISTED = 12


class NoValueError(CfgplanError):
    """A feature that has no value in a state."""


class UnsuitableValueError(CfgplanError):
    """A value that a condition can't be decided by, such as one without the field."""


class Evaluator:
    """Decides the propositions of a program; `tell` is called once for each sort of unsuitable value."""

    def __init__(self, program: Program, regions: Mapping[str, Region], tell: Callable[[str], None]) -> None:
        self._propositions = program.propositions
        self._regions = regions
        self._tell = tell
        self._told: set[str] = set()
        self.last: Mapping[object, Truth] = {}
        """The truth of each condition that mattered in the last state."""

    def truths(self, values: FeatureValues) -> Sequence[Truth]:
        """The truth of each proposition in a state."""
        known: dict[object, Truth] = {}

        def atom(condition: Any) -> Truth:
            if condition not in known:
                known[condition] = self.truth(condition, values)
            return known[condition]

        found = [truth_of(proposition, atom) for proposition in self._propositions]
        self.last = known
        return found

    def truth(self, condition: Condition, values: FeatureValues) -> Truth:
        """The truth of one condition in a state."""
        try:
            return TRUE if self._holds(condition, values) else FALSE
        except NoValueError:
            return UNKNOWN
        except (UnsuitableValueError, NotAPointError, NotARegionError) as error:
            text = f"{condition} is unknown where {error}"
            if text not in self._told and len(self._told) < _MOST_LISTED:
                self._told.add(text)
                self._tell(text)
            return UNKNOWN

    def _holds(self, condition: Condition, values: FeatureValues) -> bool:
        match condition:
            case Comparison(sign, left, right):
                return _compared(sign, _value(left, values), _value(right, values))
            case Flag(field):
                value = _field(field, values)
                if not _is_truth_value(value):
                    raise UnsuitableValueError(f"{field} is {_shown(value)}, not true or false")
                return bool(value)
            case Membership(point, region):
                return self._region(region, values).has(_point(point, values))
            case Relation(name, left, right):
                return rcc8(self._region(left, values), self._region(right, values)) == name

    def _region(self, region: RegionName | Field, values: FeatureValues) -> Region:
        if isinstance(region, RegionName):
            return self._regions[region.name]
        try:
            return region_from(_field(region, values))
        except NotARegionError as error:
            raise UnsuitableValueError(f"{region} is no region: {error}") from None


def _value(value: Value, values: FeatureValues) -> Any:
    match value:
        case Literal(literal):
            return literal
        case Field():
            return _field(value, values)
        case Absolute(part):
            return abs(_number(part, values))
        case Distance(left, right):
            return math.dist(_point(left, values), _point(right, values))
        case Arithmetic(sign, left, right):
            one, other = _number(left, values), _number(right, values)
            if sign == "/":
                if other == 0:
                    raise UnsuitableValueError(f"{right} is 0")
                return one / other
            return one + other if sign == "+" else one - other if sign == "-" else one * other


def _number(value: Value, values: FeatureValues) -> float:
    found = _value(value, values)
    if _is_truth_value(found) or isinstance(found, (str, bytes)):
        raise UnsuitableValueError(f"{value} is {_shown(found)}, no number")
    try:
        return float(found)
    except (TypeError, ValueError, OverflowError):
        raise UnsuitableValueError(f"{value} is {_shown(found)}, no number") from None


def _compared(sign: str, left: Any, right: Any) -> bool:
    if isinstance(left, str) and isinstance(right, str):
        return _COMPARE[sign](left, right)
    if _is_truth_value(left) and _is_truth_value(right) and sign in ("==", "!="):
        return _COMPARE[sign](bool(left), bool(right))
    numbers = []
    for value in (left, right):
        if isinstance(value, (str, bytes)) or _is_truth_value(value):
            raise UnsuitableValueError(f"{_shown(left)} and {_shown(right)} are compared by {sign}")
        try:
            numbers.append(float(value))
        except (TypeError, ValueError, OverflowError):
            raise UnsuitableValueError(f"{_shown(left)} and {_shown(right)} are compared by {sign}") from None
    if any(map(math.isnan, numbers)):
        raise NoValueError
    return _COMPARE[sign](*numbers)


def _point(field: Field, values: FeatureValues) -> tuple[float, float]:
    try:
        point = point_from(_field(field, values))
    except NotAPointError as error:
        raise UnsuitableValueError(f"{field} is {error}") from None
    if any(map(math.isnan, point)):
        raise NoValueError
    return point


def _field(field: Field, values: FeatureValues) -> Any:
    value = values.get(field.feature)
    for position, key in enumerate(field.keys):
        if value is None:
            break
        whole = Field(field.feature, field.keys[:position])
        if isinstance(key, int):
            if isinstance(value, (str, bytes, Mapping)) or not hasattr(value, "__getitem__"):
                raise UnsuitableValueError(f"{whole} is {_shown(value)}, no list")
            if key >= len(value):
                raise UnsuitableValueError(f"{whole} has only {len(value)} members")
            value = value[key]
        elif not isinstance(value, Mapping):
            raise UnsuitableValueError(f"{whole} is {_shown(value)} and has no field `{key}`")
        elif key not in value:
            names = ", ".join(sorted(map(str, value))[:_MOST_LISTED]) or "none"
            raise UnsuitableValueError(f"{whole} has no field `{key}`; it has {names}")
        else:
            value = value[key]
    if value is None:
        raise NoValueError
    return value


def _is_truth_value(value: Any) -> bool:
    return isinstance(value, bool) or (getattr(value, "ndim", 1) == 0 and str(value.dtype) == "bool")


def _shown(value: Any) -> str:
    if isinstance(value, str):
        return f'"{value[:20]}"'
    if isinstance(value, (bool, int, float)):
        return str(value)
    return f"a {type(value).__name__}"
