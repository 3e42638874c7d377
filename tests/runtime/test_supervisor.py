"""The supervisor's decisions, with units that run only in thought on a clock that is set. No process."""

from __future__ import annotations

import random
from collections.abc import Collection
from contextlib import suppress
from dataclasses import replace
from types import SimpleNamespace
from typing import Any
from unittest import mock

import pytest
from cfgplan_runtime import ApplyError, Patience, SimulatedBackend, StaleChangeSetError, Supervisor
from cfgplan_runtime.children.unit_order import order_digest
from cfgplan_runtime.errors import NoSourceError
from cfgplan_runtime.streams.element import Moment
from cfgplan_runtime.supervision.backend import Failures, Found, FoundWire, Inlet, StoppingUnit
from cfgplan_runtime.supervision.commands import Doubt
from cfgplan_runtime.supervision.events import (
    Applied,
    Event,
    FailuresKept,
    HelperAlive,
    HelperHung,
    HostLost,
    InputLost,
    PlacesTold,
    RolledBack,
    StateNotExact,
    UnitCutShort,
    UnitDied,
    UnitFound,
    UnitHung,
    UnitReady,
    UnitStopped,
    UnitTooLarge,
)
from cfgplan_runtime.supervision.simulated_backend import Behaviour
from cfgplan_runtime.supervision.wiring import starved_units, wanted_feeds
from in_simulation import InSimulation
from world import RESULT, source, start, unit, worker

from cfgplan.domain import ChangeSet, ComputationUnit, Environment, Host, RunOptions, Stream, Target, Transformation
from cfgplan.errors import InvalidValueError
from cfgplan.transformations import DEFAULT_LABOR_US

TOPIC = Inlet("", "/result")
ONE = (unit("count.1"), unit("work.1", topic="/result", x="count.1/n"))


class Simulation(InSimulation):
    def __init__(self, *library: Transformation, **behaviours: Behaviour) -> None:
        super().__init__(Environment((), library or (source(), worker()), (RESULT,)), behaviours)

    def apply(self, change_set: ChangeSet, **more: Any) -> Applied:
        return self.supervisor.apply(change_set, **more)

    def check(self) -> None:
        """What the supervisor believes is what is."""
        environment = self.supervisor.environment
        assert (
            {unit.id for unit in environment.units if not unit.standby}
            == set(self.backend.units)
            == self.supervisor.alive
        )
        for inlet, stream in wanted_feeds(environment).items():
            assert self.backend.feeding(inlet) == stream, inlet


def swap(number: int) -> ChangeSet:
    return ChangeSet(started=(unit(f"work.{number}", topic="/result", x="count.1/n"),), stopped=(f"work.{number - 1}",))


def test_additions_come_before_removals() -> None:
    simulation = Simulation()
    simulation.apply(start(*ONE))
    simulation.backend.calls.clear()
    applied = simulation.apply(swap(2))
    assert simulation.backend.calls == [
        ("start", "work.2"),
        ("connect", "count.1/n", "work.2/x"),
        ("connect", "work.2/y", "/result"),
        ("activate", "work.2"),
        ("stop", "work.1"),
        ("end", "count.1/n", "work.1/x"),
    ]
    assert applied.unswitched == 0
    simulation.check()


def test_units_start_side_by_side() -> None:
    simulation = Simulation(source(), worker(), count=Behaviour(start_s=1.0), work=Behaviour(start_s=1.0))
    applied = simulation.apply(start(*ONE))
    assert applied.seconds["start"] == pytest.approx(1.0)


def test_a_change_set_is_carried_out_once_by_its_id() -> None:
    simulation = Simulation()
    first = simulation.apply(start(*ONE), id="a")
    assert simulation.apply(start(*ONE), id="a") == first
    assert len(simulation.asked("start")) == 2


@pytest.mark.parametrize(
    ("change_set", "part"),
    [
        (ChangeSet(started=(ONE[0],)), "runs already"),
        (ChangeSet(stopped=("nobody.1",)), "does not run"),
        (ChangeSet(started=(unit("nothing.1"),)), "no transformation 'nothing'"),
        (ChangeSet(started=(unit("work.2", x="nobody.1/n"),)), "which nothing gives"),
        (ChangeSet(started=(unit("work.2", x="count.1/nope"),)), "which nothing gives"),
        (ChangeSet(started=(unit("work.2", nope="count.1/n"),)), "no input 'nope'"),
        (ChangeSet(stopped=("count.1",)), "which nothing gives"),
    ],
)
def test_a_change_set_that_does_not_fit_is_refused_and_nothing_is_done(change_set: ChangeSet, part: str) -> None:
    simulation = Simulation()
    simulation.apply(start(*ONE))
    before = list(simulation.backend.calls)
    with pytest.raises(StaleChangeSetError, match=part):
        simulation.apply(change_set)
    assert simulation.backend.calls == before


