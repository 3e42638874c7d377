"""Lifecycle nodes are configured before an update switches, activated when it does, and deactivated before they end."""

from __future__ import annotations

import queue
import re
import time
from collections.abc import Iterator
from dataclasses import replace
from itertools import islice

import psutil
import pytest
from cfgplan_runtime import ApplyError, Runtime
from cfgplan_runtime.supervision.events import Event, OutletsOpened, UnitHung, UnitPrinted, UnitReady, UnitStopped
from operated_world import PATIENCE_S, eventually
from ros2_words import POINT, Observer, command_of

from cfgplan.domain import (
    ChangeSet,
    ComputationUnit,
    InputPort,
    OutputPort,
    Publication,
    RunOptions,
    Stream,
    Subscription,
    Target,
    Transformation,
)

TICKS_PER_S = 100
POINT_TYPE = "geometry_msgs/PointStamped"
KEEPER = Transformation(
    "keeper", (), (OutputPort("ticks", "Tick", type=POINT_TYPE),), source="node:./managed_nodes.py keeper"
)
HEARER = Transformation(
    "hearer", (InputPort("ticks", "Tick", type=POINT_TYPE),), (), source="node:./managed_nodes.py hearer"
)
TICKS = Target("ticks", "Tick", "/ticks")


def keeper(of: str) -> ComputationUnit:
    return ComputationUnit(of, of.partition(".")[0], (), (Publication("ticks", "/ticks"),))


def replacement(new: str, *transformations: Transformation) -> ChangeSet:
    return ChangeSet((keeper(new),), stopped=("keeper.1",), added_transformations=transformations)


@pytest.fixture
def told(runtime: Runtime) -> list[tuple[str, str]]:
    """The units and their printed words, and the kinds of their other events, in order."""
    found: list[tuple[str, str]] = []

    def note(event: Event) -> None:
        if isinstance(event, UnitPrinted):
            found.append((event.unit, event.line))
        elif isinstance(event, UnitReady | UnitStopped):
            found.append((event.unit, type(event).__name__))

    runtime.listen(note)
    return found


def begin(runtime: Runtime, observer: Observer) -> Iterator[str]:
    """Start the first keeper. Returns the ticks that come, once they do."""
    change_set = ChangeSet((keeper("keeper.1"),), added_transformations=(KEEPER,), added_targets=(TICKS,))
    runtime.apply(change_set)
    ticks = observer.listen("/ticks", POINT)
    next(ticks)
    return ticks


def assert_whole(ticks: Iterator[str]) -> None:
    """Check that none of the next 200 ticks is lost or repeated."""
    seen = [int(tick) for tick in islice(ticks, 200)]
    assert seen == list(range(seen[0], seen[-1] + 1))


def test_a_lifecycle_node_is_replaced_without_a_gap_and_deactivated_before_it_ends(
    runtime: Runtime, observer: Observer, told: list[tuple[str, str]]
) -> None:
    ticks = begin(runtime, observer)
    runtime.apply(replacement("keeper.2"))
    eventually(lambda: ("keeper.1", "UnitStopped") in told)
    assert_whole(ticks)
    order = [
        ("keeper.2", "configure"),
        ("keeper.2", "UnitReady"),
        ("keeper.2", "activate"),
        ("keeper.1", "deactivate"),
        ("keeper.1", "UnitStopped"),
    ]
    assert [line for line in told if line in order] == order


def test_a_new_lifecycle_node_is_activated_when_the_slowest_new_unit_is_ready(
    runtime: Runtime, observer: Observer, told: list[tuple[str, str]]
) -> None:
    ticks = begin(runtime, observer)
    slow = replace(KEEPER, label="slow", params={"late": 1.5})
    started = (keeper("keeper.2"), ComputationUnit("slow.1", "slow"))
    runtime.apply(ChangeSet(started, stopped=("keeper.1",), added_transformations=(slow,)))
    assert_whole(ticks)
    eventually(lambda: ("keeper.2", "activate") in told)
    assert told.index(("slow.1", "UnitReady")) < told.index(("keeper.2", "activate"))


