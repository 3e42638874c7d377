"""States that several units would save at once are named before a run and in it."""

from __future__ import annotations

from dataclasses import replace

import pytest

from cfgplan.domain import (
    ComputationUnit,
    Environment,
    InputPort,
    OutputPort,
    RunOptions,
    Similarity,
    Target,
    Transformation,
)
from cfgplan.planning import Problem
from cfgplan.shared_states import double_owners, shared_states

SPIRAL = RunOptions(state="spiral")


def mode(label: str, gives: str, needs: str = "", **more: object) -> Transformation:
    inputs = tuple(InputPort(f"{tag}{place}", tag) for place, tag in enumerate(needs))
    made = Transformation(label, inputs, tuple(OutputPort(tag, tag) for tag in gives), run=SPIRAL)
    return replace(made, **more)  # type: ignore[arg-type]


def problem(targets: str, *library: Transformation) -> Problem:
    wanted = tuple(Target(tag, tag, f"/{tag}") for tag in targets)
    return Problem(Environment((), library, wanted), Similarity({tag: frozenset(tag) for tag in "ABCD"}), 60)


HIGH, LOW, LOWER = mode("high", "A"), mode("low", "B"), mode("lower", "B")
BOTH = Transformation("both", (InputPort("a", "A"), InputPort("b", "B")), (OutputPort("c", "C"),))


@pytest.mark.parametrize(
    ("targets", "library"),
    [
        ("AB", (HIGH, LOW)),
        ("AB", (HIGH, LOW, LOWER)),
        ("C", (HIGH, LOW, BOTH)),
        ("B", (HIGH, mode("low", "B", needs="A"))),
        ("A", (mode("high", "A", min_instances=2),)),
        ("A", (HIGH, mode("low", "B", min_instances=1))),
        ("B", (HIGH, mode("low", "B", beside=("high",)))),
        (
            "D",
            (
                mode("high", "A", max_instances=2),
                Transformation("d", (InputPort("a", "A", count=2),), (OutputPort("d", "D"),)),
            ),
        ),
    ],
)
def test_modes_that_every_plan_needs_at_once_are_named(targets: str, library: tuple[Transformation, ...]) -> None:
    (warning,) = shared_states(problem(targets, *library))
    assert "state spiral" in warning


@pytest.mark.parametrize(
    ("targets", "library"),
    [
        ("A", (HIGH, LOW)),
        ("B", (LOW, LOWER)),
        ("AB", (mode("every", "AB"), HIGH, LOW)),
        ("AD", (HIGH, LOW)),
        ("AB", (HIGH, replace(LOW, run=RunOptions(state="other")))),
        ("AB", (replace(HIGH, run=RunOptions(state=True)), replace(LOW, run=RunOptions(state=True)))),
        ("AB", (replace(HIGH, run=RunOptions()), LOW)),
        ("A", (replace(HIGH, max_instances=3),)),
    ],
)
def test_modes_that_may_run_one_at_a_time_are_not_named(targets: str, library: tuple[Transformation, ...]) -> None:
    assert [*shared_states(problem(targets, *library))] == []


def test_running_units_that_save_one_state_are_named_and_spares_are_not() -> None:
    units = ComputationUnit("high.1", "high"), ComputationUnit("low.1", "low")
    (warning,) = double_owners(Environment(units, (HIGH, LOW)))
    assert warning.startswith("units high.1, low.1 save state spiral at once")
    assert [*double_owners(Environment(units[:1], (HIGH, LOW)))] == []
    spare = replace(units[1], standby=True)
    assert [*double_owners(Environment((units[0], spare), (HIGH, LOW)))] == []