def test_a_change_set_for_other_units_is_stale() -> None:
    simulation = Simulation()
    basis = simulation.supervisor.environment
    simulation.apply(start(*ONE))
    with pytest.raises(StaleChangeSetError, match="planned for other"):
        simulation.apply(swap(2), basis=basis)


def test_a_transformation_without_source_is_refused() -> None:
    simulation = Simulation(Transformation("count"))
    with pytest.raises(NoSourceError, match="'count' can't be started") as caught:
        simulation.apply(start(ComputationUnit("count.1", "count")))
    assert caught.value.cause.startswith("it has no unit code: add `source:")


def test_an_update_is_undone_when_a_unit_dies_at_its_start() -> None:
    simulation = Simulation(source(), worker(), worker("bad"), bad=Behaviour(dies_at_start="no camera"))
    simulation.apply(start(*ONE))
    before = simulation.supervisor.environment
    with pytest.raises(ApplyError, match=r"bad\.1 died: no camera"):
        simulation.apply(
            ChangeSet(
                started=(unit("bad.1", topic="/result", x="work.2/y"), unit("work.2", x="count.1/n")),
                stopped=("work.1",),
            )
        )
    assert simulation.supervisor.environment == before
    assert isinstance(simulation.events[-1], RolledBack)
    simulation.check()


def test_an_update_that_is_undone_leaves_no_outlet_and_no_unit_of_its_own() -> None:
    simulation = Simulation(source(), worker(), worker("bad"), bad=Behaviour(dies_at_start="no camera"))
    simulation.apply(start(*ONE))
    started = (unit("work.2", topic="/other", x="count.1/n"), unit("bad.1", x="count.1/n"))
    with pytest.raises(ApplyError):
        simulation.apply(ChangeSet(started=started, added_targets=(Target("other", "Y", "/other"),)))
    assert set(simulation.backend.topics) == set(simulation.supervisor.topics) == {"/result"}
    assert set(simulation.backend.units) == {"count.1", "work.1"}


def test_new_units_that_have_not_failed_stay_unconnected_where_that_is_wanted() -> None:
    bad = Behaviour(quiet=True, dies_s=1.0)
    simulation = Simulation(source(), worker(), worker("bad"), worker("slow"), bad=bad, slow=Behaviour(start_s=0.8))
    other = Target("other", "Y", "/other")
    simulation.apply(ChangeSet(started=(*ONE, unit("work.9", topic="/other", x="count.1/n")), added_targets=(other,)))
    before = simulation.supervisor.environment
    started = unit("slow.1", topic="/result", x="count.1/n"), unit("bad.1", topic="/other", x="count.1/n")
    with pytest.raises(ApplyError, match=r"bad\.1"):
        simulation.apply(ChangeSet(started, stopped=("work.1", "work.9")), keeps_new=True)
    after = simulation.supervisor.environment
    assert set(after.units) == {*before.units, unit("slow.1")}
    assert simulation.backend.feeding(TOPIC) == Stream("work.1", "y")
    assert simulation.backend.feeding(Inlet("slow.1", "x")) is None
    simulation.check()
    simulation.apply(ChangeSet(rewired=(started[0],), stopped=("work.1",)), basis=after)
    assert simulation.backend.feeding(TOPIC) == Stream("slow.1", "y")
    simulation.check()


def test_what_still_loads_when_another_could_not_start_is_waited_for_only_where_it_is_connected() -> None:
    behaviours = {"bad": Behaviour(dies_at_start="no camera"), "slow": Behaviour(start_s=5.0)}
    simulation = Simulation(source(), worker(), worker("bad"), worker("slow"), **behaviours)
    slow = unit("slow.1", x="count.1/n")
    with pytest.raises(ApplyError, match=r"bad\.1"):
        simulation.apply(start(unit("count.1"), slow, unit("bad.1", x="count.1/n")), keeps_new=True)
    assert set(simulation.supervisor.environment.unit) == {"count.1", "slow.1"}
    simulation.apply(start(ONE[1]))
    assert simulation.backend.now() < 1.0
    simulation.apply(ChangeSet(rewired=(slow,)))
    assert simulation.backend.now() == pytest.approx(5.0)
    simulation.check()


def test_what_loads_for_too_long_is_given_up_though_it_stayed_before() -> None:
    behaviours = {"bad": Behaviour(dies_at_start="no camera"), "slow": Behaviour(start_s=1000.0)}
    simulation = Simulation(source(), worker(), worker("bad"), worker("slow"), **behaviours)
    simulation.apply(start(*ONE))
    before = simulation.supervisor.environment
    slow = unit("slow.1", x="count.1/n")
    with pytest.raises(ApplyError, match=r"bad\.1"):
        simulation.apply(start(slow, unit("bad.1", x="count.1/n")), keeps_new=True)
    with pytest.raises(ApplyError, match=r"slow\.1 was not ready") as caught:
        simulation.apply(ChangeSet(rewired=(slow,)), keeps_new=True)
    assert caught.value.units == ("slow.1",)
    assert simulation.supervisor.environment == before
    simulation.check()


