"""Hypothetical problems: without some of their parts, or with other demands."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from decimal import Decimal, InvalidOperation
from types import MappingProxyType
from typing import Any

from cfgplan.costs import horizon_s, microseconds
from cfgplan.domain import Environment, OutputPort, Similarity, Target
from cfgplan.errors import Fault, InputError, InvalidValueError, known
from cfgplan.planning import Problem

_TRUTH = {"true": True, "yes": True, "false": False, "no": False}
_USED = "\0used"
LARGEST_PRIORITY = 1_000_000_000
"""As in files."""


@dataclass(frozen=True)
class Supposed:
    """A hypothetical environment, horizon in seconds and largest cost in microseconds."""

    environment: Environment
    horizon_s: int
    max_cost_us: int | None


def without(environment: Environment, names: Collection[str]) -> Environment:
    """The environment without these transformations, running units or targets, by label or id.

    A name that several kinds share needs its kind: `target heat`, `unit heat` or `transformation heat`. A unit that is
    gone leaves gaps in those that it fed, as one that has died. Raises InputError.
    """
    there: Mapping[str, Collection[str]] = {
        "transformation": environment.transformation,
        "unit": environment.unit,
        "target": environment.target,
    }
    gone = defaultdict[str, set[str]](set)
    faults = list[Fault]()
    for name in names:
        try:
            kind, meant = _named(name, there)
        except InputError as error:
            faults += (replace(fault, key="--without") for fault in error.faults)
        else:
            gone[kind].add(meant)
    if faults:
        raise InputError(faults)
    return replace(
        environment,
        units=tuple(unit for unit in environment.units if unit.id not in gone["unit"]),
        library=tuple(t for t in environment.library if t.label not in gone["transformation"]),
        targets=tuple(target for target in environment.targets if target.label not in gone["target"]),
    )


def _named(name: str, there: Mapping[str, Collection[str]]) -> tuple[str, str]:
    """Return the kind of a name, and the name without it. Raises InputError if there is no such name, or several."""
    kinds = [kind for kind, names in there.items() if name in names]
    kind, _, rest = name.partition(" ")
    if not kinds and rest in there.get(kind, ()):
        return kind, rest
    known(name, set().union(*there.values()), "transformation, unit or target")
    if len(kinds) > 1:
        mend = f"write {' or '.join(f'`{kind} {name}`' for kind in kinds)}"
        raise InputError.of(f"`{name}` names a {', a '.join(kinds[:-1])} and a {kinds[-1]}", mend=mend)
    return kinds[0], name


def with_settings(supposed: Supposed, settings: Mapping[str, str]) -> Supposed:
    """Return the same with other values of `horizon`, `max_cost`, facts, and properties of transformations or targets.

    Keys are `facts.NAME`, `facts.HOST.NAME`, `T.labor`, `T.upkeep` (CPU seconds), `T.pinned`, `T.required` (true or
    false) and, for a target, `T.priority`. Raises InputError with every setting that can't be made.
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
        return replace(supposed, horizon_s=horizon_s(value))
    if key == "max_cost":
        return replace(supposed, max_cost_us=_cost_us(value))
    label, _, name = key.rpartition(".")
    kind, _, fact = key.partition(".")
    if kind == "facts" and (fact in environment.variable or name not in _SETTINGS):
        known(fact, environment.variable, "fact")
        return replace(supposed, environment=environment.with_facts({fact: environment.variable[fact].read(value)}))
    if name not in _SETTINGS:
        keys = ["horizon", "max_cost", "facts.NAME", "facts.HOST.NAME", *(f"T.{each}" for each in _SETTINGS)]
        mend = f"write facts.{key}={value}" if key in environment.variable else f"set {', '.join(keys)}"
        raise InputError.of(f"{key!r} can't be set", mend=mend)
    attribute, read = _SETTINGS[name]
    if name == "priority":
        known(label, environment.target, "target")
        targets = (replace(t, priority=read(value)) if t.label == label else t for t in environment.targets)
        return replace(supposed, environment=replace(environment, targets=tuple(targets)))
    known(label, environment.transformation, "transformation")
    library = (replace(t, **{attribute: read(value)}) if t.label == label else t for t in environment.library)
    return replace(supposed, environment=replace(environment, library=tuple(library)))


def _cost_us(value: str) -> int:
    return microseconds(_number(value))


def _whole(value: str) -> int:
    number = _number(value)
    if not -LARGEST_PRIORITY <= number <= LARGEST_PRIORITY or number != number.to_integral_value():
        mend = f"write one from -{LARGEST_PRIORITY} to {LARGEST_PRIORITY}"
        raise InputError.of(f"{value!r} is not a whole number of a file", mend=mend)
    return int(number)


def _number(value: str) -> Decimal:
    try:
        number = Decimal(value)
    except InvalidOperation:
        number = Decimal("nan")
    if not number.is_finite():
        raise InputError.of(f"{value!r} is not a number", mend="write a number, such as 0.5")
    return number


def _flag(value: str) -> bool:
    if value.lower() not in _TRUTH:
        raise InputError.of(f"{value!r} is neither true nor false", mend="write true or false")
    return _TRUTH[value.lower()]


_SETTINGS: Mapping[str, tuple[str, Callable[[str], Any]]] = MappingProxyType(
    {
        "labor": ("labor_us", _cost_us),
        "upkeep": ("upkeep_us", _cost_us),
        "pinned": ("pinned", _flag),
        "required": ("required", _flag),
        "priority": ("priority", _whole),
    }
)
"""The settable attributes of a transformation (the last one: of a target), and how a value is read."""


def without_transformations(problem: Problem, labels: Collection[str]) -> Problem:
    """The problem without these transformations in the library."""
    return problem.with_parts(library=tuple(t for t in problem.environment.library if t.label not in labels))


def only_targets(problem: Problem, labels: Collection[str]) -> Problem:
    """The problem with these of its targets; itself if these are all."""
    targets = tuple(target for target in problem.environment.targets if target.label in labels)
    return problem if len(targets) == len(problem.environment.targets) else problem.with_parts(targets=targets)


def requiring(problem: Problem, labels: Collection[str]) -> Problem:
    """The problem in which just these transformations are required, whatever that costs."""
    library = (
        t if t.required == (t.label in labels) else replace(t, required=t.label in labels)
        for t in problem.environment.library
    )
    return replace(problem.with_parts(library=tuple(library)), max_cost_us=None)


def running(problem: Problem, label: str) -> Problem:
    """Return the problem whose only target wants a running unit of one transformation."""
    environment = problem.environment
    used = OutputPort(_USED, _USED)
    library = tuple(replace(t, outputs=(*t.outputs, used)) if t.label == label else t for t in environment.library)
    similarity = Similarity({**problem.similarity.offers, _USED: frozenset({_USED})}, problem.similarity.open)
    alone = replace(environment, units=(), library=library, targets=(Target(label, _USED, _USED),))
    return replace(problem, environment=alone, similarity=similarity)
