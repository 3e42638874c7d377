"""Running nodes are led to other sources: what comes is whole where both sources stamp alike."""

from __future__ import annotations

import queue
import subprocess
from collections.abc import Iterator
from dataclasses import replace
from itertools import islice

import pytest
from cfgplan_runtime import ApplyError, Runtime
from cfgplan_runtime.supervision.events import UnitPrinted
from operated_world import eventually
from ros2_venv import PYTHON
from ros2_words import NODES, POINT, Observer, observing

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

SWITCHES = 100
STRING = "std_msgs/String"
CLOCK = Transformation("clock", (), (OutputPort("ticks", "Tick"),), source="node:./talking.py clock")
SHOUTER = Transformation(
    "shouter",
    (InputPort("quiet", "Word"),),
    (OutputPort("loud", "LoudWord", remap="~loud"),),
    source="node:./talking.py shouter",
)
TICKS, SHOUT = Target("ticks", "Tick", "/ticks"), Target("shout", "LoudWord", "/shout")


def talker(label: str, first: int, node: str = "talker") -> Transformation:
    words = OutputPort("words", "Word", remap="chatter", type=STRING)
    return Transformation(label, (), (words,), source=f"node:./talking.py {node}", params={"rate": 100, "first": first})


def unit(of: str, feeds: tuple[Subscription, ...] = (), *topics: str) -> ComputationUnit:
    label = of.partition(".")[0]
    port = {"clock": "ticks", "shouter": "loud"}.get(label, "words")
    return ComputationUnit(of, label, feeds, tuple(Publication(port, topic) for topic in topics))


def shouter(source: str) -> ComputationUnit:
    return unit("shouter.1", (Subscription("quiet", Stream(source, "words")),), "/shout")


def number_of(shout: str) -> int:
    return int(shout.removesuffix("!"))


def test_a_hundred_switches_between_two_sources_lose_and_repeat_nothing(runtime: Runtime, observer: Observer) -> None:
    """The clocks run on, and the topic is led from one to the other."""
    clocks = (unit("clock.1", (), "/ticks"), unit("clock.2"))
    runtime.apply(ChangeSet(clocks, added_transformations=(CLOCK,), added_targets=(TICKS,)))
    ticks = observer.listen("/ticks", POINT)
    seen = [int(tick) for tick in islice(ticks, 20)]
    for number in range(SWITCHES):
        old, new = ("clock.1", "clock.2") if number % 2 == 0 else ("clock.2", "clock.1")
        runtime.apply(ChangeSet(rewired=(unit(new, (), "/ticks"), unit(old))))
    seen += [int(tick) for tick in islice(ticks, 400)]
    assert seen == list(range(seen[0], seen[-1] + 1))


def test_a_topic_goes_on_with_a_new_node_and_nothing_is_lost_or_repeated(runtime: Runtime, observer: Observer) -> None:
    runtime.apply(ChangeSet((unit("clock.1", (), "/ticks"),), added_transformations=(CLOCK,), added_targets=(TICKS,)))
    ticks = observer.listen("/ticks", POINT)
    seen = [int(tick) for tick in islice(ticks, 10)]
    for old, new in (("clock.1", "clock.2"), ("clock.2", "clock.1")):
        runtime.apply(ChangeSet((unit(new, (), "/ticks"),), stopped=(old,)))
        seen += [int(tick) for tick in islice(ticks, 10)]
    assert seen == list(range(seen[0], seen[-1] + 1))


def test_a_running_node_is_led_from_one_to_another_and_stays_the_same_process(
    runtime: Runtime, observer: Observer
) -> None:
    """Words have no stamp: the old source is heard no more, the new one is whole."""
    library = (talker("first", 0), talker("second", 1_000_000), SHOUTER)
    started = (unit("first.1"), unit("second.1"), shouter("first.1"))
    runtime.apply(ChangeSet(started, added_transformations=library, added_targets=(SHOUT,)))
    pid = runtime.pid("shouter.1")
    shouts = observer.listen("/shout")
    assert number_of(next(shouts)) < 1_000_000
    runtime.apply(ChangeSet(rewired=(shouter("second.1"),), stopped=("first.1",)))
    after = [number for number in map(number_of, islice(shouts, 1000)) if number >= 1_000_000][:50]
    assert after == list(range(after[0], after[0] + 50))
    assert runtime.pid("shouter.1") == pid


