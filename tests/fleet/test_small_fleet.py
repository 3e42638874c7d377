"""Units on several hosts: agents, wires between hosts, and what happens when hosts go and come."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from itertools import pairwise
from math import inf
from pathlib import Path

import pytest
from cfgplan_runtime.errors import StaleChangeSetError
from cfgplan_runtime.fleet.certificates import MANAGER
from cfgplan_runtime.fleet.links import LEASE_S, config
from cfgplan_runtime.fleet.presence import AgentNews, Presence
from cfgplan_runtime.fleet.ways import alive_key
from cfgplan_runtime.operating.flows import Flows
from cfgplan_runtime.streams.run_folder import address, base_folder, topics_of
from cfgplan_runtime.streams.zenoh_link import ZenohLink
from cfgplan_runtime.supervision.events import (
    HostJoined,
    HostLost,
    SourceExhausted,
    SpareLost,
    SparePrepared,
    SpareUsed,
    StateNotExact,
    UnitCutShort,
    UnitDied,
    UnitStopped,
)
from cfgplan_runtime.supervision.updates import Patience
from cfgplan_runtime.testing import Bench, check_middleware
from handing_over import delay_states
from small_fleet import (
    PATIENCE_S,
    Listener,
    cold,
    eventually,
    fed_by,
    gives,
    kill_unit,
    moved,
    seen,
    small_fleet,
    source,
    swap,
    unit,
    worker,
)

from cfgplan.domain import ChangeSet, ComputationUnit, Host, InputPort, Publication, RunOptions, Target, Transformation
from cfgplan.errors import InputError

COUNT = unit("count.1", "r1")
WORK = unit("work.1", "r2", topic="/result", x="count.1/n")


class BenchOfTwoHosts(Bench):
    """Sources run on r1, all else on r2."""

    def unit(
        self, number: int, transformation: Transformation, *, topic: str | None = None, source: int = 1
    ) -> ComputationUnit:
        made = super().unit(number, transformation, topic=topic, source=source)
        return replace(made, host="r1" if transformation is self.source else "r2")


def test_a_fleet_keeps_what_a_middleware_promises() -> None:
    with small_fleet("r1", "r2") as fleet:

        @contextmanager
        def bench() -> Iterator[Bench]:
            with fleet.runtime() as runtime:

                def topics() -> list[str]:
                    run = base_folder() / runtime.id
                    return [topic for topic in topics_of(run) if address(run, topic).exists()]

                yield BenchOfTwoHosts(
                    runtime,
                    source(rate_hz=100),
                    worker(),
                    worker("broken", "Broken"),
                    lambda name: kill_unit(runtime, name),
                    fleet.units,
                    topics,
                    lambda topic: gives(topic, runtime.id),
                )

        check_middleware(bench)


def test_swaps_across_hosts_lose_repeat_and_reorder_nothing() -> None:
    with small_fleet("r1", "r2", "r3") as fleet, fleet.runtime(source(), worker()) as runtime:
        runtime.apply(ChangeSet(started=(COUNT, WORK)))
        listener = Listener(runtime)
        listener.await_more(20)
        old = WORK
        for number in range(20):
            new = moved(WORK, f"work.{number + 2}", ("r3", "r2", "r1")[number % 3])
            assert runtime.apply(swap(old, new)).unswitched == 0
            old = new
        listener.await_more(20)
        assert listener.values == list(range(listener.values[0], listener.values[0] + len(listener.values)))
        assert listener.subscription.dropped == 0


def test_a_state_goes_to_the_next_unit_on_any_host_without_losing_a_step() -> None:
    """The source is on r1. The units are on r1, on r2, move between them, and have the topic beside them or not."""
    high, low = (worker(label, "Tally", run=RunOptions(state="altitude")) for label in ("high", "low"))
    with small_fleet("r1", "r2") as fleet, fleet.runtime(source(), high, low) as runtime:
        before = unit("high.0", "r2", topic="/result", x="count.1/n")
        runtime.apply(ChangeSet(started=(COUNT, before)))
        listener = Listener(runtime)
        listener.await_more(20)
        for number, host in enumerate(["r2", "r1", "r1", "r2", "r2", "r1"], start=1):
            new = unit(f"{('high', 'low')[number % 2]}.{number}", host, topic="/result", x="count.1/n")
            runtime.apply(swap(before, new))
            before = new
        listener.await_more(20)
        assert seen(runtime, StateNotExact) == []
        assert {after - before for before, after in pairwise(listener.values)} == {1}


def test_results_after_a_state_was_told_are_the_next_units_on_any_host() -> None:
    """The stream of the unit that pauses crosses to another host, or the topic's does, or none."""
    high, low = (
        replace(worker(label, "Tally", run=RunOptions(state="altitude")), params={"by": by})
        for label, by in (("high", 10), ("low", 1))
    )
    with small_fleet("r1", "r2") as fleet, fleet.runtime(source(), high, low) as runtime:
        before = unit("high.0", "r2", topic="/result", x="count.1/n")
        runtime.apply(ChangeSet(started=(COUNT, before)))
        listener = Listener(runtime)
        listener.await_more(20)
        delay_states(runtime)
        for number, host in enumerate(["r2", "r1", "r1", "r2"], start=1):
            new = unit(f"{('high', 'low')[number % 2]}.{number}", host, topic="/result", x="count.1/n")
            assert runtime.apply(swap(before, new)).unswitched == 0
            before = new
        listener.await_more(20)
        assert seen(runtime, StateNotExact) == []
        assert {after - before for before, after in pairwise(listener.values)} == {1, 10}