def test_the_first_message_of_a_source_comes_since_it_is_activated_last(
    runtime: Runtime, told: list[tuple[str, str]]
) -> None:
    """The hearer takes a second to be activated, and makes its subscription only then."""
    slow = replace(HEARER, params={"activate": "1.0"})
    hearer = ComputationUnit("hearer.1", "hearer", (Subscription("ticks", Stream("keeper.1", "ticks")),))
    started = (ComputationUnit("keeper.1", "keeper"), hearer)
    runtime.apply(ChangeSet(started, added_transformations=(KEEPER, slow)))

    def said(word: str) -> list[int]:
        return [int(line.split()[1]) for _, line in told if line.startswith(word)]

    eventually(lambda: said("first") and said("heard"))
    assert said("first") == said("heard")


@pytest.mark.parametrize("transition", ["configure", "activate"])
@pytest.mark.parametrize(
    ("how", "end"),
    [
        ("refuse", "refused a transition: /worse_1 could not be {verb}; its state is {state}"),
        ("raise", "refused a transition: /worse_1 could not be {verb}; its state is unconfigured"),
        ("die", "died: ended with exit status 3"),
    ],
)
def test_an_update_is_undone_with_its_cause_if_the_new_node_fails_in_a_transition(
    transition: str, how: str, end: str, runtime: Runtime, observer: Observer, told: list[tuple[str, str]]
) -> None:
    ticks = begin(runtime, observer)
    verb, state = {"configure": ("configured", "unconfigured"), "activate": ("activated", "inactive")}[transition]
    worse = replace(KEEPER, label="worse", params={transition: how})
    with pytest.raises(ApplyError, match=re.escape(f"worse.1 {end.format(verb=verb, state=state)}")):
        runtime.apply(replacement("worse.1", worse))
    assert_whole(ticks)
    assert ("keeper.1", "deactivate") not in told
    assert [unit.id for unit in runtime.environment.units] == ["keeper.1"]
    runtime.apply(replacement("keeper.2"))
    assert_whole(ticks)


def test_a_node_that_takes_long_to_be_configured_is_told_once(
    runtime: Runtime, observer: Observer, told: list[tuple[str, str]]
) -> None:
    ticks = begin(runtime, observer)
    slow = replace(KEEPER, label="slow", params={"configure": "6.0"})
    runtime.apply(replacement("slow.1", slow))
    assert_whole(ticks)
    assert [line for unit, line in told if unit == "slow.1"][:3] == ["configure", "UnitReady", "activate"]


def test_a_node_that_has_its_lifecycle_late_is_configured_and_activated_nevertheless(
    runtime: Runtime, observer: Observer, told: list[tuple[str, str]]
) -> None:
    """So it is on a busy computer, which takes seconds to make a node."""
    ticks = begin(runtime, observer)
    stalled = replace(KEEPER, label="stalled", source="node:./managed_nodes.py stalled")
    runtime.apply(replacement("stalled.1", stalled))
    eventually(lambda: ("stalled.1", "activate") in told)
    now = int(time.time() * TICKS_PER_S)
    next(tick for tick in ticks if int(tick) > now)
    runtime.apply(ChangeSet(stopped=("stalled.1",)))
    eventually(lambda: ("stalled.1", "UnitStopped") in told)
    order = ["configure", "activate", "deactivate", "UnitStopped"]
    assert [line for unit, line in told if unit == "stalled.1" and line in order] == order


