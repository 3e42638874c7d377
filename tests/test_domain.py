"""The domain's values: canonical order, refusals, updates."""

from __future__ import annotations

from functools import cached_property

import numpy
import pytest

from cfgplan.domain import (
    ChangeSet,
    ComputationUnit,
    Environment,
    InputPort,
    OutputPort,
    Publication,
    Similarity,
    Stream,
    Subscription,
    Target,
    Transformation,
)
from cfgplan.errors import InvalidValueError
from cfgplan.planning import Problem, fresh_unit_ids

A = Transformation("a", (), (OutputPort("out", "A"),))
B = Transformation("b", (InputPort("in", "A"),), (OutputPort("out", "B"),))


def test_environments_are_equal_whatever_order_they_were_written_in() -> None:
    units = (ComputationUnit("a.1", "a"), ComputationUnit("a.2", "a"))
    targets = (Target("one", "A", "/one"), Target("two", "B", "/two"))
    assert Environment(units, (A, B), targets) == Environment(units[::-1], (B, A), targets[::-1])


def test_a_stream_is_read_up_to_the_last_slash() -> None:
    assert Stream.parse("cam(1/2).1/out") == Stream("cam(1/2).1", "out")
    assert str(Stream("a.1", "out")) == "a.1/out"


@pytest.mark.parametrize("text", ["", "a.1", "/out", "a.1/"])
def test_text_that_is_no_stream_is_refused(text: str) -> None:
    with pytest.raises(InvalidValueError, match="unit/port"):
        Stream.parse(text)


def test_names_must_be_unique() -> None:
    with pytest.raises(InvalidValueError, match="'a'"):
        Environment(library=(A, A))
    with pytest.raises(InvalidValueError, match="'x'"):
        Transformation("t", (InputPort("x", "A"),), (OutputPort("x", "B"),))
    with pytest.raises(InvalidValueError, match="'/one'"):
        Environment(targets=(Target("one", "A", "/one"), Target("two", "A", "/one")))


def test_negative_costs_are_refused() -> None:
    with pytest.raises(InvalidValueError, match="labor_us must be a whole number of 0 or more, but is -1"):
        Transformation("t", labor_us=-1)


def test_an_update_adds_before_it_removes() -> None:
    before = Environment((ComputationUnit("a.1", "a"),), (A,))
    fed = ComputationUnit("b.1", "b", (Subscription("in", Stream("a.1", "out")),))
    after = before.update(ChangeSet(started=(fed,), added_transformations=(B,)))
    assert after == Environment((ComputationUnit("a.1", "a"), fed), (A, B))
    assert before.library == (A,)
    assert after.update(ChangeSet(stopped=("b.1",), removed_transformations=("b",))) == before


def test_an_environment_with_other_units_is_the_one_that_is_made_of_them() -> None:
    units = (ComputationUnit("a.2", "a"), ComputationUnit("a.1", "a"))
    before = Environment((ComputationUnit("a.3", "a"),), (A, B), (Target("one", "A", "/one"),))
    derived = [name for name, value in vars(Environment).items() if isinstance(value, cached_property)]
    assert len({name: getattr(before, name) for name in derived}) > 10
    new = Environment(units, before.library, before.targets)
    assert before.with_units(units) == new
    assert {name: getattr(before.with_units(units), name) for name in derived} == {
        name: getattr(new, name) for name in derived
    }


def test_the_change_to_other_units_leads_there() -> None:
    before = Environment((ComputationUnit("a.1", "a"), ComputationUnit("a.2", "a")), (A,))
    units = (ComputationUnit("a.2", "a", (), (Publication("out", "/x"),)), ComputationUnit("a.3", "a"))
    changes = before.change_to(units)
    assert [u.id for u in changes.started] == ["a.3"]
    assert [u.id for u in changes.rewired] == ["a.2"]
    assert changes.stopped == ("a.1",)
    assert before.update(changes).units == units
    assert not before.change_to(before.units)


def test_what_does_not_run_can_not_be_stopped_and_what_runs_can_not_be_started() -> None:
    before = Environment((ComputationUnit("a.1", "a"),), (A,))
    with pytest.raises(InvalidValueError, match="does not run"):
        before.update(ChangeSet(stopped=("a.2",)))
    with pytest.raises(InvalidValueError, match="runs already"):
        before.update(ChangeSet(started=(ComputationUnit("a.1", "a"),)))


def test_a_change_set_names_each_unit_once() -> None:
    with pytest.raises(InvalidValueError, match=r"a\.1"):
        ChangeSet(started=(ComputationUnit("a.1", "a"),), stopped=("a.1",))


def test_similarity_is_directed() -> None:
    similarity = Similarity({"Image": frozenset({"Photo"})})
    assert similarity.holds("Photo", "Image")
    assert not similarity.holds("Image", "Photo")


def test_new_ids_avoid_running_units_and_dead_ones_that_are_still_subscribed_to() -> None:
    gap = ComputationUnit("b.1", "b", (Subscription("in", Stream("a.2", "out")),))
    environment = Environment((ComputationUnit("a.1", "a"), gap), (A, B))
    assert fresh_unit_ids(environment, ["a", "b"]) == {"a": "a.3", "b": "b.2"}


def test_costs_that_can_not_be_summed_exactly_are_refused() -> None:
    dear = Transformation("dear", upkeep_us=2**50)
    with pytest.raises(InvalidValueError, match="shorten the horizon"):
        Problem(Environment(library=(dear,)), Similarity({}), horizon_s=8)
    with pytest.raises(InvalidValueError, match="horizon"):
        Problem(Environment(), Similarity({}), horizon_s=-1)


@pytest.mark.parametrize("value", [1.5, "1", float("nan")])
def test_costs_and_horizons_are_whole_numbers(value: object) -> None:
    for make in (
        lambda: Transformation("a", labor_us=value),  # type: ignore[arg-type]
        lambda: Transformation("a", upkeep_us=value),  # type: ignore[arg-type]
        lambda: Problem(Environment(), Similarity({}), value),  # type: ignore[arg-type]
        lambda: Problem(Environment(), Similarity({}), 1, value),  # type: ignore[arg-type]
    ):
        with pytest.raises(InvalidValueError, match="whole number"):
            make()


def test_a_whole_number_of_another_library_becomes_an_int() -> None:
    assert type(Transformation("a", labor_us=numpy.int64(3)).labor_us) is int


def test_a_plan_without_a_change_set_can_not_be_carried_out() -> None:
    with pytest.raises(InvalidValueError, match="no plan was found, so there is no change set"):
        Environment().update(None)


def test_a_target_in_code_has_a_topic_or_a_transformation_that_runs() -> None:
    with pytest.raises(InvalidValueError, match="target 't' has neither a topic nor `run`"):
        Target("t", "X")
    with pytest.raises(InvalidValueError, match="target 't' has `run`, so it can have no topic"):
        Target("t", topic="/t", run="display")
    assert Target("t", run="display").run == "display"