def test_an_input_that_takes_several_streams_hears_all_of_them(runtime: Runtime, observer: Observer) -> None:
    several = replace(SHOUTER, inputs=(InputPort("quiet", "Word", count=ALL),))
    library = (talker("first", 0), talker("second", 1_000_000), several)
    feeds = tuple(Subscription("quiet", Stream(f"{one}.1", "words")) for one in ("first", "second"))
    started = (unit("first.1"), unit("second.1"), unit("shouter.1", feeds, "/shout"))
    runtime.apply(ChangeSet(started, added_transformations=library, added_targets=(SHOUT,)))
    heard = set[bool]()
    for shout in observer.listen("/shout"):
        heard.add(number_of(shout) < 1_000_000)
        if len(heard) == 2:
            break


@pytest.mark.parametrize("kind", ["std_srvs/srv/Trigger", "std_srvs/Trigger"])
def test_calls_of_a_service_go_to_the_node_that_offers_it_now(kind: str, runtime: Runtime, observer: Observer) -> None:
    told: list[str] = []
    runtime.listen(lambda event: told.append(event.line) if isinstance(event, UnitPrinted) else None)
    asker = Transformation(
        "asker",
        (InputPort("oracle", "Oracle", service=True),),
        (OutputPort("answers", "Answer"),),
        source="node:./talking.py asker",
    )
    library = (asker, oracle("first", kind), oracle("second", kind))
    asking = ComputationUnit("asker.1", "asker", (asks("first.1"),), (Publication("answers", "/answers"),))
    target = Target("answers", "Answer", "/answers")
    started = (ComputationUnit("first.1", "first"), asking)
    runtime.apply(ChangeSet(started, added_transformations=library, added_targets=(target,)))
    answers = observer.listen("/answers")
    assert "first" in islice(answers, 500)
    rewired = replace(asking, subscriptions=(asks("second.1"),))
    runtime.apply(ChangeSet((ComputationUnit("second.1", "second"),), rewired=(rewired,), stopped=("first.1",)))
    assert "second" in islice(answers, 500)
    assert [line for line in told if line.startswith("cfgplan:")] == []


def asks(provider: str) -> Subscription:
    return Subscription("oracle", Stream(provider, "ask"))


def oracle(label: str, kind: str) -> Transformation:
    ask = OutputPort("ask", "Oracle", remap="~ask", type=kind)
    return Transformation(label, (), (ask,), source="node:./talking.py oracle", params={"called": label})


def test_what_is_said_once_for_all_comes_later_too(runtime: Runtime, observer: Observer) -> None:
    """A latched message reaches late listeners, topics that are led there later, and who changes its source."""
    first, second = talker("a", 1, "mapper"), talker("b", 2, "mapper")
    target = Target("map", "Word", "/map")
    maps = (unit("a.1", (), "/map"), unit("b.1"))
    runtime.apply(ChangeSet(maps, added_transformations=(first, second), added_targets=(target,)))
    assert next(observer.listen("/map", latched=True)) == "1"
    again = Target("again", "Word", "/again")
    runtime.apply(ChangeSet(rewired=(unit("a.1", (), "/map", "/again"),), added_targets=(again,)))
    assert next(observer.listen("/again", latched=True)) == "1"
    runtime.apply(ChangeSet(rewired=(unit("b.1", (), "/map"),), stopped=("a.1",), removed_targets=("again",)))
    with observing() as late:
        assert next(late.listen("/map", latched=True)) == "2"