def test_a_unit_without_a_state_pauses_with_the_one_on_another_host_that_feeds_it() -> None:
    tally = worker("tally", "Tally", run=RunOptions(state=True))
    with small_fleet("r1", "r2") as fleet, fleet.runtime(source(), tally, worker()) as runtime:

        def chain(number: int) -> tuple[ComputationUnit, ...]:
            return (
                unit(f"tally.{number}", "r1", x="count.1/n"),
                unit(f"work.{number}", "r2", topic="/result", x=f"tally.{number}/y"),
            )

        runtime.apply(ChangeSet(started=(COUNT, *chain(0))))
        listener = Listener(runtime)
        listener.await_more(20)
        delay_states(runtime)
        for number in range(1, 4):
            stopped = tuple(one.id for one in chain(number - 1))
            assert runtime.apply(ChangeSet(started=chain(number), stopped=stopped)).unswitched == 0
        listener.await_more(20)
        assert seen(runtime, StateNotExact) == []
        assert {after - before for before, after in pairwise(listener.values)} == {1}


def test_streams_of_several_hosts_feed_one_input_and_each_is_moved_without_loss_for_any() -> None:
    gather = replace(worker("gather"), inputs=(InputPort("x", "N", count=2),))
    one, two = unit("work.1", "r1", x="count.1/n"), unit("work.2", "r2", x="count.1/n")
    gathering = replace(
        unit("gather.1", "r2", topic="/result", x="work.1/y"), subscriptions=fed_by("work.1/y", "work.2/y")
    )
    with small_fleet("r1", "r2") as fleet, fleet.runtime(source(), worker(), gather) as runtime:
        runtime.apply(ChangeSet(started=(COUNT, one, two, gathering)))
        listener = Listener(runtime)
        listener.await_more(20)
        for number, (old, new, host) in enumerate((("work.1", "work.3", "r2"), ("work.2", "work.4", "r1"))):
            streams = fed_by("work.3/y", "work.2/y" if number == 0 else "work.4/y")
            fed = replace(gathering, subscriptions=streams)
            assert runtime.apply(ChangeSet((moved(one, new, host),), (fed,), (old,))).unswitched == 0
        listener.await_more(20)
        assert all(len(value) == 2 for value in listener.values)
        for one_stream in zip(*listener.values, strict=True):
            assert {after - before for before, after in pairwise(one_stream)} == {1}
        with fleet.runtime(source(), worker(), gather, takes_over=True) as later:
            assert later.environment.unit["gather.1"] == replace(
                gathering, subscriptions=fed_by("work.3/y", "work.4/y")
            )
            assert set(later.environment.unit) == {"count.1", "work.3", "work.4", "gather.1"}