@pytest.mark.parametrize(
    ("run", "starves_with_a_gap_at"),
    [
        (RunOptions(), {"a", "b", "ab"}),
        (RunOptions("any"), {"ab"}),
        (RunOptions("a"), {"a", "ab"}),
    ],
)
def test_a_unit_starves_where_an_input_that_starts_it_is_missing(
    run: RunOptions, starves_with_a_gap_at: set[str]
) -> None:
    for gap in ("", "a", "b", "ab"):
        fed = {port: "count.1/n" for port in "ab" if port not in gap}
        units = (unit("count.1"), unit("work.1", **fed), unit("next.1", a="work.1/y", b="count.1/n"))
        library = (source(), worker(inputs=("a", "b"), run=run), worker("next", inputs=("a", "b")))
        starved = {"work.1", "next.1"} if gap in starves_with_a_gap_at else set()
        assert starved_units(Environment(units, library, ())) == starved


def test_wires_that_have_switched_are_switched_back_when_a_later_step_fails() -> None:
    simulation = Simulation(source(), worker(), worker("bad"), bad=Behaviour(quiet=True, dies_s=1.0))
    other = Target("other", "Y", "/other")
    simulation.apply(ChangeSet(started=(*ONE, unit("work.9", topic="/other", x="count.1/n")), added_targets=(other,)))
    with pytest.raises(ApplyError):
        simulation.apply(
            ChangeSet(
                started=(
                    unit("work.2", topic="/result", x="count.1/n"),
                    unit("bad.1", topic="/other", x="count.1/n"),
                ),
                stopped=("work.1", "work.9"),
            )
        )
    assert simulation.backend.feeding(TOPIC) == Stream("work.1", "y")
    assert ("connect", "work.1/y", "/result") in simulation.backend.calls[6:]
    simulation.check()


def test_a_quiet_source_takes_over_when_the_old_one_is_taken_away() -> None:
    simulation = Simulation(source(), worker(), worker("quiet"), quiet=Behaviour(quiet=True))
    simulation.apply(start(*ONE))
    change_set = ChangeSet(started=(unit("quiet.1", topic="/result", x="count.1/n"),), stopped=("work.1",))
    applied = simulation.apply(change_set, patience=Patience(switch_s=3.0))
    assert applied.unswitched == 1
    assert applied.seconds["rewire"] == pytest.approx(3.0)
    simulation.check()


def test_an_input_goes_over_to_a_quiet_source_although_the_old_one_stays() -> None:
    simulation = Simulation(source(), source("quiet"), worker(), quiet=Behaviour(quiet=True))
    simulation.apply(start(*ONE, unit("quiet.1")))
    simulation.apply(ChangeSet(rewired=(unit("work.1", topic="/result", x="quiet.1/n"),)))
    assert simulation.asked("switch") == [("switch", "work.1/x")]
    simulation.check()


def test_a_dead_unit_leaves_gaps() -> None:
    simulation = Simulation()
    simulation.apply(start(*ONE))
    simulation.backend.fail("count.1")
    simulation.pass_time(0.1)
    assert [type(event) for event in simulation.events if isinstance(event, UnitDied | InputLost)] == [UnitDied]
    (left,) = simulation.supervisor.environment.units
    assert (left.id, left.subscriptions) == ("work.1", ())
    simulation.apply(ChangeSet(started=(unit("count.2"),), rewired=(unit("work.1", topic="/result", x="count.2/n"),)))
    assert simulation.backend.feeding(Inlet("work.1", "x")) == Stream("count.2", "n")
    simulation.check()


def test_wires_of_a_dead_unit_are_cut_though_an_heir_holds_them_open() -> None:
    simulation = Simulation(count=Behaviour(leaves_process=True), work=Behaviour())
    simulation.apply(start(*ONE))
    simulation.backend.fail("count.1")
    simulation.pass_time(0.1)
    rewired = unit("work.1", topic="/result", x="count.2/n")
    applied = simulation.apply(ChangeSet(started=(unit("count.2"),), rewired=(rewired,)))
    assert applied.unswitched == 0
    simulation.check()


def test_wires_of_a_stopped_unit_are_cut_though_an_heir_holds_them_open() -> None:
    simulation = Simulation(count=Behaviour(leaves_process=True), work=Behaviour(leaves_process=True))
    simulation.apply(start(*ONE))
    simulation.apply(swap(2))
    assert simulation.asked("end") == [("end", "count.1/n", "work.1/x")]
    simulation.check()