def heard_by(runtime: Runtime) -> Iterator[str]:
    """What cfgplan tells of units from now on."""
    heard: queue.SimpleQueue[str] = queue.SimpleQueue()
    runtime.listen(lambda event: heard.put(event.line) if isinstance(event, UnitPrinted) else None)
    return (line for line in iter(lambda: heard.get(timeout=60), None) if line.startswith("cfgplan:"))


def test_a_node_that_wants_another_message_type_is_told_of(runtime: Runtime) -> None:
    told = heard_by(runtime)
    started = (unit("clock.1"), unit("shouter.1", (Subscription("quiet", Stream("clock.1", "ticks")),)))
    runtime.apply(ChangeSet(started, added_transformations=(CLOCK, SHOUTER)))
    wanted = "shouter_1 expects std_msgs/msg/String, but the topic has geometry_msgs/msg/PointStamped"
    assert next(text for text in told if wanted in text)


def test_a_reliable_listener_hears_a_best_effort_source_and_that_is_told(runtime: Runtime, observer: Observer) -> None:
    told = heard_by(runtime)
    library = (talker("whisperer", 0, "whisperer"), SHOUTER)
    started = (unit("whisperer.1"), shouter("whisperer.1"))
    runtime.apply(ChangeSet(started, added_transformations=library, added_targets=(SHOUT,)))
    assert next(observer.listen("/shout")).endswith("!")
    assert next(text for text in told if "asks for reliable messages and is given best effort" in text)


def test_a_listener_that_asks_for_earlier_messages_hears_a_source_that_keeps_none(
    runtime: Runtime, observer: Observer
) -> None:
    told = heard_by(runtime)
    eager = replace(SHOUTER, source="node:./talking.py eager")
    started = (unit("first.1"), shouter("first.1"))
    runtime.apply(ChangeSet(started, added_transformations=(talker("first", 0), eager), added_targets=(SHOUT,)))
    assert next(observer.listen("/shout")).endswith("!")
    assert next(text for text in told if "asks for messages from before it came" in text)


def test_simulated_time_is_led_by_its_own_stamps(runtime: Runtime, observer: Observer) -> None:
    """Stamps of a clock ten times as fast, which began at 0 seconds."""
    clocks = (unit("clock.1", (), "/ticks"), unit("clock.2"))
    simulated = replace(CLOCK, params={"simulated": True})
    runtime.apply(ChangeSet(clocks, added_transformations=(simulated,), added_targets=(TICKS,)))
    ticks = observer.listen("/ticks", POINT)
    seen = [int(tick) for tick in islice(ticks, 20)]
    for number in range(10):
        old, new = ("clock.1", "clock.2") if number % 2 == 0 else ("clock.2", "clock.1")
        runtime.apply(ChangeSet(rewired=(unit(new, (), "/ticks"), unit(old))))
    seen += [int(tick) for tick in islice(ticks, 100)]
    assert seen == list(range(seen[0], seen[-1] + 1))


def test_a_node_that_somebody_else_runs_is_connected_and_never_stopped(runtime: Runtime, observer: Observer) -> None:
    command = [str(PYTHON), str(NODES), "talker", "--ros-args", "-r", "__ns:=/elsewhere"]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as somebodys:
        try:
            eventually(lambda: "/elsewhere/talker" in observer.look()["nodes"])
            words = OutputPort("words", "Word", remap="chatter")
            outside = Transformation("outside", (), (words,), source="external:/elsewhere/talker")
            absent = replace(outside, label="absent", source="external:/nobody")
            started = (unit("outside.1"), shouter("outside.1"))
            library = (outside, absent, SHOUTER)
            runtime.apply(ChangeSet(started, added_transformations=library, added_targets=(SHOUT,)))
            next(observer.listen("/shout"))
            with pytest.raises(ApplyError, match="could not start: no node /nobody is there"):
                runtime.apply(ChangeSet((unit("absent.1"),)))
            runtime.stop()
            assert somebodys.poll() is None
            runtime.apply(ChangeSet((unit("outside.1"),)))
        finally:
            somebodys.kill()
    eventually(lambda: not runtime.environment.units)
