"""What managers and agents say to each other, without a network."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any, cast

import msgspec
import pytest
from cfgplan_runtime.children.messages import ImportUnused
from cfgplan_runtime.fleet.agent import Agent
from cfgplan_runtime.fleet.orders import (
    SAY,
    EventReport,
    FromAgent,
    Order,
    ReliableChannel,
    Session,
    StopOrder,
    event_of,
    report_of,
)
from cfgplan_runtime.streams.crossing import crossing_key
from cfgplan_runtime.streams.zenoh_link import ZenohLink
from cfgplan_runtime.supervision.events import UnitDied

SESSION = Session(1, "abcd", 1, "beef")


class Wire:
    """A link that keeps what is put."""

    def __init__(self) -> None:
        self.put: list[tuple[str, bytes, bytes]] = []

    def publisher(self, key: str, _lane: str) -> Callable[[bytes, bytes], None]:
        return lambda head, payload: self.put.append((key.split("/")[2], head, payload))


def channel(wire: Wire, me: str, other: str, incoming: object) -> ReliableChannel[Any]:
    return ReliableChannel(cast("ZenohLink", wire), me, other, SESSION, incoming)


def test_orders_that_are_repeated_are_carried_out_once_and_in_order() -> None:
    wire = Wire()
    manager, agent = channel(wire, "manager", "r1", FromAgent), channel(Wire(), "r1", "manager", Order)
    manager.say(StopOrder("a.1"))
    manager.say(StopOrder("b.1"))
    manager.pump(0.0)
    (said,) = (put for put in wire.put if put[0] == "say")
    assert agent.hear(*said, 0.0) == [StopOrder("a.1"), StopOrder("b.1")]
    assert agent.hear(*said, 0.1) == []


def test_a_message_of_another_version_is_no_traceback_but_an_error() -> None:
    wire = Wire()
    manager, agent = channel(Wire(), "manager", "r1", Order), channel(wire, "r1", "manager", Order)
    agent.say(ImportUnused("of an agent", 1))
    agent.pump(0.0)
    with pytest.raises(msgspec.MsgspecError):
        manager.hear(*wire.put[0], 0.0)
    with pytest.raises(msgspec.MsgspecError):
        event_of(EventReport("UnitSang", msgspec.Raw(b"")))


def test_an_event_is_read_as_it_was_told() -> None:
    died = UnitDied("a.1", "killed by SIGKILL")
    sent = msgspec.msgpack.decode(msgspec.msgpack.encode(report_of(died)), type=EventReport)
    assert event_of(sent) == died


@pytest.mark.parametrize(("life", "is_obeyed"), [(SESSION.life, True), ("cafe", False)])
def test_of_two_agents_of_one_name_only_the_one_that_was_greeted_obeys(life: str, is_obeyed: bool) -> None:
    """Both get what the manager says, and could answer in each other's place."""
    wire = Wire()
    manager = channel(wire, "manager", "r1", FromAgent)
    manager.say(StopOrder("a.1"))
    manager.pump(0.0)
    (said,) = (put for put in wire.put if put[0] == SAY)
    agent = Agent.__new__(Agent)
    agent.name, agent._life, agent._channel, agent._orders = "r1", life, None, deque()
    agent._link, agent._is_left = cast("ZenohLink", wire), False
    agent._hear(crossing_key("manager", SAY, "r1", str(SESSION)), *said[1:])
    assert list(agent._orders) == [StopOrder("a.1")] * is_obeyed
    assert (agent._channel is not None) == is_obeyed