def test_a_helper_that_gives_no_sign_of_life_is_replaced_once() -> None:
    simulation = Simulation()
    simulation.backend.tell(HelperAlive("outlets", 5.0))
    simulation.pass_time(4.0)
    simulation.backend.stall(60.0)
    simulation.pass_time(0.5)
    assert simulation.asked("renew") == []
    simulation.pass_time(20.0)
    assert simulation.asked("renew") == [("renew", "outlets")]
    assert [event.helper for event in simulation.events if isinstance(event, HelperHung)] == ["outlets"]


def test_a_unit_that_dies_during_an_update_is_missing_afterwards() -> None:
    simulation = Simulation(source(), worker(), slow=Behaviour(), work=Behaviour(start_s=0.5))
    simulation.apply(start(unit("count.1")))
    simulation.backend.fail("count.1")
    simulation.apply(start(unit("work.1", topic="/result", x="count.1/n")))
    (left,) = simulation.supervisor.environment.units
    assert (left.id, left.subscriptions) == ("work.1", ())


def test_a_silent_unit_is_dumped_then_killed() -> None:
    simulation = Simulation(source(), worker(run=RunOptions(hang_us=5_000_000)), work=Behaviour(hung=True))
    simulation.apply(start(*ONE))
    simulation.pass_time(4.5)
    assert not any(isinstance(event, UnitHung) for event in simulation.events)
    simulation.pass_time(2.0)
    assert [event.unit for event in simulation.events if isinstance(event, UnitHung | UnitDied)] == ["work.1"] * 2
    assert simulation.asked("dump", "kill") == [("dump", "work.1"), ("kill", "work.1")]


def test_a_unit_that_an_earlier_supervisor_has_started_is_awaited_as_long_as_one_of_its_own() -> None:
    library = source(), worker()
    backend = SimulatedBackend({"count": Behaviour(start_s=20.0), "work": Behaviour(start_s=1e6)})
    units = unit("count.1"), unit("work.1", x="count.1/n")
    for one, transformation in zip(units, library, strict=True):
        backend.start(one.id, transformation, None, None)
    found = Found(units, library, (), {}, (), {})
    with mock.patch.object(SimulatedBackend, "found", return_value=found):
        events: list[Event] = []
        supervisor = Supervisor(backend, Environment((), library, (RESULT,)), events.append)
    while not any(isinstance(event, UnitDied) for event in events):
        supervisor.pump(1.0)
    assert [event for event in events if isinstance(event, UnitReady | UnitDied)] == [
        UnitReady("count.1", DEFAULT_LABOR_US),
        UnitDied("work.1", "killed by SIGKILL"),
    ]
    assert [event.unit for event in events if isinstance(event, UnitHung)] == ["work.1"]
    assert set(supervisor.environment.unit) == supervisor.alive == {"count.1"}
    assert 30.0 < backend.now() < 60.0


def test_units_that_an_earlier_supervisor_has_not_let_begin_begin_once_they_are_connected() -> None:
    """One that a target wants to run begins too, since no update may come that connects it. They leave followers of
    topics time to connect.
    """
    library = source(), worker(), source("give"), source("run")
    names = "count.1", "work.1", "give.1", "run.1"
    wire = FoundWire(1, Stream("count.1", "n"), Inlet("work.1", "x"), has_switched=True)
    units = tuple(unit(name, **({"x": "count.1/n"} if name == "work.1" else {})) for name in names)
    ready = dict.fromkeys(names, DEFAULT_LABOR_US)
    found = Found(units, library, (), ready, (wire,), {}, inactive={"work.1", "give.1", "run.1"})
    backend = SimulatedBackend()
    for one, transformation in zip(names, library, strict=True):
        backend.start(one, transformation, None, None)
    targets = RESULT, Target("runs", run="run")
    with mock.patch.object(SimulatedBackend, "found", return_value=found):
        supervisor = Supervisor(backend, Environment((), library, targets), lambda _: None)
    pass_time(supervisor, backend, 1.0)
    assert "activate" not in {call[0] for call in backend.calls}
    pass_time(supervisor, backend, 2.0)
    begun = [call for call in backend.calls if call[0] == "activate"]
    assert begun == [("activate", "run.1"), ("activate", "work.1")]
    supervisor.apply(start(unit("work.2", x="give.1/n")))
    begun = [call for call in backend.calls if call[0] == "activate"]
    assert begun[2:] == [("activate", "work.2"), ("activate", "give.1")]


def pass_time(supervisor: Supervisor, backend: SimulatedBackend, for_s: float) -> None:
    end_s = backend.now() + for_s
    while backend.now() < end_s:
        supervisor.pump(end_s - backend.now())