def test_a_source_that_ends_is_heard_to_its_last_element_on_another_host(tmp_path: Path) -> None:
    ending = source("ending", "count_until", note=str(tmp_path / "end"))
    with small_fleet("r1", "r2") as fleet, fleet.runtime(ending, worker()) as runtime:
        runtime.apply(ChangeSet(started=(unit("ending.1", "r1"), replace(WORK, subscriptions=fed_by("ending.1/n")))))
        listener = Listener(runtime)
        listener.await_more(20)
        (tmp_path / "end").touch()
        eventually(lambda: bool(seen(runtime, SourceExhausted)))
        last = int((tmp_path / "end").read_text())
        eventually(lambda: listener.values[-1] == last)
        assert listener.values == list(range(listener.values[0], last + 1))


def test_a_dead_agent_is_noticed_at_once_and_its_units_are_replaced_elsewhere() -> None:
    """Once it has been steady for a while; before that its links may have ended for another reason."""
    with small_fleet("r1", "r2", "r3") as fleet, fleet.runtime(source(), worker()) as runtime:
        runtime.apply(ChangeSet(started=(COUNT, WORK)))
        listener = Listener(runtime)
        listener.await_more(10)
        pulse = runtime.supervisor.backend._presence.there["r2"].pulse
        eventually(lambda: pulse.is_steady(time.monotonic()))
        fleet.agents.processes["r2"].kill()
        eventually(lambda: bool(seen(runtime, HostLost)))
        assert seen(runtime, HostLost) == [HostLost("r2", "its agent is gone")]
        assert set(runtime.environment.unit) == {"count.1"}
        runtime.apply(ChangeSet(started=(moved(WORK, "work.2", "r3"),)))
        listener.await_more(10)
        assert listener.values == sorted(set(listener.values))


def test_an_agent_whose_links_end_although_it_lives_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    """It has closed its link because it heard nothing, and opens it again."""
    with small_fleet("r1") as fleet, fleet.runtime(source()) as runtime:
        runtime.apply(ChangeSet(started=(COUNT,)))
        presence = runtime.supervisor.backend._presence
        host = presence.there["r1"]
        eventually(lambda: host.pulse.is_steady(time.monotonic()))
        monkeypatch.setattr(presence._heartbeats, "ask_at_once", lambda _: PATIENCE_S)
        presence._inbox.put((f"{alive_key('r1')}/{host.life}", False))
        eventually(lambda: host.pulse.ended_s > 0)
        eventually(lambda: not host.pulse.gone_s < inf)
        assert seen(runtime, HostLost) == []
        assert presence.there["r1"] is host


