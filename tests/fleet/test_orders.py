"""What managers and agents say to each other, without a network."""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from math import inf
from types import SimpleNamespace
from typing import Any, cast

import msgspec
import pytest
from cfgplan_runtime.children.messages import ImportUnused
from cfgplan_runtime.children.unit_order import unit_order
from cfgplan_runtime.fleet import orders
from cfgplan_runtime.fleet.agent import Agent
from cfgplan_runtime.fleet.links import Lives
from cfgplan_runtime.fleet.orders import (
    REFUSE,
    SAY,
    AskStateOrder,
    EventReport,
    FromAgent,
    GiveStateOrder,
    GreetOrder,
    Held,
    HeldUnit,
    HoldOrder,
    Order,
    OtherVersionError,
    ReliableChannel,
    Session,
    StopOrder,
    digest_of_fields,
    event_of,
    report_of,
)
from cfgplan_runtime.streams.crossing import crossing_key
from cfgplan_runtime.streams.zenoh_link import ZenohLink
from cfgplan_runtime.supervision.events import UnitDied
from small_fleet import worker

from cfgplan import __version__

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
    with pytest.raises(OtherVersionError):
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
    agent = made_agent(wire)
    agent._life = life
    agent._hear(crossing_key("manager", SAY, "r1", str(SESSION)), *said[1:])
    assert list(agent._orders) == [StopOrder("a.1")] * is_obeyed
    assert (agent._channel is not None) == is_obeyed


class SingOrder(msgspec.Struct, tag=True):
    """An order of another version."""

    unit: str


def greeting_of(version: str, fields: str = "") -> GreetOrder:
    return GreetOrder(True, b"", version, fields or digest_of_fields())


LATER = Session(2, "cdef", 1, SESSION.life)


def made_agent(wire: Wire, say: Callable[[str], None] = lambda _: None) -> Agent:
    """An agent without processes."""
    agent = Agent.__new__(Agent)
    agent.name, agent._life, agent._channel, agent._orders = "r1", SESSION.life, None, deque()
    agent._link, agent._is_left, agent._unreadable, agent._tell_user = cast("ZenohLink", wire), False, None, say
    agent._superseded, agent._held, agent._managers, agent._heard_s = {}, Held(), Lives(), inf
    return agent


class Told:
    """A backend that notes what it is asked for."""

    def __init__(self) -> None:
        self.calls: list[tuple[str, str]] = []

    def __getattr__(self, name: str) -> Callable[..., None]:
        return lambda unit, *_: self.calls.append((name, unit))