def test_an_update_waits_for_followers_of_its_new_topics_and_not_for_one_that_fails(
    caplog: pytest.LogCaptureFixture,
) -> None:
    simulation, asked = Simulation(), list[Collection[str]]()
    since_s = simulation.backend.now()

    def fails(_: Collection[str]) -> bool:
        raise OSError("no disk")

    def follows(topics: Collection[str]) -> bool:
        asked.append(topics)
        assert not [call for call in simulation.backend.calls if call[0] == "connect"]
        return simulation.backend.now() - since_s > 1.0

    simulation.supervisor.followers = fails, follows
    simulation.apply(start(*ONE))
    assert 1.0 < simulation.backend.now() - since_s < 2.0
    assert set(map(frozenset, asked)) == {frozenset({"/result"})}
    assert "no disk" in caplog.text
    asked.clear()
    simulation.apply(swap(2))
    assert not asked
    simulation.check()


@pytest.mark.parametrize(
    ("told_s", "stop_s", "limit_s", "interrupted_s", "ends_s"),
    [(0.0, None, 2.0, 1.0, 2.0), (5.0, 20.0, 20.0, 5.0, 15.0), (0.0, 120.0, 120.0, 60.0, 120.0)],
)
def test_a_unit_that_an_earlier_supervisor_has_told_to_stop_is_awaited_and_then_killed(
    told_s: float, stop_s: float | None, limit_s: float, interrupted_s: float, ends_s: float
) -> None:
    library = source(), worker()
    backend = SimulatedBackend({"work": Behaviour(hung=True)})
    for one, transformation in zip(ONE, library, strict=True):
        backend.start(one.id, transformation, None, None)
    backend.stop("work.1")
    backend.calls.clear()
    found = Found((ONE[0],), library, (), {}, (), {}, {"work.1": StoppingUnit("work", "r2", told_s, stop_s)})
    with mock.patch.object(SimulatedBackend, "found", return_value=found):
        events: list[Event] = []
        supervisor = Supervisor(backend, Environment((), library, (RESULT,)), events.append)
    supervisor.apply(start(unit("work.2", x="count.1/n")))
    assert backend.now() < 1.0, "others need not wait for it"
    while ("stop", "work.1") not in backend.calls:
        supervisor.pump(0.1)
    assert interrupted_s <= backend.now() < interrupted_s + 1.0, "code that blocks has half of its time"
    supervisor.apply(start(ONE[1]))
    assert backend.calls.count(("stop", "work.1")) == 1
    assert ends_s <= backend.now() < ends_s + 2.0
    assert [event for event in events if isinstance(event, UnitCutShort)] == [UnitCutShort("work.1", limit_s, 0)]
    assert [event for event in events if isinstance(event, UnitStopped)] == [UnitStopped("work.1")]
    assert "work.1" in supervisor.environment.unit


def test_a_unit_that_could_not_be_told_to_begin_is_told_by_the_next_update() -> None:
    simulation = Simulation()
    with (
        mock.patch.object(SimulatedBackend, "activate", side_effect=OSError("no buffer")),
        pytest.raises(ApplyError, match="no buffer"),
    ):
        simulation.apply(start(*ONE), keeps_new=True)
    simulation.apply(ChangeSet(rewired=ONE[1:]))
    assert all(one.is_active for one in simulation.backend.units.values())
    assert set(simulation.backend.units) == {"count.1", "work.1"}


def test_a_simulated_unit_gives_nothing_before_it_is_told_to_begin() -> None:
    backend = SimulatedBackend()
    backend.start("count.1", source(), None, None)
    backend.wait(1.0)
    given = list[bool]()
    for tell in (lambda _: None, backend.activate, backend.deactivate, backend.activate):
        tell("count.1")
        given.append(backend._gives("count.1"))
    assert given == [False, True, False, True]


def test_a_state_that_an_earlier_supervisor_has_known_goes_to_the_next_unit() -> None:
    library = source(), worker(run=RunOptions(state="altitude"))
    backend = SimulatedBackend()
    with mock.patch.object(
        SimulatedBackend, "found", return_value=Found((), library, (), {}, (), {}, states={"altitude": b"7"})
    ):
        supervisor = Supervisor(backend, Environment((), library, (RESULT,)), lambda _: None)
    supervisor.apply(start(*ONE))
    assert backend.units["work.1"].state == b"7"


@pytest.mark.parametrize(("place", "is_told"), [((3, 0), False), ((4, 0), True)])
def test_a_state_that_may_not_be_exact_is_told_once_a_place_shows_that_an_element_is_missing(
    place: Moment, is_told: bool
) -> None:
    """The place may come long after the update, when the source's code no longer blocks."""
    doubt = Doubt(StateNotExact("work.2", "work.1", "an input got nothing"), {"x": (3, 0)})
    house = InSimulation(Environment(library=(source(), worker())), {})
    house.supervisor.apply(start(unit("count.1"), unit("work.2", x="count.1/n")))
    house.supervisor._obey(doubt)
    house.pass_time(1.0)
    assert doubt.event not in house.events
    house.backend.tell(PlacesTold("work.2", {"x": place}))
    house.pass_time(1.0)
    assert (doubt.event in house.events) == is_told


