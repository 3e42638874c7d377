"""What reviews ask and say where it is not decided of a pair of tags whether it matches."""

from __future__ import annotations

import errno
import os
import time
from collections.abc import Sequence
from dataclasses import replace
from typing import NoReturn

import pytest
from cfgplan_runtime import Policy
from cfgplan_runtime.lifecycle.changes import Add, ReplaceWorld, ReviewNow
from cfgplan_runtime.lifecycle.reports import Decision
from cfgplan_runtime.lifecycle.warm_matching import WarmMatching
from cfgplan_runtime.operating.records import review_record
from simulated_life import Life, source

from cfgplan import api
from cfgplan.domain import Environment, Target, Transformation
from cfgplan.matching import Ontology, hermit

AXIOMS = [
    "SubClassOf(<w#A> <w#W>)",
    "SubClassOf(<w#B> <w#W>)",
    "SubClassOf(<w#C> ObjectUnionOf(<w#A> <w#B>))",
]
DEAR, CHEAP = source("dear", tag="W", labor_us=9000, upkeep_us=1000), source("cheap", tag="C", labor_us=10)
TARGET = Target("t", "W", "/t")


def world(*library: Transformation, targets: tuple[Target, ...] = (TARGET,), also: Sequence[str] = ()) -> api.World:
    return api.world(Environment((), library, targets), horizon_s=60, ontology=Ontology([*AXIOMS, *also]))


def version(*library: Transformation, reasoner: str = "auto", targets: tuple[Target, ...] = (TARGET,)) -> Life:
    life = Life(world=world(*library, targets=targets), policy=Policy(reasoner=reasoner))
    life.settle()
    return life


def test_a_review_asks_about_what_its_plan_uses() -> None:
    (review,) = version(DEAR, CHEAP).reviews
    assert (review.decision, review.cost_us, review.is_proven) == (Decision.APPLIED, 10, True)
    assert review.undecided == ()


def test_a_review_names_what_is_not_decided_and_calls_nothing_proven() -> None:
    life = version(DEAR, CHEAP, reasoner="el")
    (review,) = life.reviews
    assert (review.decision, review.cost_us, review.bound_us) == (Decision.APPLIED, 69_000, 10)
    assert (review.is_proven, review.undecided) == (False, (("C", "W"),))
    assert life.units == {"dear.1"}
    record = review_record(review)
    assert record["undecided"] == [["C", "W"]]
    assert "it is undecided whether C is W: if so, a better update may exist" in record["says"]


def test_what_only_saves_cost_is_asked_when_a_review_optimises() -> None:
    life = version(DEAR)
    review = life.reviewed(Add(transformations=(CHEAP,)))
    assert (review.decision, review.undecided) == (Decision.KEPT, (("C", "W"),))
    review = life.reviewed(ReviewNow("test"))
    assert (review.decision, review.cost_us, review.is_proven, review.undecided) == (Decision.APPLIED, 10, True, ())
    assert life.units == {"cheap.1"}


def test_what_a_target_can_be_met_by_alone_is_asked_at_once() -> None:
    life = version(CHEAP, targets=())
    review = life.reviewed(Add(targets=(TARGET,)))
    assert (review.decision, review.met, review.is_proven) == (Decision.APPLIED, ("t",), True)


def test_a_target_that_an_open_pair_may_meet_is_unmet_but_not_impossible() -> None:
    other = Target("u", "C", "/u")
    (review,) = version(CHEAP, reasoner="el", targets=(TARGET, other)).reviews
    assert (review.met, review.is_proven, review.undecided) == (("u",), False, (("C", "W"),))
    assert review.unmet == {"t": "target t wants W, but it is not decided yet whether C is W"}


def test_a_contradiction_that_is_found_late_is_told_and_what_runs_goes_on() -> None:
    life = version(DEAR)
    also = ["ClassAssertion(<w#C> <w#i>)", "ClassAssertion(ObjectComplementOf(<w#W>) <w#i>)"]
    review = life.reviewed(ReplaceWorld(world(DEAR, CHEAP, also=also), "env.yaml"))
    life.manager.request(ReviewNow("test"))
    life.manager.step()
    assert review.undecided == (("C", "W"),)
    assert life.reviews[-1].decision is Decision.UNDECIDED
    assert "the ontology contradicts itself" in life.reviews[-1].cause
    assert life.units == {"dear.1"}


def test_questions_without_an_answer_take_no_more_than_the_limit_for_each_world(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    limits = []

    def satisfiable(_: str, __: Sequence[str], *, time_limit_s: float | None, **_more: float) -> dict[str, bool]:
        assert time_limit_s is not None
        limits.append(time_limit_s)
        time.sleep(0.02)
        return {}

    monkeypatch.setattr(hermit, "satisfiable", satisfiable)
    matching = WarmMatching("auto", 0.05)
    for number in range(2):
        changed = replace(TARGET, label=f"t{number}")
        matching.take(world(DEAR, CHEAP, targets=(changed,), also=[f"Declaration(Class(<w#N{number}>))"]))
        asked = [matching.decide([("C", "W")]) for _ in range(10)]
        assert 1 <= sum(asked) <= 3
        assert matching.similarity.is_open("C", "W")
    assert 2 <= len(limits) <= 6


def test_on_a_full_disk_what_is_open_stays_open_with_a_warning(monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object, **__: object) -> NoReturn:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patched:
        patched.setattr(hermit, "satisfiable", full)
        matching = WarmMatching("auto", None)
        matching.take(world(DEAR, CHEAP))
        assert matching.decide([("C", "W")]) == 0
        assert matching.similarity.is_open("C", "W")
        assert matching.warnings == ("the reasoner can't be asked: No space left on device",)