def test_an_agent_undoes_the_hand_overs_that_a_silent_manager_has_left_and_none_of_one_that_is_heard(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    clock = SimpleNamespace(now_s=0.0)
    monkeypatch.setattr("time.monotonic", lambda: clock.now_s)
    agent = made_agent(Wire())
    backend = agent._backend = cast("Any", Told())
    order = unit_order("a.1", worker(), None)
    agent._held.units = {name: HeldUnit("a", order) for name in ("old.1", "new.1", "done.1", "ending.1", "other.1")}
    agent._stopping = {}
    handed: list[Order] = [
        HoldOrder("new.1"),
        AskStateOrder("old.1", {}, "new.1"),
        AskStateOrder("ending.1", {}, "done.1"),
        GiveStateOrder("done.1", None, {}, {}),
        StopOrder("ending.1"),
    ]
    say_all(agent, SESSION, handed)
    while agent._orders:
        agent._obey(agent._orders.popleft())
    backend.calls.clear()
    clock.now_s = 4.0
    say_all(agent, SESSION, [StopOrder("other.1")])
    agent._undo_handovers(8.9)
    assert backend.calls == []
    agent._undo_handovers(9.0)
    agent._undo_handovers(30.0)
    assert backend.calls == [("give_state", "old.1"), ("kill", "new.1")]


def say_all(agent: Agent, session: Session, *batches: list[msgspec.Struct]) -> None:
    """Let a manager give orders in batches, in a session."""
    talk = said_in_turn(agent, session, *batches)
    for _ in talk:
        pass


def said_in_turn(agent: Agent, session: Session, *batches: list[msgspec.Struct]) -> Iterator[None]:
    """Let a manager give one batch of orders after the other, in a session."""
    wire = Wire()
    manager: ReliableChannel[Any] = ReliableChannel(cast("ZenohLink", wire), "manager", "r1", session, FromAgent)
    for batch in batches:
        for order in batch:
            manager.say(order)
        manager.pump(0.0)
        for kind, head, payload in wire.put:
            agent._hear(crossing_key("manager", kind, "r1", str(session)), head, payload)
        wire.put.clear()
        yield


def test_an_agent_refuses_all_orders_that_come_with_one_that_it_can_not_read_and_says_so_again() -> None:
    wire, said = Wire(), list[str]()
    agent = made_agent(wire, said.append)
    greeting: list[msgspec.Struct] = [greeting_of("9.9.9")]
    say_all(agent, SESSION, greeting, [StopOrder("a.1"), SingOrder("a.1"), StopOrder("b.1")], [StopOrder("c.1")])
    assert list(agent._orders) == []
    assert agent._channel is None, "another manager may take over"
    refusals = [payload.decode() for kind, _, payload in wire.put if kind == REFUSE]
    assert len(refusals) > 1 and set(refusals) == {refusals[0]}
    assert refusals[0].startswith(f"version {__version__} ") and "SingOrder" in refusals[0]
    (told,) = said
    assert all(word in told for word in ("9.9.9", f"this agent has cfgplan {__version__}", "install the same version"))


def test_an_agent_refuses_a_manager_whose_messages_have_other_fields_before_it_obeys_any_order() -> None:
    wire, said = Wire(), list[str]()
    agent = made_agent(wire, said.append)
    say_all(agent, SESSION, [greeting_of(__version__, "0123456789abcdef"), StopOrder("a.1")])
    assert list(agent._orders) == []
    assert agent._channel is None
    (refusal,) = {payload.decode() for kind, _, payload in wire.put if kind == REFUSE}
    assert refusal == f"version {__version__} their messages differ"
    (told,) = said
    assert f"this agent has cfgplan {__version__}" in told and "install the same version" in told


def test_a_field_more_or_of_another_type_is_noticed_and_another_docstring_is_not(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def digest_with(**fields: object) -> str:
        order = msgspec.defstruct("StopOrder", list(fields.items()), tag=True, namespace={"__doc__": doc})
        monkeypatch.setattr(orders, "Order", order)
        return digest_of_fields.__wrapped__()

    doc = "Stop a unit."
    known = digest_with(unit=str)
    assert len({known, digest_with(unit=str, after=str), digest_with(unit=bytes)}) == 3
    doc = "End a unit."
    assert digest_with(unit=str) == known


def test_versions_of_msgspec_that_order_and_describe_types_in_other_ways_have_the_same_digest(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """0.20 lists None before the other types of a field, 0.23 after them."""
    known, schema = digest_of_fields(), msgspec.json.schema_components

    def other_schema(types: Iterable[Any]) -> tuple[object, object]:
        return schema(types)[0], json.loads(json.dumps(schema(types)[1]), object_hook=reversed_types)

    def reversed_types(read: dict[str, Any]) -> dict[str, Any]:
        return {key: value[::-1] if key == "anyOf" else value for key, value in read.items()}

    monkeypatch.setattr(msgspec.json, "schema_components", other_schema)
    assert digest_of_fields.__wrapped__() == known
    monkeypatch.setattr(orders, "Order", StopOrder | Held | GreetOrder)
    order_of = digest_of_fields.__wrapped__()
    monkeypatch.setattr(orders, "Order", GreetOrder | StopOrder | Held)
    assert digest_of_fields.__wrapped__() == order_of


def test_an_agent_stays_with_its_manager_if_it_can_not_read_the_orders_of_a_later_one() -> None:
    agent = made_agent(Wire())
    say_all(agent, SESSION, [greeting_of(__version__)])
    channel = agent._channel
    say_all(agent, LATER, [SingOrder("a.1")])
    assert agent._channel is channel is not None
    assert (agent._superseded, agent._held.term) == ({}, 0)
    assert agent._orders.popleft() == greeting_of(__version__)
    later = LATER._replace(greeting=2)
    say_all(agent, later, [greeting_of(__version__)])
    assert agent._channel is not None and agent._channel.session == later


def test_a_manager_is_to_greet_again_if_the_later_one_that_took_over_gives_an_order_that_can_not_be_read() -> None:
    wire = Wire()
    agent = made_agent(wire)
    greeting: list[msgspec.Struct] = [greeting_of(__version__)]
    earlier = said_in_turn(agent, SESSION, greeting, [StopOrder("a.1")])
    next(earlier)
    say_all(agent, LATER, [greeting_of("9.9.9")], [SingOrder("a.1")])
    wire.put.clear()
    next(earlier)
    assert [payload.decode() for kind, _, payload in wire.put if kind == REFUSE] == [f"{LATER.term} 0"]
    assert agent._channel is None, "the session can't go on in the middle"
    again = SESSION._replace(term=LATER.term + 1, greeting=2)
    say_all(agent, again, greeting, [StopOrder("a.1")])
    assert agent._channel is not None and agent._channel.session == again
    assert list(agent._orders) == [*greeting, StopOrder("a.1")]