def test_a_stalled_supervisor_takes_nobody_for_hung_but_what_hangs() -> None:
    simulation = Simulation(source(), worker(), worker("stuck"), stuck=Behaviour(hung=True))
    simulation.apply(start(*ONE, unit("stuck.1", x="count.1/n")))
    simulation.pass_time(3.0)
    for _ in range(3):
        simulation.backend.stall(12.0)
        simulation.pass_time(1.0)
    assert not any(isinstance(event, UnitHung) for event in simulation.events)
    simulation.pass_time(6.0)
    assert [event.unit for event in simulation.events if isinstance(event, UnitHung)] == ["stuck.1"]
    simulation.check()


def test_a_stall_does_not_use_up_the_patience_with_a_start() -> None:
    backend = SimulatedBackend({"work": Behaviour(start_s=20.0)})

    def stall_once(event: Event) -> None:
        if event == UnitReady("count.1", DEFAULT_LABOR_US):
            backend.stall(60.0)

    supervisor = Supervisor(backend, Environment((), (source(), worker()), (RESULT,)), stall_once)
    supervisor.apply(start(*ONE))
    assert set(supervisor.environment.unit) == {"count.1", "work.1"}


@pytest.mark.parametrize(
    "run", [RunOptions(hang_us=0, rate_hz=1), RunOptions()], ids=["allowed to be silent", "a source without a rate"]
)
def test_some_units_may_be_silent(run: RunOptions) -> None:
    library = (Transformation("count", outputs=source().outputs, source="x:y", run=run),)
    simulation = Simulation(*library, count=Behaviour(hung=True))
    simulation.apply(start(unit("count.1")))
    simulation.pass_time(100)
    assert not any(isinstance(event, UnitHung) for event in simulation.events)


def test_a_unit_that_grows_too_large_is_killed() -> None:
    library = (source(), worker(run=RunOptions(memory_mb=100)))
    simulation = Simulation(*library, work=Behaviour(memory_bytes=101 << 20))
    simulation.apply(start(*ONE))
    simulation.pass_time(1.0)
    assert [event.unit for event in simulation.events if isinstance(event, UnitTooLarge)] == ["work.1"]
    assert set(simulation.supervisor.environment.unit) == {"count.1"}


def test_a_unit_that_does_not_stop_when_asked_is_killed() -> None:
    simulation = Simulation(source(), worker(run=RunOptions(hang_us=0)), work=Behaviour(hung=True))
    simulation.apply(start(*ONE))
    simulation.apply(ChangeSet(stopped=("work.1",)))
    assert simulation.asked("kill") == [("kill", "work.1")]
    simulation.check()


def test_labor_and_upkeep_are_observed() -> None:
    library = (Transformation("count", outputs=source().outputs, source="x:y", labor_us=4000, upkeep_us=20_000),)
    simulation = Simulation(*library)
    simulation.apply(start(unit("count.1")))
    (first,) = simulation.supervisor.observe()
    simulation.pass_time(10)
    (second,) = simulation.supervisor.observe()
    assert (first.labor_us, first.upkeep_us) == (4000, None)
    assert (second.labor_us, second.upkeep_us) == (4000, 20_000)


def test_a_targets_topic_is_there_while_it_is_wanted() -> None:
    simulation = Simulation()
    simulation.apply(ChangeSet(started=(ONE[0],)))
    assert simulation.backend.topics.keys() == {"/result"}
    simulation.apply(ChangeSet(removed_targets=("result",)))
    assert not simulation.backend.topics


def test_any_history_of_swaps_and_deaths_leaves_what_is_believed() -> None:
    rng = random.Random(7)
    simulation = Simulation(source(), worker(), worker("bad"), bad=Behaviour(dies_s=0.004))
    simulation.apply(start(*ONE))
    number = 1
    for _ in range(200):
        number += 1
        environment = simulation.supervisor.environment
        if "count.1" not in environment.unit:
            simulation.apply(ChangeSet(stopped=tuple(environment.unit)))
            simulation.apply(start(*ONE))
            number = 1
            continue
        workers = tuple(u for u in environment.unit if u != "count.1")
        label = rng.choice(["work", "work", "bad"])
        change = ChangeSet(started=(unit(f"{label}.{number}", topic="/result", x="count.1/n"),), stopped=workers)
        if rng.random() < 0.4:
            simulation.backend.fail(rng.choice([*workers, "count.1"]))
        with suppress(ApplyError, StaleChangeSetError):
            simulation.apply(change, keeps_new=rng.random() < 0.5)
        simulation.pass_time(0.05)
        simulation.check()


