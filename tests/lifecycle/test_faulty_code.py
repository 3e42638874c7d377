"""Code that can't be started is left out of plans until it changes; what runs of it goes on."""

from __future__ import annotations

from cfgplan_runtime.lifecycle.changes import FaultyCode
from cfgplan_runtime.lifecycle.kinds import kind_of
from cfgplan_runtime.lifecycle.perturbations import CodeChanged
from cfgplan_runtime.lifecycle.reports import Decision
from simulated_life import Life, source, started, worker

from cfgplan import api
from cfgplan.domain import Environment, Target

NO_FILE = "units.py: there is no such file of unit code"


def life() -> Life:
    library = source(), worker(), worker("dear", upkeep_us=900_000)
    target = Target("result", worker().outputs[0].tag, "/result")
    return started(world=api.world(Environment(library=library, targets=(target,)), horizon_s=60))


def test_what_runs_of_faulty_code_goes_on_and_is_replaced_by_another_once_it_dies() -> None:
    run = life()
    review = run.reviewed(FaultyCode({"work": NO_FILE}))
    assert (run.units, dict(review.avoided)) == ({"count.1", "work.1"}, {})
    run.fail("work.1")
    assert run.units == {"count.1", "dear.1"}
    assert dict(run.reviews[-1].avoided) == {"work": NO_FILE}


def test_mended_code_is_used_at_once() -> None:
    run = life()
    run.reviewed(FaultyCode({"work": NO_FILE}))
    run.fail("work.1")
    back = run.reviewed(FaultyCode({}, ("work",)))
    assert (run.units, back.decision) == ({"count.1", "work.1"}, Decision.APPLIED)
    assert run.perturbations(CodeChanged) == [CodeChanged(("work",), (), (NO_FILE,)), CodeChanged((), ("work",))]


def test_a_report_of_faulty_code_says_its_fault_once_for_all_its_transformations() -> None:
    run = life()
    run.reviewed(FaultyCode({"work": NO_FILE, "dear": NO_FILE}))
    (changed,) = run.perturbations(CodeChanged)
    assert kind_of(changed).says(changed) == f"code: dear, work can't be started ({NO_FILE})"


def test_another_fault_of_the_same_code_makes_no_review() -> None:
    run = life()
    run.reviewed(FaultyCode({"work": NO_FILE}))
    reviews = len(run.reviews)
    assert run.ask(FaultyCode({"work": "units.py has no Worker"})) is None
    assert len(run.reviews) == reviews


def test_changed_code_of_what_keeps_failing_is_tried_again() -> None:
    run = life()
    for number in (1, 2, 3):
        unit = next((one for one in run.units if one.startswith("work")), None)
        if unit is None:
            break
        run.fail(unit)
        assert number < 3, "it backs off"
    assert "dear.1" in run.units
    run.reviewed(FaultyCode({}, ("work",)))
    assert any(one.startswith("work") for one in run.units)
    assert run.perturbations(CodeChanged) == [CodeChanged((), ("work",))]
