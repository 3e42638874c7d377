"""What if: an environment without some of what it has, or with other costs."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from decimal import Decimal, InvalidOperation

from cfgplan.costs import microseconds
from cfgplan.domain import Environment, Transformation
from cfgplan.errors import Fault, InputError, InvalidValueError, nearest

_COSTS = ("labor", "upkeep")
_FLAGS = ("pinned", "required")
_TRUTH = {"true": True, "yes": True, "false": False, "no": False}


@dataclass(frozen=True)
class Supposed:
    """An environment, a horizon in seconds and a largest cost in microseconds, as somebody supposes them to be."""

    environment: Environment
    horizon_s: int
    max_cost_us: int | None


def without(environment: Environment, names: Collection[str]) -> Environment:
    """The environment without these transformations, running units or targets, by label or id.

    A unit that is gone leaves gaps in those that it fed, as one that has died. Raises InputError.
    """
    faults = []
    for name in names:
        known = [*environment.transformation, *environment.unit, *environment.target]
        if name not in known:
            message = f"there is no transformation, unit or target {name!r}"
            faults.append(Fault(message, key="--without", mend=nearest(name, known)))
    if faults:
        raise InputError(faults)
    return replace(
        environment,
        units=tuple(unit for unit in environment.units if unit.id not in names),
        library=tuple(t for t in environment.library if t.label not in names),
        targets=tuple(target for target in environment.targets if target.label not in names),
    )


def with_settings(supposed: Supposed, settings: Mapping[str, str]) -> Supposed:
    """The same with other values: of `horizon`, `max_cost`, and of a transformation's or target's properties.

    Keys of those are `T.labor`, `T.upkeep` (CPU seconds), `T.pinned`, `T.required` (true or false) and, for a target,
    `T.priority`. Raises InputError with every setting that can't be made.
    """
    faults = []
    for key, value in settings.items():
        try:
            supposed = _with_setting(supposed, key, value)
        except InvalidValueError as error:
            faults.append(Fault(str(error), key=f"--set {key}={value}"))
        except InputError as error:
            faults += (replace(fault, key=f"--set {key}={value}") for fault in error.faults)
    if faults:
        raise InputError(faults)
    return supposed


def _with_setting(supposed: Supposed, key: str, value: str) -> Supposed:
    environment = supposed.environment
    if key == "horizon":
        return replace(supposed, horizon_s=_whole(value))
    if key == "max_cost":
        return replace(supposed, max_cost_us=_cost_us(value))
    label, _, name = key.rpartition(".")
    if name == "priority":
        if label not in environment.target:
            raise InputError.of(f"there is no target {label!r}", mend=nearest(label, environment.target))
        changed = replace(environment.target[label], priority=_whole(value, signed=True))
        targets = tuple(changed if t.label == label else t for t in environment.targets)
        return replace(supposed, environment=replace(environment, targets=targets))
    if name not in (*_COSTS, *_FLAGS):
        known = "horizon, max_cost, T.labor, T.upkeep, T.pinned, T.required or T.priority"
        raise InputError.of(f"{key!r} can't be set", mend=f"set {known}")
    if label not in environment.transformation:
        raise InputError.of(f"there is no transformation {label!r}", mend=nearest(label, environment.transformation))
    library = tuple(_changed(t, name, value) if t.label == label else t for t in environment.library)
    return replace(supposed, environment=replace(environment, library=library))


def _changed(transformation: Transformation, name: str, value: str) -> Transformation:
    if name == "labor":
        return replace(transformation, labor_us=_cost_us(value))
    if name == "upkeep":
        return replace(transformation, upkeep_us=_cost_us(value))
    if value.lower() not in _TRUTH:
        raise InputError.of(f"{value!r} is neither true nor false")
    is_so = _TRUTH[value.lower()]
    return replace(transformation, pinned=is_so) if name == "pinned" else replace(transformation, required=is_so)


def _cost_us(value: str) -> int:
    return microseconds(_number(value))


def _whole(value: str, *, signed: bool = False) -> int:
    number = _number(value)
    if number != number.to_integral_value() or (number < 0 and not signed):
        raise InputError.of(f"{value!r} is not a whole number" + ("" if signed else " of at least 0"))
    return int(number)


def _number(value: str) -> Decimal:
    try:
        number = Decimal(value)
    except InvalidOperation:
        number = Decimal("nan")
    if not number.is_finite():
        raise InputError.of(f"{value!r} is not a number")
    return number