def test_an_agent_that_zenoh_does_not_tell_of_is_found_and_lost_by_its_signs_of_life(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(ZenohLink, "watch", lambda *_: None)
    with small_fleet("r1", "r2") as fleet, fleet.runtime(source(), worker()) as runtime:
        runtime.apply(ChangeSet(started=(COUNT, WORK)))
        fleet.agents.processes["r2"].kill()
        eventually(lambda: bool(seen(runtime, HostLost)))
        (lost,) = seen(runtime, HostLost)
        assert lost.host == "r2" and lost.cause.startswith("nothing was heard of it for")


def test_the_end_of_a_wire_from_a_dead_host_is_told_to_units_elsewhere() -> None:
    from_r2 = replace(COUNT, host="r2")
    at_r1 = replace(WORK, host="r1")
    with small_fleet("r1", "r2", "r3") as fleet, fleet.runtime(source(), worker()) as runtime:
        runtime.apply(ChangeSet(started=(from_r2, at_r1)))
        listener = Listener(runtime)
        listener.await_more(10)
        fleet.agents.processes["r2"].kill()
        eventually(lambda: bool(seen(runtime, HostLost)))
        count = len(listener.values)
        fed = replace(at_r1, subscriptions=fed_by("count.2/n"))
        runtime.apply(ChangeSet(started=(unit("count.2", "r3"),), rewired=(fed,)))
        eventually(lambda: len(listener.values) > count)


def test_a_host_that_returns_is_cleared_and_used_again() -> None:
    with small_fleet("r1", "r2") as fleet, fleet.runtime(source(), worker()) as runtime:
        runtime.apply(ChangeSet(started=(COUNT, WORK)))
        Listener(runtime).await_more(10)
        agent = fleet.agents.processes["r2"]
        joined = len(seen(runtime, HostJoined))
        agent.send_signal(signal.SIGSTOP)
        eventually(lambda: bool(seen(runtime, HostLost)))
        agent.send_signal(signal.SIGCONT)
        eventually(lambda: len(seen(runtime, HostJoined)) > joined)
        assert max(abs(event.ahead_us) for event in seen(runtime, HostJoined)) < 100_000, "all have one clock here"
        assert fleet.units() == ["count.1"], "its stale unit is gone"
        listener = Listener(runtime)
        runtime.apply(ChangeSet(started=(moved(WORK, "work.2", "r2"),)))
        listener.await_more(10)


def test_a_topic_of_no_certain_host_is_there_again_once_any_host_is() -> None:
    units = COUNT, replace(WORK, host="r1", publications=(Publication("y", "/free"),))
    with small_fleet("r1") as fleet, fleet.runtime(source(), worker()) as runtime:
        runtime.apply(ChangeSet(units, added_targets=(Target("free", "Y", "/free"),)))
        Listener(runtime, "/free").await_more(10)
        joined = len(seen(runtime, HostJoined))
        fleet.agents.processes["r1"].send_signal(signal.SIGSTOP)
        eventually(lambda: bool(seen(runtime, HostLost)))
        fleet.agents.processes["r1"].send_signal(signal.SIGCONT)
        eventually(lambda: len(seen(runtime, HostJoined)) > joined)
        runtime.apply(ChangeSet(units))
        Listener(runtime, "/free").await_more(10)


def test_a_dead_unit_on_another_host_is_told_with_its_cause() -> None:
    with small_fleet("r1", "r2") as fleet, fleet.runtime(source(), worker()) as runtime:
        runtime.apply(ChangeSet(started=(COUNT, WORK)))
        kill_unit(runtime, "work.1")
        eventually(lambda: bool(seen(runtime, UnitDied)))
        (died,) = seen(runtime, UnitDied)
        assert died.unit == "work.1"
        assert "killed by SIGKILL" in died.cause


def test_other_code_on_a_host_is_a_failed_start_that_names_it(tmp_path: Path) -> None:
    with small_fleet("r1", "r2") as fleet:
        (tmp_path / "fleet_units.py").write_text("def count(): yield 1")
        with fleet.backend("r1", "r2", folder=tmp_path) as backend:
            backend.start("count.1", source(), None, "r2")
            died = None
            while died is None:
                died = next((event for event in backend.wait(1.0) if isinstance(event, UnitDied)), None)
            assert "on r2" in died.cause
            assert "another version than the manager's" in died.cause


def test_hosts_without_an_agent_are_lost_from_the_beginning() -> None:
    with small_fleet("r1") as fleet:
        with fleet.runtime():
            pass  # r1 is there
        with fleet.runtime(hosts=("r1", "r2"), wait_s=1.0) as runtime:
            (lost,) = seen(runtime, HostLost)
            assert lost.host == "r2"


def test_a_manager_that_has_left_is_no_rival_though_it_still_seems_alive() -> None:
    with small_fleet("r1") as fleet:
        link = ZenohLink(config(connect=fleet.endpoints))
        with fleet.backend("r1") as first:
            link.live(f"{alive_key(MANAGER)}/{first.id}")
        assert link.alive(f"{alive_key(MANAGER)}/*")
        with fleet.runtime(source(), worker()) as runtime:
            runtime.apply(ChangeSet(started=(COUNT,)))
        link.close()


def test_what_another_run_has_is_not_taken_from_it() -> None:
    with small_fleet("r1") as fleet, fleet.runtime(source(), worker()) as runtime:
        with pytest.raises(InputError, match="another run has host 'r1'"), fleet.backend("r1"):
            pass
        runtime.apply(ChangeSet(started=(COUNT, replace(WORK, host="r1"))))
        Listener(runtime).await_more(10)


def test_who_takes_over_is_obeyed_and_the_other_is_refused() -> None:
    with small_fleet("r1") as fleet, fleet.runtime(source(), worker()) as runtime:
        runtime.apply(ChangeSet(started=(COUNT, replace(WORK, host="r1"))))
        with fleet.backend("r1", takes_over=True):
            eventually(lambda: fleet.units() == [])
            eventually(lambda: bool(seen(runtime, HostLost)))  # though it has given no order since
            (lost,) = seen(runtime, HostLost)
            assert lost.cause == "it obeys another manager"
            with pytest.raises(StaleChangeSetError):
                runtime.apply(ChangeSet(started=(unit("count.2", "r1"),)))
            assert fleet.units() == []


def test_a_host_may_have_any_name() -> None:
    hosts = "r1", "*", "r?/2 #"
    with small_fleet(*hosts) as fleet, fleet.runtime(source(), worker()) as runtime:
        runtime.apply(ChangeSet(started=(replace(COUNT, host=hosts[1]), replace(WORK, host=hosts[2]))))
        Listener(runtime).await_more(10)
        fleet.agents.processes["*"].kill()
        eventually(lambda: bool(seen(runtime, HostLost)))
        assert [lost.host for lost in seen(runtime, HostLost)] == ["*"]


def test_a_full_input_that_blocks_makes_a_source_on_another_host_wait() -> None:
    run = RunOptions(queue=4, blocks=True)
    slow = worker(code="slow", run=run)
    with small_fleet("r1", "r2") as fleet, fleet.runtime(source(rate_hz=2000), slow) as runtime:
        runtime.apply(ChangeSet(started=(COUNT, WORK)))
        listener = Listener(runtime)
        listener.await_more(100)
        assert listener.values == list(range(listener.values[0], listener.values[0] + len(listener.values)))


def test_what_goes_between_hosts_is_counted_by_stream_and_hosts() -> None:
    with small_fleet("r1", "r2") as fleet, fleet.runtime(source(), worker()) as runtime:
        flows = Flows()
        runtime.listen(flows.hear)
        runtime.apply(ChangeSet(started=(COUNT, WORK)))
        there, back = ("count.1/n", "r1", "r2"), ("work.1/y", "r2", "r1")

        def elements(*labels: tuple[str, str, str]) -> int:
            return min(flows.crossings[one].elements if one in flows.crossings else 0 for one in labels)

        eventually(lambda: elements(there, back) > 20)
        runtime.apply(ChangeSet(stopped=("count.1", "work.1")))
        eventually(lambda: elements(("", "r1", "r2"), ("", "r2", "r1")) > 20)
        assert {counts.dropped for counts in flows.crossings.values()} == {0}


def test_what_a_killed_manager_has_left_goes_on_under_the_next_without_a_gap() -> None:
    with small_fleet("r1", "r2") as fleet:
        with fleet.other_manager() as first:
            listener = fleet.outside_listener("r1")
            listener.await_more(20)
            first.kill()
            listener.await_more(20)
        (prepared,) = fleet.spares().values()
        with fleet.runtime(source(), worker()) as runtime:
            assert set(runtime.environment.units) == {COUNT, WORK, cold("work.9", "r1")}
            backend = runtime.supervisor.backend
            eventually(lambda: backend.usage("work.9") is not None)
            assert backend.usage("work.9").pid == prepared
            eventually(lambda: len(runtime.observe()) == 2 and all(one.steps > 0 for one in runtime.observe()))
            assert all(one.labor_us > 0 and one.cpu_us > one.labor_us for one in runtime.observe())
            assert {one.unit: one.host for one in runtime.observe()} == {"count.1": "r1", "work.1": "r2"}
            listener.await_more(20)
            for number in range(3):
                old, new = (moved(WORK, f"work.{number + n}", ("r1", "r2")[(number + n) % 2]) for n in (1, 2))
                runtime.apply(swap(WORK if number == 0 else old, new))
                if number == 0:
                    assert runtime.pid("work.2") == prepared, "it begins where the spare was prepared"
            listener.await_more(20)
            assert listener.values == list(range(listener.values[0], listener.values[0] + len(listener.values)))
            assert sorted(fleet.units()) == ["count.1", "work.4"]


def test_a_unit_that_was_told_to_stop_gives_what_it_has_got_under_the_next_manager(tmp_path: Path) -> None:
    ending = source("ending", "count_until", rate_hz=40, note=str(tmp_path / "end"))
    with small_fleet("r1", "r2") as fleet, fleet.runtime(ending, worker(code="slower")) as runtime:
        fed = replace(WORK, subscriptions=fed_by("ending.1/n"))
        runtime.apply(ChangeSet(started=(unit("ending.1", "r1"), fed)))
        listener = fleet.outside_listener("r1")
        listener.await_more(15)
        (tmp_path / "end").touch()
        eventually(lambda: bool(seen(runtime, SourceExhausted)))
        runtime.supervisor.backend.stop("work.1")
        runtime.supervisor.backend.wake()
        with fleet.runtime(ending, worker(code="slower"), takes_over=True) as later:
            is_there = "work.1" in fleet.units()  # a busy computer takes over later than it ends
            assert "work.1" not in later.environment.unit
            later.apply(ChangeSet(started=(replace(fed, publications=()),)))
            assert not is_there or len(seen(later, UnitStopped)) == 1, "no other unit of that id is started before"
            last = int((tmp_path / "end").read_text())
            eventually(lambda: listener.values[-1] == last)
            assert listener.values == list(range(listener.values[0], last + 1))


def test_units_that_would_be_started_otherwise_now_are_not_adopted() -> None:
    with small_fleet("r1", "r2") as fleet:
        with fleet.other_manager():
            pass
        with fleet.runtime(source(rate_hz=100), worker()) as runtime:
            assert {one.id for one in runtime.environment.units} == {"work.1", "work.9"}
            assert runtime.environment.unit["work.1"].subscriptions == ()
            eventually(lambda: fleet.units() == ["work.1"])


@pytest.mark.parametrize("is_told", [True, False], ids=["told to stop", "not adopted"])
def test_a_unit_that_ends_under_the_next_manager_has_the_time_of_its_own_stop(tmp_path: Path, is_told: bool) -> None:
    """Its step is not interrupted, and it is not killed, after the time that a unit without `stop` has."""
    hold = tmp_path / "hold"
    ending = source("ending", "count_until", rate_hz=40, note=str(tmp_path / "end"))
    waits = replace(worker(code="Waits", run=RunOptions(stop_us=120_000_000)), params={"hold": str(hold)})
    with small_fleet("r1", "r2") as fleet, fleet.runtime(ending, waits) as runtime:
        runtime.apply(ChangeSet(started=(unit("ending.1", "r1"), replace(WORK, subscriptions=fed_by("ending.1/n")))))
        listener = fleet.outside_listener("r1")
        listener.await_more(15)
        hold.touch()
        eventually(lambda: hold.with_suffix(".waiting").exists())
        (tmp_path / "end").touch()
        eventually(lambda: bool(seen(runtime, SourceExhausted)))
        if is_told:
            runtime.supervisor.backend.stop("work.1")
            runtime.supervisor.backend.wake()
        library = (ending, waits if is_told else replace(waits, label="other"))
        with fleet.runtime(*library, takes_over=True) as later:
            assert "work.1" not in later.environment.unit
            begin_s = later.supervisor.now()
            eventually(lambda: later.supervisor.now() > begin_s + 2 * Patience().stop_s)
            assert "work.1" in fleet.units()
            assert not seen(later, UnitStopped) and not seen(later, UnitCutShort)
            hold.unlink()
            last = int((tmp_path / "end").read_text())
            eventually(lambda: listener.values[-1] == last)
            assert listener.values == list(range(listener.values[0], last + 1))
            eventually(lambda: bool(seen(later, UnitStopped)))
            assert not seen(later, UnitCutShort)


def test_the_state_of_units_that_have_ended_is_known_to_the_next_manager() -> None:
    tally = worker(code="Tally", run=RunOptions(state="altitude"))
    with small_fleet("r1", "r2") as fleet, fleet.runtime(source(), tally) as runtime:
        runtime.apply(ChangeSet(started=(COUNT, WORK)))
        listener = Listener(runtime)
        listener.await_more(20)
        runtime.apply(ChangeSet(stopped=("work.1",)))
        last = listener.values[-1]
        with fleet.runtime(source(), tally, takes_over=True) as later:
            later.apply(ChangeSet(started=(moved(WORK, "work.2", "r1"),)))
            again = Listener(later)
            again.await_more(1)
            assert again.values[0] > last


def test_spares_that_would_be_started_otherwise_now_are_ended() -> None:
    with small_fleet("r1", "r2") as fleet:
        with fleet.other_manager():
            assert fleet.spares().keys() == {"work.9"}
        with fleet.runtime(source(), worker(code="slow")) as runtime:
            assert {one.id for one in runtime.environment.units} == {"count.1"}
            eventually(lambda: not fleet.spares())


def test_a_unit_begins_where_a_spare_is_prepared_on_another_host() -> None:
    with small_fleet("r1", "r2") as fleet, fleet.runtime(source(), worker()) as runtime:
        runtime.apply(ChangeSet(started=(COUNT, cold("work.9", "r2"), cold("work.8", "r1"))))
        eventually(lambda: len(seen(runtime, SparePrepared)) == 2)
        prepared = fleet.spares()
        runtime.apply(ChangeSet(started=(WORK,), stopped=("work.9",)))
        assert seen(runtime, SpareUsed) == [SpareUsed("work.1", "work.9")]
        Listener(runtime).await_more(10)
        assert runtime.pid("work.1") == prepared["work.9"]
        assert fleet.spares() == {"work.8": prepared["work.8"]}
        os.kill(prepared["work.8"], signal.SIGKILL)
        eventually(lambda: len(seen(runtime, SparePrepared)) == 3)
        assert seen(runtime, SpareLost) == [SpareLost("work.8", "killed by SIGKILL")]
        runtime.apply(ChangeSet(stopped=("work.8",)))
        eventually(lambda: not fleet.spares())


def test_the_spares_of_a_fleet_end_with_their_run() -> None:
    with small_fleet("r1") as fleet:
        with fleet.runtime(source(), worker()) as runtime:
            runtime.apply(ChangeSet(started=(COUNT, cold("work.9", "r1"))))
            eventually(lambda: bool(seen(runtime, SparePrepared)))
            assert fleet.spares().keys() == {"work.9"}
        eventually(lambda: not fleet.spares())


def test_a_host_that_returns_is_cleared_of_its_spares() -> None:
    with small_fleet("r1", "r2") as fleet, fleet.runtime(source(), worker()) as runtime:
        runtime.apply(ChangeSet(started=(COUNT, cold("work.9", "r2"))))
        eventually(lambda: bool(seen(runtime, SparePrepared)))
        joined = len(seen(runtime, HostJoined))
        fleet.agents.processes["r2"].send_signal(signal.SIGSTOP)
        eventually(lambda: bool(seen(runtime, HostLost)))
        assert runtime.environment.unit.keys() == {"count.1"}
        fleet.agents.processes["r2"].send_signal(signal.SIGCONT)
        eventually(lambda: len(seen(runtime, HostJoined)) > joined)
        eventually(lambda: not fleet.spares())


def test_a_spare_of_other_code_on_a_host_is_not_prepared_and_the_host_is_named(tmp_path: Path) -> None:
    with small_fleet("r1") as fleet:
        (tmp_path / "fleet_units.py").write_text("def count(): yield 1")
        with fleet.backend("r1", folder=tmp_path) as backend:
            backend.prepare("count.9", source(), "r1")
            lost = None
            while lost is None:
                lost = next((event for event in backend.wait(1.0) if isinstance(event, SpareLost)), None)
            assert "on r1" in lost.cause
            assert "another version than the manager's" in lost.cause


def test_who_sees_fewer_than_half_of_the_hosts_does_not_take_over() -> None:
    with small_fleet("r1", "r2", "r3") as fleet, fleet.other_manager():
        fleet.agents.processes["r2"].kill()
        fleet.agents.processes["r3"].kill()
        eventually(lambda: fleet.units() == ["count.1"])
        taking = fleet.backend("r1", "r2", "r3", takes_over=True, wait_s=1.0)
        with pytest.raises(InputError, match="1 of 3 hosts"), taking:
            pass
        assert fleet.units() == ["count.1"]


def test_a_run_takes_the_hosts_that_it_names_and_another_run_has_the_others() -> None:
    with small_fleet("r1", "r2") as fleet, fleet.runtime(source(), hosts=("r1",)) as first:
        first.apply(ChangeSet(started=(COUNT,)))
        with fleet.runtime(source("other"), hosts=("r2",)) as second:
            second.apply(ChangeSet(started=(unit("other.1", "r2"),)))
            assert sorted(fleet.units()) == ["count.1", "other.1"]
            assert {event.host for event in seen(first, HostJoined)} == {"r1"}
            assert {event.host for event in seen(second, HostJoined)} == {"r2"}


def test_a_host_that_an_update_adds_is_used_at_once_and_one_that_it_removes_is_free_for_another_run() -> None:
    with small_fleet("r1", "r2") as fleet, fleet.runtime(source(), hosts=("r1",)) as runtime:
        with fleet.backend("r2"):
            pass  # its agent is there
        there = unit("count.1", "r2")
        runtime.apply(ChangeSet(started=(there,), added_hosts=(Host("r2"),)))
        assert fleet.units() == ["count.1"]
        runtime.apply(ChangeSet(stopped=("count.1",), removed_hosts=("r2",)))
        with fleet.runtime(source(), hosts=("r2",)) as other:
            other.apply(ChangeSet(started=(there,)))
            assert fleet.units() == ["count.1"]
            assert not seen(runtime, HostLost)


def test_an_added_host_that_another_run_has_or_that_has_no_agent_is_lost_before_anything_starts_there() -> None:
    with (
        small_fleet("r1", "r2") as fleet,
        fleet.runtime(source(), hosts=("r1",)) as runtime,
        fleet.runtime(source(), hosts=("r2",)) as other,
    ):
        other.apply(ChangeSet(started=(unit("count.1", "r2"),)))
        for host in ("r2", "r3"):
            with pytest.raises(StaleChangeSetError, match=host):
                runtime.apply(ChangeSet(started=(unit("count.2", host),), added_hosts=(Host(host),)))
        causes = {event.host: event.cause for event in seen(runtime, HostLost)}
        assert causes == {"r2": "it obeys another manager", "r3": "it has no agent"}
        assert fleet.units() == ["count.1"]


def test_a_unit_that_any_host_may_have_dies_with_its_host() -> None:
    with small_fleet("r1", "r2") as fleet, fleet.runtime(source()) as runtime:
        runtime.apply(ChangeSet(started=(unit("count.1", None),)))
        fleet.agents.processes["r1"].kill()
        eventually(lambda: bool(seen(runtime, UnitDied)))
        (died,) = seen(runtime, UnitDied)
        assert died.unit == "count.1" and died.cause.startswith("host r1 is gone: ")
        assert not runtime.environment.units
        runtime.apply(ChangeSet(started=(unit("count.2", None),)))
        assert fleet.units() == ["count.2"]


def test_a_manager_that_was_suspended_while_another_took_over_is_told_when_it_goes_on() -> None:
    with small_fleet("r1") as fleet, fleet.other_manager() as process:
        process.send_signal(signal.SIGSTOP)
        with fleet.backend("r1", takes_over=True) as later:
            end_s = time.monotonic() + 2 * LEASE_S
            while time.monotonic() < end_s:
                later.wait(0.1)
            process.send_signal(signal.SIGCONT)
            assert process.stdout is not None
            assert process.stdout.readline() == b"it obeys another manager\n"


def test_a_host_that_joins_and_is_lost_while_others_are_awaited_is_lost_once(monkeypatch: pytest.MonkeyPatch) -> None:
    awaited = Presence.await_all

    def lost_meanwhile(presence: Presence, hosts: Sequence[str], wait_s: float, *, takes_over: bool) -> list[AgentNews]:
        happened = awaited(presence, hosts, wait_s, takes_over=takes_over)
        presence.leave_alone(presence.there["r1"], "its agent is gone")
        return [*happened, *presence.wait(0.0)[0]]

    monkeypatch.setattr(Presence, "await_all", lost_meanwhile)
    with small_fleet("r1", "r2") as fleet, fleet.backend("r1", "r2") as backend:
        told = [event for event in backend.wait(0.0) if isinstance(event, HostJoined | HostLost) and event.host == "r1"]
        assert [type(event) for event in told] == [HostJoined, HostLost]
