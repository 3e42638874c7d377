"""Targets that may not be silent: what gives nothing is replaced. No process."""

from __future__ import annotations

from cfgplan_runtime.lifecycle.perturbations import TargetSilent
from cfgplan_runtime.supervision.simulated_backend import Behaviour
from simulated_life import Life, source, started, worker

from cfgplan.domain import Target

IMPATIENT = (Target("result", "Y", "/result", silent_us=5_000_000),)
SPARE = source("spare", labor_us=2000)


def fall_silent(life: Life, label: str) -> None:
    """Let what runs of a transformation give nothing from now on; others of it would."""
    unit = next(unit for unit in life.runtime.backend.units.values() if unit.transformation.label == label)
    unit.behaviour = Behaviour(quiet=True)


def test_a_source_that_gives_nothing_is_replaced_once_its_target_was_silent_for_too_long() -> None:
    life = started(source(), SPARE, worker(), targets=IMPATIENT)
    life.pass_time(20)
    assert life.perturbations(TargetSilent) == []
    fall_silent(life, "count")
    life.pass_time(4)
    assert life.met == {"result"}
    life.pass_time(6)
    (silent,) = life.perturbations(TargetSilent)
    assert (silent.units, 5 < silent.silent_s < 7) == (("count.1",), True)
    assert life.met == {"result"}
    (review,) = life.reviews[1:]
    assert review.change_set is not None
    assert review.change_set.stopped == ("count.1",)
    assert review.unmet["result"].startswith("nothing has come from work.1/y for ")


def test_what_only_waits_for_a_silent_source_is_not_to_blame() -> None:
    life = started(source(), worker(), targets=IMPATIENT)
    fall_silent(life, "count")
    life.pass_time(10)
    assert [unit for silent in life.perturbations(TargetSilent) for unit in silent.units] == ["count.1"]
    assert "work.1" in life.units


def test_a_filter_that_gives_nothing_of_what_it_gets_is_to_blame() -> None:
    life = started(source(), worker(), targets=IMPATIENT)
    life.pass_time(10)
    fall_silent(life, "work")
    life.pass_time(10)
    assert [unit for silent in life.perturbations(TargetSilent) for unit in silent.units] == ["work.1"]


def test_a_target_that_stays_silent_counts_as_unmet_and_is_reviewed_again_and_again() -> None:
    quiet = {"count": Behaviour(quiet=True)}
    life = started(source(), worker(), targets=IMPATIENT, behaviours=quiet, horizon_s=600)
    life.pass_time(60)
    assert all("result" in review.unmet for review in life.reviews[1:3])
    assert 3 <= len(life.perturbations(TargetSilent)) <= 15


def test_a_target_that_does_not_say_so_may_be_silent() -> None:
    life = started(source(), worker(), behaviours={"count": Behaviour(quiet=True)})
    life.pass_time(100)
    assert life.perturbations(TargetSilent) == []
    assert life.met == {"result"}
