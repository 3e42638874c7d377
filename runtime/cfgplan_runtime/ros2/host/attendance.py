"""Reports nodes that are ready or gone: a starting node's ports have matched, or another one's have vanished."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import Any

from cfgplan_runtime.ros2.host.actions import SEND_GOAL
from cfgplan_runtime.ros2.host.endpoints import Publication, Source, UnknownTypeError, message_class
from cfgplan_runtime.ros2.host.host import Host
from cfgplan_runtime.ros2.host.lifecycle import ACTIVE, INACTIVE, Lifecycle
from cfgplan_runtime.ros2.host.relays import SIGN_S, Relays

_LOOK_S = 0.05
"""Seconds between two looks for ports that no event tells of."""
_PORTS_S, _CONFIGURED_PORTS_S = 2.0, 0.5
"""Seconds after its first sign after which a node is ready, whatever ports it does not have yet; those of a lifecycle
node that is configured, which may make some when it is activated.
"""
_LATE_S = 10.0
"""Seconds after it is ready after which it is told which outputs a node still lacks, and who else has its name."""
_IDLE_S = 3.0
"""Seconds after it is ready for which a node is listened to, even if nothing is led from there."""
_FOREIGN_S = 4.0
"""Seconds that the graph takes to tell of the nodes of others."""
_MOST_MISSED = 2
_GHOST_S = 4.0
"""Seconds for which the graph may have the name of a node that has died: its lease is 3 s by the run's own profile."""
_CLOCK = "/clock"


@dataclass(eq=False)
class AttendedNode:
    """A unit's node, or a cold spare that `waits`. `gids` are its endpoints, by the last look.

    It `is_ready` once it has been reported for its `goal`, the state that it is led to if it has a lifecycle.
    """

    unit: str
    name: str
    inputs: list[dict[str, Any]]
    outputs: list[dict[str, Any]]
    is_foreign: bool
    has_clock: bool
    begun_s: float
    sources: list[Source] = field(default_factory=list)
    publications: list[Publication] = field(default_factory=list)
    gids: set[tuple[int, ...]] = field(default_factory=set)
    waits: bool = False
    is_watched: bool = False
    life: Lifecycle | None = None
    goal: int = INACTIVE
    is_attended: bool = False
    """Whether it was reported to have appeared."""
    seen_s: float | None = None
    """When there was a first sign of it."""
    is_ready: bool = False
    missed: int = 0
    client: Any = None
    is_asked: bool = False


