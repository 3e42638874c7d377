"""Units that are replaced by new ones of the same transformation, on request."""

from __future__ import annotations

from dataclasses import replace

import pytest
from cfgplan_runtime.lifecycle.changes import FaultyCode, Remove, RestartUnits
from cfgplan_runtime.lifecycle.configuration import restarting
from cfgplan_runtime.lifecycle.perturbations import RestartAsked
from cfgplan_runtime.lifecycle.reports import Decision
from cfgplan_runtime.supervision.simulated_backend import Behaviour
from simulated_life import source, started, worker

from cfgplan.errors import InputError


def test_a_new_unit_takes_the_old_one_s_place_and_wires() -> None:
    run = started()
    before = run.runtime.environment
    review = run.reviewed(RestartUnits(("count.1",), "units.py"))
    assert (review.decision, review.perturbations) == (Decision.APPLIED, (RestartAsked(("count.1",), "units.py"),))
    assert run.units == {"count.2", "work.1"}
    work = run.runtime.environment.unit["work.1"]
    assert [s.stream.unit for s in work.subscriptions] == ["count.2"]
    assert work.publications == before.unit["work.1"].publications
    assert run.met == {"result"}


def test_several_units_are_replaced_in_one_update() -> None:
    run = started()
    review = run.reviewed(RestartUnits(("work.1", "count.1")))
    assert review.change_set is not None
    assert (run.units, set(review.change_set.stopped)) == ({"count.2", "work.2"}, {"count.1", "work.1"})
    assert [s.stream.unit for s in run.runtime.environment.unit["work.2"].subscriptions] == ["count.2"]
    assert run.met == {"result"}


def test_the_old_unit_stays_if_the_new_one_fails_and_no_further_one_is_started() -> None:
    run = started()
    run.runtime.backend.behaviours["work"] = Behaviour(dies_at_start="ImportError: no module named x")
    review = run.reviewed(RestartUnits(("work.1",)))
    assert (review.decision, run.units) == (Decision.FAILED, {"count.1", "work.1"})
    starts = run.starts("work")
    run.pass_time(400.0)
    assert (run.units, run.starts("work"), run.met) == ({"count.1", "work.1"}, starts, {"result"})


def test_what_can_t_be_restarted_is_refused_with_the_cause() -> None:
    run = started()
    for unit, cause in (("nobody.1", "no unit 'nobody.1' runs"), ("work.1", "units.py has no Worker")):
        run.ask(FaultyCode({"work": "units.py has no Worker"}))
        with pytest.raises(InputError, match=cause):
            run.ask(RestartUnits((unit,)))
    run.ask(FaultyCode({}))
    node = replace(worker(), source="external:/work")
    with pytest.raises(InputError, match="its node was not started by this run"):
        started(source(), node).ask(RestartUnits(("work.1",)))


def test_a_restart_beside_a_change_of_the_world_comes_after_it() -> None:
    run = started()
    remove, restart = (
        run.manager.request(change) for change in (Remove(targets=("result",)), RestartUnits(("work.1",)))
    )
    run.settle()
    assert remove.result(0) is not None
    assert (restart.result(0), run.units) == (None, set())


def test_fresh_ids_are_free_ones_and_units_that_do_not_run_are_passed_over() -> None:
    running = started().runtime.environment
    changes = restarting(running, ["work.1", "nobody.1"])
    assert ([unit.id for unit in changes.started], changes.stopped) == (["work.2"], ("work.1",))
    assert not restarting(running, ["nobody.1"])
