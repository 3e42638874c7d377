"""Running nodes are led to other sources: what comes is whole where both sources stamp alike."""

from __future__ import annotations

import queue
import struct
import subprocess
from collections.abc import Iterator
from dataclasses import replace
from itertools import dropwhile, islice

import pytest
from cfgplan_runtime import ApplyError, Runtime
from cfgplan_runtime.ros1.ros1_backend import Ros1Backend
from cfgplan_runtime.ros1.topic_ends import begins_with_header
from cfgplan_runtime.supervision.events import UnitPrinted
from operated_world import eventually
from words import NODES, await_pid, listening, messages, pid_of

from cfgplan.domain import (
    ALL,
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

pytestmark = pytest.mark.usefixtures("warm_nodes")
CLOCK = Transformation("clock", (), (OutputPort("ticks", "Tick"),), source="node:./talking.py clock")
SHOUTER = Transformation(
    "shouter",
    (InputPort("quiet", "Word"),),
    (OutputPort("loud", "LoudWord", remap="~loud"),),
    source="node:./talking.py shouter",
)


def talker(label: str, first: int) -> Transformation:
    words = OutputPort("words", "Word", remap="chatter")
    params = {"rate": 100, "first": first}
    return Transformation(label, (), (words,), source="node:./talking.py talker", params=params)


@pytest.fixture
def runtime() -> Iterator[Runtime]:
    with Runtime(backend=lambda: Ros1Backend(folder=NODES.parent)) as runtime:
        yield runtime


def unit(of: str, feeds: tuple[Subscription, ...] = (), topic: str | None = None) -> ComputationUnit:
    ports = {"clock": "ticks", "shouter": "loud"}
    published = () if topic is None else (Publication(ports[of.partition(".")[0]], topic),)
    return ComputationUnit(of, of.partition(".")[0], feeds, published)


def test_a_topic_goes_on_with_another_source_and_nothing_is_lost_or_repeated(runtime: Runtime) -> None:
    runtime.apply(ChangeSet((unit("clock.1", topic="/ticks"),), added_transformations=(CLOCK,), added_targets=(TICKS,)))
    with messages("/ticks") as ticks:
        seen = [tick_of(message) for message in islice(ticks, 10)]
        for old, new in (("clock.1", "clock.2"), ("clock.2", "clock.1")):
            runtime.apply(ChangeSet((unit(new, topic="/ticks"),), stopped=(old,)))
            seen += [tick_of(message) for message in islice(ticks, 10)]
        rest = seen[-1]
    assert seen == list(range(seen[0], rest + 1))


@pytest.mark.parametrize(
    ("definition", "begins"),
    [
        ("Header header\nPoint point\n", True),
        ("# This represents a Point with reference coordinate frame and timestamp\nHeader header\nPoint point\n", True),
        ("#\n\n  std_msgs/Header   header  # when\nuint32 height\n", True),
        ("uint8 OK=0\nHeader header\nuint8 state\n", True),
        ("# Header header\nfloat64 x\n", False),
        ("string text\nHeader header\n", False),
        ("HeaderLike header\n", False),
        ("", False),
        ("*", False),
    ],
)
def test_a_definition_tells_whether_a_message_begins_with_its_header(definition: str, begins: bool) -> None:
    assert begins_with_header(definition) == begins


TICKS = Target("ticks", "Tick", "/ticks")


def tick_of(message: bytes) -> int:
    """The x of a PointStamped, behind its header."""
    (frame,) = struct.unpack_from("<I", message, 12)
    return int(struct.unpack_from("<d", message, 16 + frame)[0])


def test_a_running_node_is_led_from_one_to_another_and_stays_the_same_process(runtime: Runtime) -> None:
    first, second = talker("first", 0), talker("second", 1_000_000)
    shouter = unit("shouter.1", (Subscription("quiet", Stream("first.1", "words")),), "/shout")
    started = (unit("first.1"), shouter)
    target = Target("shout", "LoudWord", "/shout")
    runtime.apply(ChangeSet(started, added_transformations=(first, second, SHOUTER), added_targets=(target,)))
    pid = runtime.pid("shouter.1")
    with listening("/shout") as shouts:
        before = number_of(next(shouts))
        assert before < 1_000_000
        rewired = replace(shouter, subscriptions=(Subscription("quiet", Stream("second.1", "words")),))
        runtime.apply(ChangeSet((unit("second.1"),), rewired=(rewired,), stopped=("first.1",)))
        after = list(islice(dropwhile(lambda number: number < 1_000_000, map(number_of, islice(shouts, 1000))), 50))
    assert after == list(range(after[0], after[0] + 50)), "the old source is heard no more, the new one is whole"
    assert runtime.pid("shouter.1") == pid


def test_an_input_that_takes_several_streams_hears_all_of_them(runtime: Runtime) -> None:
    library = (
        talker("first", 0),
        talker("second", 1_000_000),
        replace(SHOUTER, inputs=(InputPort("quiet", "Word", count=ALL),)),
    )
    feeds = tuple(Subscription("quiet", Stream(f"{one}.1", "words")) for one in ("first", "second"))
    started = (unit("first.1"), unit("second.1"), unit("shouter.1", feeds, "/shout"))
    runtime.apply(
        ChangeSet(started, added_transformations=library, added_targets=(Target("shout", "LoudWord", "/shout"),))
    )
    with listening("/shout") as shouts:
        heard = set[bool]()
        while len(heard) < 2:
            heard.add(number_of(next(shouts)) < 1_000_000)


def number_of(shout: str) -> int:
    return int(shout.removesuffix("!"))


def test_calls_of_a_service_go_to_the_node_that_offers_it_now(runtime: Runtime) -> None:
    asker = Transformation(
        "asker",
        (InputPort("oracle", "Oracle", service=True),),
        (OutputPort("answers", "Answer"),),
        source="node:./talking.py asker",
    )
    library = (asker, oracle("first"), oracle("second"))
    asking = ComputationUnit("asker.1", "asker", (asks("first.1"),), (Publication("answers", "/answers"),))
    target = Target("answers", "Answer", "/answers")
    started = (ComputationUnit("first.1", "first"), asking)
    runtime.apply(ChangeSet(started, added_transformations=library, added_targets=(target,)))
    with listening("/answers") as answers:
        assert "first" in islice(answers, 500)
        rewired = replace(asking, subscriptions=(asks("second.1"),))
        runtime.apply(ChangeSet((ComputationUnit("second.1", "second"),), rewired=(rewired,), stopped=("first.1",)))
        assert "second" in islice(answers, 500)


def asks(provider: str) -> Subscription:
    return Subscription("oracle", Stream(provider, "ask"))


def oracle(label: str) -> Transformation:
    ask = OutputPort("ask", "Oracle", remap="~ask")
    return Transformation(label, (), (ask,), source="node:./talking.py oracle", params={"called": label})


def test_a_node_that_somebody_else_runs_is_connected_and_never_stopped(runtime: Runtime) -> None:
    name = "/elsewhere/talker"
    somebodys = subprocess.Popen([NODES, "talker", "__ns:=elsewhere", "_rate:=100"], stdout=subprocess.DEVNULL)
    try:
        eventually(lambda: pid_of(name))
        words = OutputPort("words", "Word", remap="chatter")
        outside = Transformation("outside", (), (words,), source=f"external:{name}")
        absent = replace(outside, label="absent", source="external:/nobody")
        shouter = unit("shouter.1", (Subscription("quiet", Stream("outside.1", "words")),), "/shout")
        library, target = (outside, absent, SHOUTER), Target("shout", "LoudWord", "/shout")
        started = (ComputationUnit("outside.1", "outside"), shouter)
        runtime.apply(ChangeSet(started, added_transformations=library, added_targets=(target,)))
        with listening("/shout") as shouts:
            next(shouts)
        with pytest.raises(ApplyError, match="could not start"):
            runtime.apply(ChangeSet((ComputationUnit("absent.1", "absent"),)))
        runtime.stop()
        assert await_pid(name) == somebodys.pid
        runtime.apply(ChangeSet((ComputationUnit("outside.1", "outside"),)))
    finally:
        somebodys.kill()
        somebodys.wait()
    eventually(lambda: not runtime.environment.units)


def test_what_is_said_once_for_all_comes_later_too(runtime: Runtime) -> None:
    """A latched message reaches late listeners, topics that are led there later, and who changes its source."""
    first, second = (
        replace(talker(label, at), source="node:./talking.py mapper") for label, at in (("a", 1), ("b", 2))
    )
    target = Target("map", "Word", "/map")
    maps = (unit_of("a.1", "/map"), unit_of("b.1"))
    runtime.apply(ChangeSet(maps, added_transformations=(first, second), added_targets=(target,)))
    for _ in range(2):
        with listening("/map") as said:
            assert next(said) == "1"
    again = Target("again", "Word", "/again")
    runtime.apply(ChangeSet(rewired=(unit_of("a.1", "/map", "/again"),), added_targets=(again,)))
    with listening("/again") as said:
        assert next(said) == "1"
    runtime.apply(ChangeSet(rewired=(unit_of("b.1", "/map"),), stopped=("a.1",), removed_targets=("again",)))
    with listening("/map") as said:
        assert next(said) == "2"


def unit_of(of: str, *topics: str) -> ComputationUnit:
    published = tuple(Publication("words", topic) for topic in topics)
    return ComputationUnit(of, of.partition(".")[0], (), published)


def test_a_node_that_wants_another_message_type_is_told_of(runtime: Runtime) -> None:
    heard: queue.SimpleQueue[str] = queue.SimpleQueue()
    runtime.listen(lambda event: heard.put(event.line) if isinstance(event, UnitPrinted) else None)
    shouter = unit("shouter.1", (Subscription("quiet", Stream("clock.1", "ticks")),))
    runtime.apply(ChangeSet((unit("clock.1"), shouter), added_transformations=(CLOCK, SHOUTER)))
    told = next(line for line in iter(lambda: heard.get(timeout=60), None) if line.startswith("cfgplan:"))
    assert "/shouter_1 expects std_msgs/String, but the topic has geometry_msgs/PointStamped" in told