class Attendance:
    """All nodes of a run that run or start."""

    def __init__(self, host: Host, relays: Relays) -> None:
        self._host, self._relays = host, relays
        self._begun_s = time.monotonic()
        self._nodes: dict[str, AttendedNode] = {}
        self._is_looking = False
        self._dead: set[tuple[int, ...]] = set()
        """Endpoints of nodes that have died: the graph has them for a while."""
        self._ghosts: dict[str, float] = {}
        """By names of nodes that have died: until when they may still be in the graph by the run's own profile."""
        self._timeless: set[str] = set()
        """The names of nodes that were reported to go by no simulated time."""
        self._forget_wires = host.handlers["CloseInlets"]
        host.handlers.update(
            Attend=self._attend, CloseInlets=self._forget, Begin=self._begin, ChangeState=self._change_state
        )
        host.on_match = self._look
        host.waiting.later(SIGN_S, self._sign)

    def _attend(self, order: dict[str, Any]) -> None:
        inputs, outputs = order["inputs"], order["outputs"]
        has_clock = order["has_clock"] or order["is_foreign"]
        node = AttendedNode(
            order["unit"], order["node"], inputs, outputs, order["is_foreign"], has_clock, time.monotonic()
        )
        node.waits, node.is_watched = order["waits"], order["is_watched"] or order["is_foreign"]
        node.goal = ACTIVE if order["is_active"] else INACTIVE
        self._nodes[node.unit] = node
        if not node.is_foreign:
            for port in (one for one in outputs if _is_topic(one)):
                topic = node.unit, port["topic"], port["key"], port["message"]
                node.sources.append(self._relays.hold_source(*topic))
                if port["outside"] is not None:
                    self._relays.outside.add(*topic, port["outside"])
            for port in inputs:
                held = self._relays.hold_publication(
                    node.unit, port["topic"], port["key"], port["message"], order["queue"]
                )
                node.publications.append(held)
        if order["asks"]:
            self._make_client(node)
        self._look_again()

    def _begin(self, order: dict[str, Any]) -> None:
        """Let a cold spare be a unit."""
        node = self._nodes.pop(order["spare"], None)
        if node is not None:
            self._relays.rename_holder(node.unit, order["unit"])
            node.unit, node.waits = order["unit"], False
            node.is_ready = False
            self._nodes[node.unit] = node
            self._look()

    def _change_state(self, order: dict[str, Any]) -> None:
        """Activate or deactivate a lifecycle node, as soon as its lifecycle is found."""
        node = self._nodes.get(order["unit"])
        if node is not None:
            node.goal = ACTIVE if order["is_active"] else INACTIVE
            if node.life is not None:
                node.is_ready = False
                self._look()

    def _forget(self, order: dict[str, Any]) -> None:
        node = self._nodes.pop(order["unit"], None)
        if node is not None:
            self._dead |= node.gids
            if not node.is_foreign:
                self._ghosts[node.name] = time.monotonic() + _GHOST_S
            if node.client is not None:
                self._host.waiting.unwatch("client", node.client.handle)
                self._host.node.destroy_client(node.client)
            if node.life is not None:
                node.life.close()
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
            self._relays.outside.look()
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
        if node.seen_s is None and (node.gids or self._has_name(node)):
            node.seen_s = time.monotonic()
        if node.seen_s is None:
            return
        self._find_life(node)
        is_configured = node.life is not None and node.goal == INACTIVE
        is_late = time.monotonic() - node.seen_s > (_CONFIGURED_PORTS_S if is_configured else _PORTS_S)
        if node.life is not None:
            if not self._has_come(node, node.life):
                return
        elif node.waits:
            if is_late:
                self._fail(node, "is not a lifecycle node: remove `lifecycle`")
            return
        if not missing or is_late:
            self._note_ready(node)

    def _find_life(self, node: AttendedNode) -> None:
        """Find out whether a node has a lifecycle."""
        if node.life is None and f"{node.name}/change_state" in self._services():
            node.life = Lifecycle(self._host, node.name, lambda: self._note_state(node))

    def _find_late_life(self, node: AttendedNode) -> None:
        """Lead a node that was taken for one without a lifecycle: a busy computer makes the node and then its services,
        and a node that lacks ports is not waited for.
        """
        if node.is_ready and node.life is None:
            self._find_life(node)
            if node.life is not None:
                node.is_ready = node.is_attended = False
                self._look()

    def _has_come(self, node: AttendedNode, life: Lifecycle) -> bool:
        """Lead a lifecycle node to its goal. Returns whether it has reached it, and must have its ports now.

        If the goal was changed during a step, the node is led back once the step is done. A node that has activated
        itself is deactivated only if it was reported before.
        """
        if life.cause:
            self._fail(node, life.cause)
        elif life.is_changing:
            return False
        elif life.state != node.goal and (life.state != ACTIVE or node.is_attended):
            life.go(node.goal)
        elif node.waits:
            node.is_ready = True
            self._host.say("Configured", unit=node.unit)
        elif node.is_attended and node.goal == INACTIVE:
            node.is_ready = True
            self._host.say("StateChanged", unit=node.unit, is_active=False)
        else:
            return True
        return False

    def _note_state(self, node: AttendedNode) -> None:
        if self._nodes.get(node.unit) is node:
            node.seen_s = time.monotonic()  # it may make its ports only now
            self._look()

    def _fail(self, node: AttendedNode, cause: str) -> None:
        node.is_ready = True
        self._host.say("Failed", unit=node.unit, cause=f"{node.name} {cause}")

    def _services(self) -> set[str]:
        return {name for name, _ in self._host.node.get_service_names_and_types()}

    def _has_name(self, node: AttendedNode) -> bool:
        """Whether the graph has a node of this name that is not one that has died."""
        return self._namesakes(node.name) > (time.monotonic() < self._ghosts.get(node.name, 0.0))

    def _missing(self, node: AttendedNode) -> list[str]:
        """The topics of ports that the node does not have yet, or that have not matched. Its `gids` are found too."""
        services: set[str] | None = None
        found = []
        for port in node.outputs:
            topic = port["topic"]
            if self._news(node, self._host.node.get_publishers_info_by_topic(topic)):
                continue
            if services is None:
                services = self._services()
            if services.isdisjoint((topic, topic + SEND_GOAL)):
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
        """Whether one of the endpoints on its topics is the node's: all are, but for the helper's and the dead's."""
        own = {tuple(end.endpoint_gid) for end in ends if not self._host.is_own(end)} - self._dead
        node.gids |= own
        return bool(own)

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
        if not node.is_attended:
            node.is_attended = True
            self._host.say("Attended", unit=node.unit, has_life=node.life is not None)
        if node.life is not None and node.goal == ACTIVE:
            self._host.say("StateChanged", unit=node.unit, is_active=True)
        if node.life is None or node.goal == ACTIVE:
            self._host.waiting.later(_IDLE_S, lambda: self._let_go(node))
            if not node.is_foreign:
                self._host.waiting.later(_LATE_S, lambda: self._tell_late(node))

    def _let_go(self, node: AttendedNode) -> None:
        if self._nodes.get(node.unit) is node:
            for source in node.sources:
                self._relays.let_go(node.unit, source.topic)

    def _tell_late(self, node: AttendedNode) -> None:
        """Report what a node should have by now: each output, a clock, and a name that no other node of its process
        has.
        """
        if self._nodes.get(node.unit) is not node:
            return
        if not node.has_clock and node.name not in self._timeless and self._host.node.count_publishers(_CLOCK):
            self._timeless.add(node.name)
            text = f"{_CLOCK} is published: {node.name} goes by it only with `params: {{use_sim_time: true}}`"
            self._host.say("Told", unit=node.unit, text=f"{text} (write false to be told no more)")
        number = self._namesakes(node.name)
        if number > 1 and node.name not in self._ghosts:
            mend = "end the other one, or name it in `source`: `--ros-args -r OWN_NAME:__node:=OTHER_NAME --`"
            self._host.say("Told", unit=node.unit, text=f"{number} nodes are called {node.name}: {mend}")
        missing = sorted(set(self._missing(node)) & {port["topic"] for port in node.outputs})
        if missing:
            text = f"{node.name} does not publish {', '.join(missing)}: what is it called in its code (`remap`)?"
            self._host.say("Told", unit=node.unit, text=text)

    # Whether nodes still are there.

    def _sign(self) -> None:
        self._host.waiting.later(SIGN_S, self._sign)
        for node in list(self._nodes.values()):
            if not node.is_foreign and len(node.gids) < len(node.inputs) + len(node.outputs):
                self._missing(node)
                self._find_late_life(node)
            if node.is_watched and node.is_ready:
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


def _is_topic(port: dict[str, Any]) -> bool:
    """Whether a port may be a topic: its type, if the file says it, is not that of a service or an action."""
    return port["message"] is None or "/msg/" in port["message"]
