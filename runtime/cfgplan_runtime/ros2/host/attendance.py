"""Tells when nodes are there: when the ports of those that start have matched, and when those of others have gone."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import Any

from cfgplan_runtime.ros2.host.endpoints import Publication, Source, UnknownTypeError, message_class
from cfgplan_runtime.ros2.host.host import Host
from cfgplan_runtime.ros2.host.relays import SIGN_S, Relays

_LOOK_S = 0.05
"""Seconds between two looks for ports that no event tells of."""
_PORTS_S = 2.0
"""Seconds after its first sign after which a node is ready, whatever ports it does not have yet."""
_LATE_S = 10.0
"""Seconds after it is ready after which it is told which outputs a node still does not have."""
_IDLE_S = 3.0
"""Seconds after it is ready for which a node is listened to, even if nothing is led from there."""
_FOREIGN_S = 4.0
"""Seconds that the graph takes to tell of the nodes of others."""
_MOST_MISSED = 2
_CLOCK, _SIM_TIME = "/clock", "use_sim_time"


@dataclass(eq=False)
class AttendedNode:
    """A unit's node. `known` are the endpoints on its topics that were there before it: those of one that has died."""

    unit: str
    name: str
    inputs: list[dict[str, Any]]
    outputs: list[dict[str, Any]]
    is_foreign: bool
    begun_s: float
    sources: list[Source] = field(default_factory=list)
    publications: list[Publication] = field(default_factory=list)
    known: set[tuple[int, ...]] = field(default_factory=set)
    namesakes: int = 0
    seen_s: float | None = None
    """When there was a first sign of it."""
    is_ready: bool = False
    missed: int = 0
    client: Any = None
    is_asked: bool = False