def test_a_node_that_refuses_to_be_deactivated_ends_and_that_is_told(
    runtime: Runtime, told: list[tuple[str, str]]
) -> None:
    stubborn = replace(KEEPER, label="stubborn", params={"deactivate": "refuse"})
    change_set = ChangeSet((keeper("stubborn.1"),), added_transformations=(stubborn, KEEPER), added_targets=(TICKS,))
    runtime.apply(change_set)
    runtime.apply(ChangeSet((keeper("keeper.1"),), stopped=("stubborn.1",)))
    eventually(lambda: ("stubborn.1", "UnitStopped") in told)
    assert ("stubborn.1", "cfgplan: /stubborn_1 could not be deactivated; its state is active") in told


def test_a_node_that_is_being_deactivated_for_too_long_ends(runtime: Runtime, told: list[tuple[str, str]]) -> None:
    slow = replace(KEEPER, params={"deactivate": "60.0"})
    runtime.apply(ChangeSet((keeper("keeper.1"),), added_transformations=(slow,), added_targets=(TICKS,)))
    runtime.apply(ChangeSet(stopped=("keeper.1",)))
    eventually(lambda: ("keeper.1", "UnitStopped") in told)
    assert ("keeper.1", "deactivate") in told


def test_a_new_node_of_an_undone_update_stays_inactive_until_the_next_one(
    runtime: Runtime, observer: Observer, told: list[tuple[str, str]]
) -> None:
    ticks = begin(runtime, observer)
    worse = replace(KEEPER, label="worse", params={"activate": "refuse"})
    started = (keeper("keeper.2"), ComputationUnit("worse.1", "worse"))
    with pytest.raises(ApplyError, match="worse"):
        change_set = ChangeSet(started, stopped=("keeper.1",), added_transformations=(worse,))
        runtime.apply(change_set, keeps_new=True)
    assert_whole(ticks)

    def said(word: str) -> int:
        return told.count(("keeper.2", word))

    eventually(lambda: said("activate") == said("deactivate"))
    runtime.apply(ChangeSet(rewired=(keeper("keeper.2"),), stopped=("keeper.1",)))
    assert_whole(ticks)
    assert said("configure") == 1


def test_a_node_that_hangs_after_its_activation_was_taken_back_is_killed(runtime: Runtime, observer: Observer) -> None:
    """It has answered while the other node started. It is told to be inactive while it is being activated, then it
    hangs in the next transition.
    """
    hung: queue.SimpleQueue[str] = queue.SimpleQueue()
    runtime.listen(lambda event: hung.put(event.unit) if isinstance(event, UnitHung) else None)
    begin(runtime, observer)
    stuck = replace(
        KEEPER, label="stuck", params={"activate": "1.5", "deactivate": "60.0"}, run=RunOptions(hang_us=3_000_000)
    )
    worse = replace(KEEPER, label="worse", params={"activate": "refuse", "late": 5.0})
    started = (keeper("stuck.1"), ComputationUnit("worse.1", "worse"))
    with pytest.raises(ApplyError, match="worse"):
        change_set = ChangeSet(started, stopped=("keeper.1",), added_transformations=(stuck, worse))
        runtime.apply(change_set, keeps_new=True)
    assert hung.get(timeout=PATIENCE_S) == "stuck.1"


def test_a_new_helper_leaves_active_nodes_active_and_replaces_them(
    runtime: Runtime, observer: Observer, told: list[tuple[str, str]]
) -> None:
    ticks = begin(runtime, observer)
    renewed: queue.SimpleQueue[Event] = queue.SimpleQueue()
    runtime.listen(lambda event: renewed.put(event) if isinstance(event, OutletsOpened) else None)
    (helper,) = [one for one in psutil.Process().children() if "host/main.py" in " ".join(command_of(one))]
    helper.kill()
    renewed.get(timeout=PATIENCE_S)
    now = int(time.time() * TICKS_PER_S)
    next(tick for tick in ticks if int(tick) > now)
    runtime.apply(replacement("keeper.2"))
    eventually(lambda: ("keeper.1", "UnitStopped") in told)
    said = [line for unit, line in told if unit == "keeper.1"]
    assert [said.count(word) for word in ("configure", "activate", "deactivate")] == [1, 1, 1]
    assert_whole(ticks)
