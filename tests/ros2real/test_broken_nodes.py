"""Nodes that end, flood, hang, hide or publish nothing are named; the run goes on, and nothing of them is left."""

from __future__ import annotations

import os
import queue
from collections.abc import Callable
from dataclasses import replace
from itertools import islice

import psutil
import pytest
from cfgplan_runtime import ApplyError, Patience, Runtime
from cfgplan_runtime.processes.child_process import MOST_LINES
from cfgplan_runtime.supervision.events import UnitPrinted
from operated_world import PATIENCE_S, eventually
from ros2_words import Observer, command_of

from cfgplan.domain import (
    ChangeSet,
    ComputationUnit,
    InputPort,
    OutputPort,
    Publication,
    Stream,
    Subscription,
    Target,
    Transformation,
)

TYPE = "std_msgs/String"
TALKER = Transformation(
    "talker",
    (),
    (OutputPort("words", "Word", remap="chatter", type=TYPE),),
    source="node:./talking.py talker",
    params={"rate": 100},
)
SHOUT = Target("shout", "LoudWord", "/shout")
TALKING = ComputationUnit("talker.1", "talker")
MEGABYTE = 1 << 20


def broken(kind: str, source: str = "") -> Transformation:
    quiet = InputPort("quiet", "Word", type=TYPE)
    loud = OutputPort("loud", "LoudWord", remap="~loud", type=TYPE)
    return Transformation(kind, (quiet,), (loud,), source=source or f"node:./broken.py {kind}")


def unit(kind: str) -> ComputationUnit:
    feeds = (Subscription("quiet", Stream("talker.1", "words")),)
    return ComputationUnit(f"{kind}.1", kind, feeds, (Publication("loud", "/shout"),))


def begin(runtime: Runtime, transformation: Transformation) -> None:
    """Start a talker and a broken unit that it feeds; a busy computer takes a while to print 100 MB."""
    started = (TALKING, unit(transformation.label))
    change_set = ChangeSet(started, added_transformations=(TALKER, transformation), added_targets=(SHOUT,))
    runtime.apply(change_set, patience=Patience(start_s=4 * PATIENCE_S))


def processes(word: str) -> list[psutil.Process]:
    """The children with this word in their command line."""
    children = psutil.Process().children(recursive=True)
    return [child for child in children if any(word in part for part in command_of(child))]


@pytest.fixture
def lines(runtime: Runtime) -> Callable[[str, str], str]:
    """Returns the next line of a unit that has a text in it."""
    told: queue.SimpleQueue[UnitPrinted] = queue.SimpleQueue()
    runtime.listen(lambda event: told.put(event) if isinstance(event, UnitPrinted) else None)

    def next_of(unit: str, text: str) -> str:
        events = iter(lambda: told.get(timeout=PATIENCE_S), None)
        return next(event.line for event in events if event.unit == unit and text in event.line)

    return next_of


def test_a_node_that_exits_1_is_named_with_its_last_words(
    runtime: Runtime, lines: Callable[[str, str], str], observer: Observer
) -> None:
    mute = broken("mute", "node:./talking.py mute")
    talk = Target("talk", "Word", "/talk")
    talking = replace(TALKING, publications=(Publication("words", "/talk"),))
    runtime.apply(ChangeSet((talking,), added_transformations=(TALKER, mute), added_targets=(talk, SHOUT)))
    with pytest.raises(ApplyError, match=r"mute\.1 .*status 1"):
        runtime.apply(ChangeSet((unit("mute"),)))
    assert lines("mute.1", "voice") == "has no voice"
    assert not processes("__node:=mute_1")
    numbers = [int(word) for word in islice(observer.listen("/talk"), 20)]
    assert numbers == list(range(numbers[0], numbers[0] + 20)), "the others go on"


def test_a_node_that_prints_100_mb_is_cut_short_counted_and_works(runtime: Runtime, observer: Observer) -> None:
    shown: list[str] = []
    runtime.listen(lambda event: shown.append(event.line) if isinstance(event, UnitPrinted) else None)
    before = psutil.Process().memory_info().rss
    begin(runtime, broken("flood"))
    assert next(observer.listen("/shout")).endswith("!")
    assert psutil.Process().memory_info().rss - before < 50 * MEGABYTE
    runtime.apply(ChangeSet(stopped=("flood.1",)))
    left_out = sum(int(line.split()[1].replace(",", "")) for line in shown if "are left out" in line)
    printed = sum(set(line) == {"x"} for line in shown)
    assert 1_000_000 <= printed + left_out < 1_000_010, "a distribution may print some lines of its own"
    assert printed < 300 * MOST_LINES


def test_a_node_that_hangs_while_it_is_made_is_given_up_and_ends(runtime: Runtime) -> None:
    stuck = broken("stuck")
    runtime.apply(ChangeSet((TALKING,), added_transformations=(TALKER, stuck), added_targets=(SHOUT,)))
    with pytest.raises(ApplyError, match=r"stuck\.1 was not ready within 4 s"):
        runtime.apply(ChangeSet((unit("stuck"),)), patience=Patience(start_s=4.0))
    eventually(lambda: not processes("__node:=stuck_1"))
    assert processes("__node:=talker_1")


def test_a_port_that_is_never_published_is_named_and_the_run_goes_on(
    runtime: Runtime, lines: Callable[[str, str], str]
) -> None:
    begin(runtime, broken("shy"))
    told = lines("shy.1", "cfgplan:")
    assert told == ("cfgplan: /shy_1 does not publish /shy_1/out/loud: what is it called in its code (`remap`)?")
    assert processes("__node:=shy_1")


@pytest.mark.parametrize("params", [{}, {"use_sim_time": False}], ids=["unsaid", "said"])
def test_a_node_that_does_not_say_its_clock_is_told_of_a_simulated_one(
    params: dict[str, bool], runtime: Runtime, lines: Callable[[str, str], str], observer: Observer
) -> None:
    observer.publish("/clock", kind="rosgraph_msgs/msg/Clock", every=0)
    eventually(lambda: "/clock" in observer.look()["topics"])
    begin(runtime, replace(broken("shy"), params=params))
    told = [lines("shy.1", "cfgplan:")]
    if not params:
        assert "/clock is published: /shy_1 goes by it only with `params: {use_sim_time: true}`" in told[0]
        told = [lines("shy.1", "cfgplan:")]
    assert "does not publish" in told[0]


def test_two_nodes_in_one_process_that_get_the_same_name_are_told_of(
    runtime: Runtime, lines: Callable[[str, str], str], observer: Observer
) -> None:
    begin(runtime, broken("pair"))
    assert next(observer.listen("/shout")).endswith("!")
    assert "2 nodes are called /pair_1" in lines("pair.1", "cfgplan:")


def test_each_node_of_a_process_may_have_a_name_of_its_own(runtime: Runtime, observer: Observer) -> None:
    begin(runtime, broken("pair", "node:./broken.py pair --ros-args -r helper:__node:=mate --"))
    assert next(observer.listen("/shout")).endswith("!")
    eventually(lambda: {"/pair_1", "/mate"} <= {*observer.look()["nodes"]})
    assert observer.look()["nodes"].count("/pair_1") == 1
    pid = runtime.pid("pair.1")
    runtime.apply(ChangeSet(stopped=("pair.1",), removed_targets=("shout",)))
    assert pid
    assert not os.path.exists(f"/proc/{pid}")  # noqa: PTH110
