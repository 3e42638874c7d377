"""Each argument of each public constructor and function is checked: wrong values are refused by name.

The arguments are walked by their annotations. What is wrong for which is written here, and not asked of the product.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cfgplan
from cfgplan import matching, testing
from cfgplan.arguments import checked
from cfgplan.errors import InvalidValueError
from cfgplan.planners import cpsat
from cfgplan.planning import Measured
from cfgplan.transformations import RunOptions

ROOT = Path(__file__).parent.parent
UNCHECKED = {"Fault", "PlannerFault", "PlannerReport", "Solved"}
"""What cfgplan makes for its users, and they do not make."""
CHECKED_BY_HAND = {"check_tag", "read_owlready"}
"""The first is called for each tag of a file; the other takes an object of a package that is imported late."""
OBJECT = object()
WRONG: dict[str, tuple[object, ...]] = {
    "int": (math.nan, "10", True, 1.5, OBJECT),
    "Natural": (math.nan, math.inf, "10", True, 1.5, -1, OBJECT),
    "Annotated[int, AtLeast(1)]": (math.nan, "10", True, 1.5, 0, -1, OBJECT),
    "float": (math.nan, "10", True, OBJECT),
    "Annotated[float, AtLeast(0)]": (math.nan, "10", True, -1, -0.5, OBJECT),
    "Seconds": (math.nan, "10", True, -1, -0.5, OBJECT),
    "str": (3, b"x", OBJECT),
    "bool": (1, "yes", OBJECT),
    "object": (),
}
"""Values that are wrong for an annotation; of others, an object of no class is."""
LISTS = ("tuple[", "Collection[", "Sequence[", "frozenset[")


def wrong_for(annotation: str) -> tuple[object, ...]:
    """Values that an annotation does not allow."""
    alone = annotation.removesuffix(" | None")
    wrong = WRONG.get(alone, (OBJECT, 3.5, cfgplan.OutputPort("x", "T")))
    if alone.startswith(LISTS):
        wrong = (*wrong, (OBJECT,), "text", 3)
    if alone.startswith(("Mapping[str, int]", "Mapping[str, Natural]")):
        wrong = (*wrong, {"x": "3"}, {"x": True}, {3: 3})
    return wrong if annotation.endswith("None") else (*wrong, *(() if annotation == "object" else (None,)))


def public() -> Iterator[tuple[str, Callable[..., Any]]]:
    """The public constructors and functions, and those that their arguments are made of."""
    for package in (cfgplan, testing):
        for name in package.__all__:
            found = getattr(package, name)
            is_made = inspect.isclass(found) and "__dataclass_fields__" in vars(found)
            if (is_made or inspect.isfunction(found)) and name not in UNCHECKED:
                yield name, found
    for name in matching.__all__:
        found = getattr(matching, name)
        if inspect.isfunction(found) and name not in CHECKED_BY_HAND:
            yield f"matching.{name}", found
    yield from (("Link", cfgplan.domain.Link), ("Measured", Measured), ("RunOptions", RunOptions))


PUBLIC = dict(public())
CASES = [
    pytest.param(name, argument, wrong, id=f"{name}-{argument}-{number}")
    for name, call in PUBLIC.items()
    for argument, each in inspect.signature(call).parameters.items()
    for number, wrong in enumerate(wrong_for(str(each.annotation)))
]


@pytest.fixture(scope="module")
def right() -> dict[str, dict[str, object]]:
    """Right values of the arguments that have no defaults, by the name of what takes them."""
    environment = cfgplan.Environment()
    world = cfgplan.world(environment, horizon_s=1)
    problem, plan = cfgplan.solve(world)
    named = {
        "environment": environment,
        "world": world,
        "problem": problem,
        "plan": plan,
        "similarity": problem.similarity,
        "ontology": world.ontology,
    }
    tags = {"paths": [], "offered": ["A"], "demanded": ["A"], "offered_tags": ["A"], "demanded_tags": ["A"]}
    return {"": {**tags, **named}, "check_planner": {"plan": len}, "examine_planner": {"plan": len}}


def value_of(name: str, argument: inspect.Parameter, right: dict[str, dict[str, object]]) -> object:
    known = {**right[""], **right.get(name, {})}
    if argument.name in known:
        return known[argument.name]
    samples = {
        "str": "x",
        "int": 1,
        "Natural": 1,
        "float": 1.0,
        "Annotated[int, AtLeast(1)]": 1,
        "Stream": cfgplan.Stream("a.1", "x"),
        "Subject": "unit",
        "Better": cfgplan.Better.LOWER,
        "QualityRule": cfgplan.qualities.QualityRule.ADD,
        "Objective": cfgplan.domain.Objective.COST,
        "Status": cfgplan.Status.UNKNOWN,
        "Rule": cfgplan.Rule.FED,
        "tuple[str, str]": ("a", "b"),
    }
    text = str(argument.annotation)
    if text.startswith("Mapping["):
        return {}
    return None if text.endswith("None") else () if text.startswith("tuple[P") else samples.get(text, "x")


@pytest.mark.parametrize(("name", "argument", "wrong"), CASES)
def test_a_wrong_value_is_refused_by_the_name_of_its_argument(
    name: str, argument: str, wrong: object, right: dict[str, dict[str, object]]
) -> None:
    call = PUBLIC[name]
    needed = {
        each.name: value_of(name, each, right)
        for each in inspect.signature(call).parameters.values()
        if each.default is each.empty
    }
    with pytest.raises(InvalidValueError, match=rf"\b{argument} must be .*, but (is|has) ") as caught:
        call(**{**needed, argument: wrong})
    if isinstance(wrong, (int, float, str)):
        assert repr(wrong) in str(caught.value)


def test_most_arguments_are_walked() -> None:
    assert len(PUBLIC) > 35
    assert len(CASES) > 500


@pytest.mark.parametrize("number", [np.int64(3), np.uint8(3)])
def test_whole_numbers_of_numpy_become_ints(number: Any) -> None:
    made = cfgplan.Transformation("t", labor_us=number, needs={"gpu": number})
    assert type(made.labor_us) is int
    assert type(made.needs["gpu"]) is int
    assert made == cfgplan.Transformation("t", labor_us=3, needs={"gpu": 3})
    assert cfgplan.world(cfgplan.Environment(), horizon_s=number).horizon_s == 3


def test_lists_become_tuples() -> None:
    port = cfgplan.OutputPort("x", "T")
    made = cfgplan.Transformation("t", outputs=[port])  # type: ignore[arg-type]
    assert made == cfgplan.Transformation("t", outputs=(port,))
    links = [cfgplan.domain.Link(["a", "b"])]  # type: ignore[arg-type]
    assert cfgplan.Environment(links=links).links == (cfgplan.domain.Link(("a", "b")),)  # type: ignore[arg-type]


def test_the_value_that_is_wrong_in_a_list_is_named() -> None:
    with pytest.raises(InvalidValueError, match=r"inputs must be a tuple, each item an InputPort, but has 'x' in it"):
        cfgplan.Transformation("t", inputs=("x",))  # type: ignore[arg-type]


def test_a_function_that_is_no_planner_is_told_from_a_name() -> None:
    problem = cfgplan.match(cfgplan.world(cfgplan.Environment(), horizon_s=1))
    with pytest.raises(InvalidValueError, match="planner must be a text or a function, but is 3"):
        cfgplan.plan(problem, planner=3)  # type: ignore[arg-type]


def test_an_ontology_that_is_none_is_refused() -> None:
    for wrong in (3, {"a.owl"}, [3], [OBJECT], OBJECT, cfgplan.Environment):
        with pytest.raises(InvalidValueError, match=r"world\(\): ontology must be None, an owlready2 .*, but is "):
            cfgplan.world(cfgplan.Environment(), horizon_s=1, ontology=wrong)
        with pytest.raises(InvalidValueError, match=r"read_owlready\(\): onto must be an owlready2 ontology, but is "):
            matching.read_owlready(wrong)


def test_a_class_of_the_same_name_is_told_with_its_package() -> None:
    from owlready2 import get_ontology

    ontology: Any = get_ontology("http://a.org/b#")
    with pytest.raises(InvalidValueError, match=r"ontology must be an Ontology, but is an Ontology of owlready2$"):
        matching.match(["A"], ["A"], ontology)


def test_ontology_files_may_be_named_by_texts(tmp_path: Path) -> None:
    file = tmp_path / "a.ttl"
    file.write_text("@prefix : <http://a#> . @prefix owl: <http://www.w3.org/2002/07/owl#> . :A a owl:Class .")
    named = matching.load_ontology([str(file)], {"http://b": str(file)})
    assert matching.match(["A"], ["A"], named).similarity.holds("A", "A")


@pytest.mark.parametrize("plan", [cpsat.plan, cpsat.PlannerSession().plan], ids=["plan", "session"])
def test_the_planner_refuses_what_it_can_not_plan(plan: Callable[..., Any]) -> None:
    world = cfgplan.world(cfgplan.Environment(), horizon_s=1)
    for wrong in (world, world.environment, None):
        with pytest.raises(InvalidValueError, match=r"problem must be a Problem, but is "):
            plan(wrong)
    for limit in (-1, math.nan, "3"):
        with pytest.raises(InvalidValueError, match=r"time_limit_s must be a number of 0 or more or None, but is "):
            plan(cfgplan.match(world), time_limit_s=limit)


def test_a_missing_and_an_unknown_argument_are_told_with_the_function() -> None:
    with pytest.raises(TypeError, match=r"world\(\): missing a required argument: 'horizon_s'"):
        cfgplan.world(cfgplan.Environment())  # type: ignore[call-arg]
    with pytest.raises(TypeError, match=r"solve\(\): got an unexpected keyword argument 'timeout'"):
        cfgplan.solve(cfgplan.world(cfgplan.Environment(), horizon_s=1), timeout=3)  # type: ignore[call-arg]


def test_the_first_value_may_be_of_a_subclass_with_fields_of_its_own() -> None:
    @dataclass(frozen=True)
    @checked
    class Base:
        number: int

    @dataclass(frozen=True)
    class Derived(Base):
        text: str = ""

    assert Derived(1, "a").text == "a"
    assert Base(2).number == 2
    with pytest.raises(InvalidValueError, match="number"):
        Base("3")  # type: ignore[arg-type]