def test_an_old_source_that_has_nothing_more_to_give_is_not_waited_for() -> None:
    simulation = Simulation(source(), worker(), worker("other"), other=Behaviour(quiet=True))
    simulation.apply(start(*ONE))
    simulation.backend.fail("count.1")
    simulation.pass_time(0.1)
    before = simulation.backend.now()
    started = (unit("count.2"), unit("other.1", topic="/result", x="count.2/n"))
    simulation.apply(ChangeSet(started=started, stopped=("work.1",)))
    assert simulation.backend.now() - before < 0.1
    simulation.check()


def test_an_old_unit_whose_steps_fail_is_not_waited_for() -> None:
    simulation = Simulation(source(), worker(), worker("bad"), bad=Behaviour(failing=True))
    simulation.apply(start(unit("count.1"), unit("bad.1", topic="/result", x="count.1/n")))
    simulation.pass_time(5.0)
    applied = simulation.apply(ChangeSet(started=(unit("work.1", topic="/result", x="count.1/n"),), stopped=("bad.1",)))
    assert applied.seconds["rewire"] < 0.1
    simulation.check()


def test_a_unit_that_dies_before_it_is_rewired_leaves_no_wire_to_its_successor_of_the_same_id() -> None:
    simulation = Simulation(source(), source("other"), worker(), other=Behaviour(start_s=1.0))
    simulation.apply(start(*ONE))
    simulation.backend.fail("work.1")
    rewired = unit("work.1", topic="/result", x="other.1/n")
    simulation.apply(ChangeSet(started=(unit("other.1"),), rewired=(rewired,), stopped=("count.1",)))
    assert set(simulation.supervisor.environment.unit) == {"other.1"}
    simulation.apply(start(rewired))
    assert simulation.backend.feeding(Inlet("work.1", "x")) == Stream("other.1", "n")
    simulation.check()


def at(host: str, one: ComputationUnit, *, standby: bool = False) -> ComputationUnit:
    return replace(one, host=host, standby=standby)


HOSTS = (Host("r1"), Host("r2"), Host("r3"))
AT_R3 = replace(RESULT, host="r3")
PLACED = (at("r1", ONE[0]), at("r2", ONE[1]))


def fleet() -> Simulation:
    """A source on r1 that feeds a worker on r2, whose result is wanted on r3, where a spare of it is ready."""
    simulation = Simulation()
    spare = at("r3", unit("work.9"), standby=True)
    simulation.apply(ChangeSet((*PLACED, spare), added_targets=(AT_R3,), added_hosts=HOSTS))
    return simulation


def test_a_cold_spare_is_known_and_nothing_runs_for_it() -> None:
    simulation = fleet()
    assert {one[1] for one in simulation.asked("start")} == {"count.1", "work.1"}
    simulation.check()
    awake = at("r3", unit("work.2", topic="/result", x="count.1/n"))
    simulation.apply(ChangeSet((awake,), stopped=("work.1", "work.9")))
    assert simulation.asked("stop") == [("stop", "work.1")]
    assert simulation.supervisor.environment.unit.keys() == {"count.1", "work.2"}
    simulation.check()


def test_the_units_of_a_lost_host_are_dead_at_once_and_their_wires_are_ended() -> None:
    simulation = fleet()
    simulation.backend.calls.clear()
    simulation.backend.lose_host("r2")
    simulation.pass_time(0.01)
    assert sorted(simulation.backend.calls) == [("end", "count.1/n", "work.1/x"), ("end", "work.1/y", "/result")]
    assert simulation.supervisor.environment.unit.keys() == {"count.1", "work.9"}
    assert [event for event in simulation.events if isinstance(event, HostLost | UnitDied | InputLost)] == [
        HostLost("r2", "its link is cut")
    ]
    simulation.check()
    simulation.backend.lose_host("r3")
    simulation.pass_time(0.01)
    assert simulation.supervisor.environment.unit.keys() == {"count.1"}


def test_a_topic_on_a_lost_host_has_no_source_and_gets_its_address_again_when_the_host_is_back() -> None:
    simulation = fleet()
    simulation.backend.lose_host("r3")
    simulation.pass_time(0.01)
    assert simulation.asked("end") == [("end", "work.1/y", "/result")]
    assert not simulation.supervisor.environment.unit["work.1"].publications
    assert not simulation.backend.topics
    simulation.backend.join_host("r3")
    simulation.pass_time(0.01)
    assert simulation.backend.topics == {"/result": "r3"}
    simulation.apply(ChangeSet(rewired=(PLACED[1],)))
    assert simulation.backend.feeding(TOPIC) == Stream("work.1", "y")
    simulation.check()


