"""Units that take a while to begin, as lifecycle nodes of ROS 2 do: an update waits until they work. No process."""

from __future__ import annotations

import pytest
from cfgplan_runtime import ApplyError, Patience
from cfgplan_runtime.errors import AbandonedError
from cfgplan_runtime.supervision.simulated_backend import Behaviour
from test_supervisor import ONE, TOPIC, Simulation
from world import source, start, unit, worker

from cfgplan.domain import ChangeSet, Stream


def replacement(label: str = "slow") -> ChangeSet:
    return ChangeSet((unit(f"{label}.1", topic="/result", x="count.1/n"),), stopped=("work.1",))


def simulation(**slow: object) -> Simulation:
    """A simulation of one worker, which is to be replaced by one of `slow`."""
    behaviour = Behaviour(**{"activate_s": 0.5, **slow})  # type: ignore[arg-type]
    made = Simulation(source(), worker(), worker("slow"), slow=behaviour)
    made.apply(start(*ONE))
    made.backend.calls.clear()
    return made


def test_an_old_unit_stays_until_the_new_one_works() -> None:
    swapped = simulation()
    swapped.apply(replacement())
    assert 0.5 < swapped.backend.now() < 1.0
    assert swapped.backend.feeding(TOPIC) == Stream("slow.1", "y")
    assert [call[:2] for call in swapped.asked("activate", "stop")] == [("activate", "slow.1"), ("stop", "work.1")]
    swapped.check()


def test_sources_begin_once_all_others_work() -> None:
    begun = Simulation(count=Behaviour(activate_s=0.25), work=Behaviour(activate_s=0.5))
    begun.apply(start(unit("count.1"), unit("work.1", topic="/result", x="count.1/n")))
    assert begun.asked("activate") == [("activate", "work.1"), ("activate", "count.1")]
    assert begun.backend.now() > 0.75
    begun.check()


def test_an_update_is_undone_if_a_new_unit_takes_too_long_to_begin() -> None:
    late = simulation(activate_s=100.0)
    before = late.supervisor.environment
    with pytest.raises(ApplyError, match=r"slow\.1 was not active within 3 s") as caught:
        late.apply(replacement(), patience=Patience(start_s=3.0))
    assert caught.value.units == ("slow.1",)
    assert late.supervisor.environment == before
    assert late.backend.feeding(TOPIC) == Stream("work.1", "y")
    late.check()


def test_an_update_is_undone_if_a_new_unit_dies_while_it_begins() -> None:
    dying = simulation(activate_s=100.0, dies_s=1.0)
    with pytest.raises(ApplyError, match=r"slow\.1 died: died of old age"):
        dying.apply(replacement())
    assert dying.backend.now() < 2.0
    assert dying.backend.feeding(TOPIC) == Stream("work.1", "y")
    dying.check()


def test_an_update_that_waits_for_a_unit_to_begin_may_be_abandoned() -> None:
    given_up = simulation(activate_s=100.0)
    until_s = given_up.backend.now() + 1.0
    with pytest.raises(AbandonedError, match=r"slow\.1 was being activated"):
        given_up.apply(replacement(), is_abandoned=lambda: given_up.backend.now() > until_s)
    assert given_up.backend.now() < until_s + 2.0
    given_up.check()


def test_a_unit_that_was_paused_while_it_began_begins_in_the_next_update() -> None:
    kept = Simulation(
        source(), worker(), worker("slow"), worker("bad"), slow=Behaviour(activate_s=2.0), bad=Behaviour(dies_s=1.0)
    )
    kept.apply(start(*ONE))
    bad = unit("bad.1", x="count.1/n")
    with pytest.raises(ApplyError, match=r"bad\.1"):
        kept.apply(ChangeSet((*replacement().started, bad), stopped=("work.1",)), keeps_new=True)
    assert ("deactivate", "slow.1") in kept.backend.calls
    kept.pass_time(5.0)
    assert not kept.backend.units["slow.1"].is_active
    kept.apply(ChangeSet(rewired=replacement().started, stopped=("work.1",)))
    assert kept.backend.feeding(TOPIC) == Stream("slow.1", "y")
    kept.check()
