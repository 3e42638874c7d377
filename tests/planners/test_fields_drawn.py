"""Fleets of all features are drawn with every field that planning uses, so that the oracle looks at each of them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import is_dataclass

from fleets import TOGETHER, fleets, with_facts
from hypothesis import HealthCheck, Phase, find, settings
from hypothesis.errors import NoSuchExample

from cfgplan.domain import Environment
from cfgplan.facts import Fact
from cfgplan.planning import Problem
from cfgplan.rows import Use, attributes

Field = tuple[str, str]
"""A field: the name of a class of the domain, and of its attribute."""
MANY = settings(
    max_examples=1000, database=None, derandomize=True, phases=[Phase.generate], suppress_health_check=[*HealthCheck]
)
NOT_OF_FLEETS = {
    ("Fact", "by"): "a fact that a stream observes has a target by the time it is planned",
    ("Similarity", "open"): "undecided.py draws open pairs, whose plans have an oracle of their own",
}
KINDS_OF_PARTS = {Environment, Problem, Fact}
"""Classes whose fields are asked for; those of their parts are added as they are drawn."""


def said(value: object) -> Iterator[Field]:
    """Yield the fields of a value and its parts that are not at their defaults."""
    if isinstance(value, Mapping):
        value = tuple(value.values())
    if isinstance(value, tuple):
        for part in value:
            yield from said(part)
    elif is_dataclass(value) and hasattr(type(value), "__noted__"):
        KINDS_OF_PARTS.add(type(value))
        for each in attributes(type(value)):
            part = getattr(value, each.name)
            if part != each.default:
                yield type(value).__name__, each.name
                yield from said(part)


def test_each_field_that_planning_uses_is_drawn_by_the_generator_of_fleets() -> None:
    drawn: set[Field] = set()

    def missing() -> set[Field]:
        fields = ((kind, each) for kind in KINDS_OF_PARTS for each in attributes(kind))
        planned = {(kind.__name__, each.name) for kind, each in fields if Use.PLANNING in each.row.use}
        return planned - drawn - NOT_OF_FLEETS.keys()

    def is_all_drawn(problem: Problem) -> bool:
        drawn.update(said(problem))
        return not missing()

    try:
        find(with_facts(fleets(TOGETHER, most=2)), is_all_drawn, settings=MANY)
    except NoSuchExample:
        assert missing() == set()
    assert len(drawn) > 60