def test_nothing_waits_for_a_unit_on_a_host_that_is_lost_while_it_starts() -> None:
    simulation = fleet()
    before = simulation.supervisor.environment
    simulation.backend.lose_host("r3")
    began_s = simulation.backend.now()
    new = at("r3", unit("work.2", topic="/result", x="count.1/n"))
    with pytest.raises(ApplyError, match=r"work\.2 was given up: host r3 is gone: its link is cut"):
        simulation.apply(ChangeSet((new,), stopped=("work.1",)), basis=before)
    assert simulation.backend.now() - began_s < 0.1
    simulation.check()
    with pytest.raises(StaleChangeSetError, match=r"work\.2.* is to run on r3, which is gone"):
        simulation.apply(ChangeSet((new,), stopped=("work.1",)))
    simulation.backend.join_host("r3")
    simulation.pass_time(0.01)
    simulation.apply(ChangeSet((new,), stopped=("work.1",)))
    simulation.check()


def test_nothing_waits_for_a_unit_to_stop_on_a_host_that_is_lost() -> None:
    simulation = fleet()
    simulation.backend.behaviours["work"] = Behaviour(hung=True)
    simulation.backend.units["work.1"].behaviour = Behaviour(hung=True)
    simulation.backend.lose_host("r2")
    new = at("r1", unit("work.2", topic="/result", x="count.1/n"))
    applied = simulation.apply(ChangeSet((new,), stopped=("work.1",)))
    assert sum(applied.seconds.values()) < 0.1
    simulation.check()


def test_a_new_unit_that_an_undone_update_leaves_is_known_with_its_host() -> None:
    simulation = Simulation(source(), worker(), worker("bad"), bad=Behaviour(dies_at_start="no"))
    new = (*PLACED, at("r3", unit("bad.1", x="count.1/n")))
    with pytest.raises(ApplyError):
        simulation.apply(ChangeSet(new, added_hosts=HOSTS), keeps_new=True)
    assert {unit.id: unit.host for unit in simulation.supervisor.environment.units} == {"count.1": "r1", "work.1": "r2"}
    simulation.check()


def test_a_topic_moves_to_the_host_that_its_target_moves_to() -> None:
    simulation = fleet()
    simulation.apply(ChangeSet(added_targets=(replace(RESULT, host="r1"),)))
    assert simulation.backend.topics == {"/result": "r1"}
    assert simulation.backend.feeding(TOPIC) == Stream("work.1", "y")
    simulation.check()
    simulation.backend.behaviours["work"] = Behaviour(dies_at_start="no")
    with pytest.raises(ApplyError):
        simulation.apply(ChangeSet((at("r1", unit("work.2", x="count.1/n")),), added_targets=(AT_R3,)))
    assert not simulation.supervisor.environment.unit["work.1"].publications
    simulation.check()


def test_a_spare_on_a_host_that_is_lost_during_its_update_is_not_there_afterwards() -> None:
    simulation = fleet()
    simulation.backend.lose_host("r2")
    spares = (at("r2", unit("work.8"), standby=True), at("r1", unit("work.7"), standby=True))
    simulation.apply(ChangeSet((*spares, at("r1", unit("count.2")))))
    assert simulation.supervisor.environment.unit.keys() == {"count.1", "count.2", "work.7", "work.9"}


def test_a_manager_that_begins_late_is_told_the_ages_and_waits_of_that_moment() -> None:
    backend, told = SimulatedBackend({}), list[Event]()
    units = unit("count.1"), replace(unit("count.2"), host="r2")
    found = Found(units, (source(),), (Host("r2"),), {}, (), {}, ages_s={"count.1": 5.0, "count.2": 5.0})
    backend.found = lambda: found  # type: ignore[method-assign, assignment, return-value]
    supervisor = Supervisor(backend, Environment(), told.append)
    digest = order_digest(source())
    backend._later(0.0, FailuresKept("count", "r1", 3, 20.0, "no camera", digest))
    backend._later(0.0, FailuresKept("work", "r1", 1, 20.0, "no camera", digest))
    backend.lose_host("r2")
    while backend.now() < 5.0:
        supervisor.pump(1.0)
    supervisor.remember("work", "r1", None)
    supervisor.remember("count", "r2", Failures(source(), "r2", 2, 0.5, "no lens"))
    end_s = backend.now() + 2.0
    while backend.now() < end_s:
        supervisor.pump(1.0)
    passed_s = backend.now()
    assert supervisor.kept == [
        UnitFound("count.1", pytest.approx(5.0 + passed_s)),
        FailuresKept("count", "r1", 3, pytest.approx(20.0 - passed_s), "no camera", digest),
        FailuresKept("count", "r2", 2, 0.0, "no lens", digest),
    ]


def test_a_backend_that_lacks_methods_is_refused_with_their_names() -> None:
    whole = SimulatedBackend()
    names = {name for name in dir(whole) if not name.startswith("_")} - {"activate", "deactivate"}
    backend: Any = SimpleNamespace(**{name: getattr(whole, name) for name in names})
    with pytest.raises(InvalidValueError, match="SimpleNamespace lacks activate, deactivate; see Backend in cfgplan_"):
        Supervisor(backend, Environment(), lambda _: None)
    Supervisor(whole, Environment(), lambda _: None)
