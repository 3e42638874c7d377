"""What the public API hands out is a value: it can be copied, and sent to other processes."""

from __future__ import annotations

import copy
import inspect
import pickle
from collections.abc import Mapping
from dataclasses import is_dataclass, replace
from enum import Enum
from fractions import Fraction
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
from cfgplan_runtime.errors import ApplyError, NoSourceError

import cfgplan
from cfgplan.errors import InputError, TagError

ROOT = Path(__file__).parent.parent
PACKAGES = (
    "cfgplan",
    "cfgplan.explaining",
    "cfgplan.matching",
    "cfgplan.testing",
    "cfgplan_runtime",
    "cfgplan_runtime.testing",
)
NO_VALUES = {
    "Bench": "holds a middleware",
    "Endings": "holds functions of a middleware",
    "Hosts": "holds functions of a middleware",
    "Manager": "owns a thread",
    "Matcher": "owns a reasoner",
    "Matches": "owns a reasoner",
    "Planner": "a protocol",
    "Runtime": "owns processes",
    "SimulatedBackend": "changes",
    "SimulatedRuntime": "changes",
    "Supervisor": "owns processes",
}


def public() -> dict[str, type]:
    """The public classes by name."""
    found = {}
    for package in map(import_module, PACKAGES):
        names = getattr(package, "__all__", None) or [name for name in vars(package) if not name.startswith("_")]
        for name in names:
            kind = getattr(package, name)
            is_ours = isinstance(kind, type) and kind.__module__.startswith("cfgplan")
            if is_ours and name not in NO_VALUES:
                found[f"{package.__name__}.{name}"] = kind
    return found


SAMPLES: dict[str, object] = {
    "int": 3,
    "float": 2.5,
    "str": "x",
    "bool": True,
    "Any": (1, "x"),
    "object": (1, "x"),
    "Natural": 3,
    "value": 1,
    "Fraction": Fraction(1, 3),
    "dict[str, float]": {"x": 0.5},
}
"""A value for each annotation that is no class."""


def sample(cls: type) -> object:
    """A value of a class, with something for each argument that it must be given."""
    if issubclass(cls, Enum):
        return next(iter(cls))
    if issubclass(cls, cfgplan.InvalidValueError) or cls.__init__ is Exception.__init__:
        return cls("no")
    if issubclass(cls, cfgplan.Target):
        return cls("x", "X", "/x")  # it needs a topic or `run`
    names = {**vars(cfgplan.planning), **vars(cfgplan.domain), **vars(import_module(cls.__module__))}
    needed = [each for each in inspect.signature(cls).parameters.values() if each.default is each.empty]
    return cls(**{each.name: argument(told(each.annotation), names) for each in needed})


def told(annotation: object) -> str:
    return annotation if isinstance(annotation, str) else inspect.formatannotation(annotation)


def argument(annotation: str, names: Mapping[str, Any]) -> object:
    """A value for an annotation's text."""
    if annotation.endswith(" | None"):
        return None
    if annotation.startswith(("tuple[", "Iterable[", "list[", "frozenset[")):
        return ()
    if annotation.startswith("Mapping["):
        return {}
    return SAMPLES[annotation] if annotation in SAMPLES else sample(names[annotation])


def same(one: object, other: object) -> bool:
    """Whether two values are equal; errors are if they say the same and have the same attributes."""
    if isinstance(one, BaseException):
        return type(one) is type(other) and str(one) == str(other) and vars(one) == vars(other)
    return type(one) is type(other) and one == other


def check_value(value: object) -> None:
    for again in (copy.copy(value), copy.deepcopy(value), pickle.loads(pickle.dumps(value))):
        assert same(again, value), again
        if is_dataclass(value):
            assert hash(again) == hash(value)


@pytest.mark.parametrize("name", public())
def test_every_public_value_is_copied_and_pickled(name: str) -> None:
    check_value(sample(public()[name]))


def test_every_name_without_a_value_is_still_public() -> None:
    names = {name for package in map(import_module, PACKAGES) for name in dir(package)}
    assert NO_VALUES.keys() <= names


@pytest.fixture(scope="module")
def answered() -> tuple[cfgplan.World, cfgplan.Problem, cfgplan.Plan]:
    world = cfgplan.load(ROOT / "models" / "nao" / "2-segmenter-lost.yaml")
    return world, *cfgplan.solve(world)


def test_a_world_its_problem_and_all_answers_are_copied_and_pickled(
    answered: tuple[cfgplan.World, cfgplan.Problem, cfgplan.Plan],
) -> None:
    world, problem, plan = answered
    lost = cfgplan.match(cfgplan.what_if(world, without=["subsampler(piff)"]))
    wrong = replace(plan, cost_us=0, bound_us=0)
    for value in (
        *(world, problem, plan, cfgplan.match_ports(world)),
        cfgplan.why(problem, plan, "unit", "segmenter(piff).1"),
        cfgplan.why_not(world, lost),
        cfgplan.alternatives(problem, 2),
        cfgplan.sensitivity(problem),
        cfgplan.best_effort(lost),
        cfgplan.plan_violations(problem, wrong),
        cfgplan.UntruthfulPlanError(wrong, cfgplan.plan_violations(problem, wrong)),
        InputError([cfgplan.Fault("no", "a.yaml", 1, 2, "key", "mend")]),
        TagError("no", 3, "mend"),
        ApplyError("no", ["a.1"]),
        NoSourceError("no", ["a"], "cause"),
    ):
        check_value(value)


def test_a_world_that_was_asked_for_everything_that_is_derived_is_copied_and_pickled(
    answered: tuple[cfgplan.World, cfgplan.Problem, cfgplan.Plan],
) -> None:
    """What is derived is kept in the value, and may be a view that can't be pickled."""
    world, problem, plan = answered
    for value in (world, world.environment, world.ontology, problem, plan, *world.environment.library):
        for name, attribute in vars(type(value)).items():
            if isinstance(attribute, (cached_property, property)):
                getattr(value, name)
        check_value(value)