class Attendance:
    """All nodes of a run that are there or starting."""

    def __init__(self, host: Host, relays: Relays) -> None:
        self._host, self._relays = host, relays
        self._begun_s = time.monotonic()
        self._nodes: dict[str, AttendedNode] = {}
        self._is_looking = False
        self._forget_wires = host.handlers["CloseInlets"]
        host.handlers.update(Attend=self._attend, CloseInlets=self._forget)
        host.on_match = self._look
        host.waiting.later(SIGN_S, self._sign)

    def _attend(self, order: dict[str, Any]) -> None:
        inputs, outputs = order["inputs"], order["outputs"]
        node = AttendedNode(order["unit"], order["node"], inputs, outputs, order["is_foreign"], time.monotonic())
        self._nodes[node.unit] = node
        if not node.is_foreign:
            if order["is_again"]:
                node.namesakes = self._namesakes(node.name)
                ends = [end for port in (*inputs, *outputs) for end in self._ends(port["topic"])]
                node.known = {tuple(end.endpoint_gid) for end in ends}
            for port in outputs:
                node.sources.append(self._relays.hold_source(node.unit, port["topic"], port["key"], port["message"]))
            for port in inputs:
                held = self._relays.hold_publication(
                    node.unit, port["topic"], port["key"], port["message"], order["queue"]
                )
                node.publications.append(held)
        if order["asks"]:
            self._make_client(node)
        self._look_again()

    def _forget(self, order: dict[str, Any]) -> None:
        node = self._nodes.pop(order["unit"], None)
        if node is not None and node.client is not None:
            self._host.waiting.unwatch("client", node.client.handle)
            self._host.node.destroy_client(node.client)
        self._forget_wires(order)

    def _look_again(self) -> None:
        if not self._is_looking:
            self._is_looking = True
            self._host.waiting.later(_LOOK_S, self._look_on)

    def _look_on(self) -> None:
        self._is_looking = False
        self._look()

    def _look(self) -> None:
        starting = [node for node in self._nodes.values() if not node.is_ready]
        if not starting:
            return
        self._relays.look()
        for node in starting:
            if node.is_foreign:
                self._look_for_foreign(node)
            else:
                self._look_at(node)
        if any(not node.is_ready for node in self._nodes.values()):
            self._look_again()

    def _look_at(self, node: AttendedNode) -> None:
        missing = self._missing(node)
        if node.seen_s is None and (
            len(missing) < len(node.inputs) + len(node.outputs) or self._namesakes(node.name) > node.namesakes
        ):
            node.seen_s = time.monotonic()
        if node.seen_s is not None and (not missing or time.monotonic() - node.seen_s > _PORTS_S):
            self._note_ready(node)

    def _missing(self, node: AttendedNode) -> list[str]:
        """The topics of ports that the node does not have yet, or that have not matched."""
        services: set[str] | None = None
        found = []
        for port in node.outputs:
            topic = port["topic"]
            if self._news(node, self._host.node.get_publishers_info_by_topic(topic)):
                continue
            if services is None:
                services = {name for name, _ in self._host.node.get_service_names_and_types()}
            if topic not in services:
                found.append(topic)
        matches = {publication.topic: publication.matches() for publication in node.publications}
        for port in node.inputs:
            topic = port["topic"]
            ends = self._host.node.get_subscriptions_info_by_topic(topic)
            is_matched = not matches.get(topic) or matches[topic] >= len(ends)
            if not self._news(node, ends) or not is_matched:
                found.append(topic)
        return found

    def _news(self, node: AttendedNode, ends: list[Any]) -> bool:
        return any(tuple(end.endpoint_gid) not in node.known and not self._host.is_own(end) for end in ends)

    def _ends(self, topic: str) -> list[Any]:
        of = self._host.node
        return [*of.get_publishers_info_by_topic(topic), *of.get_subscriptions_info_by_topic(topic)]

    def _namesakes(self, name: str) -> int:
        """How many nodes of a full name the graph has: one that has died stays in it for a while."""
        found = self._host.node.get_node_names_and_namespaces()
        return sum(f"{namespace.rstrip('/')}/{own}" == name for own, namespace in found)

    def _look_for_foreign(self, node: AttendedNode) -> None:
        if self._namesakes(node.name):
            self._note_ready(node)
        elif time.monotonic() - max(node.begun_s, self._begun_s) > _FOREIGN_S:
            self._host.say("Gone", unit=node.unit)
            del self._nodes[node.unit]

    def _note_ready(self, node: AttendedNode) -> None:
        node.is_ready = True
        self._host.say("Attended", unit=node.unit)
        self._host.waiting.later(_IDLE_S, lambda: self._let_go(node))
        if node.outputs and not node.is_foreign:
            self._host.waiting.later(_LATE_S, lambda: self._tell_missing(node))

    def _let_go(self, node: AttendedNode) -> None:
        if self._nodes.get(node.unit) is node:
            for source in node.sources:
                self._relays.let_go(node.unit, source.topic)

    def _tell_missing(self, node: AttendedNode) -> None:
        if self._nodes.get(node.unit) is not node:
            return
        missing = sorted(set(self._missing(node)) & {port["topic"] for port in node.outputs})
        if missing:
            text = f"{node.name} does not publish {', '.join(missing)}: what is it called in its code (`remap`)?"
            self._host.say("Told", unit=node.unit, text=text)

    # Whether nodes still are there.

    def _sign(self) -> None:
        self._host.waiting.later(SIGN_S, self._sign)
        for node in list(self._nodes.values()):
            if node.is_foreign and node.is_ready:
                node.missed = 0 if self._namesakes(node.name) else node.missed + 1
                if node.missed == _MOST_MISSED:
                    self._host.say("Gone", unit=node.unit)
                    del self._nodes[node.unit]
            elif node.client is not None and not node.is_asked and node.client.service_is_ready():
                node.is_asked = True
                node.client.handle.send_request(node.client.srv_type.Request())

    def _make_client(self, node: AttendedNode) -> None:
        """A client of the service that answers about parameters, which almost every node has."""
        try:
            kind = message_class("rcl_interfaces/srv/GetParameters")
        except UnknownTypeError:
            return
        node.client = self._host.node.create_client(kind, f"{node.name}/get_parameters")
        self._host.waiting.watch("client", node.client.handle, lambda: self._hear_answer(node))

    def _hear_answer(self, node: AttendedNode) -> None:
        header, _ = node.client.handle.take_response(node.client.srv_type.Response)
        if header is not None:
            node.is_asked = False
            self._host.say("Answered", unit=node.unit)
