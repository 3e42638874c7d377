"""Topic and service names that wire nodes as a configuration says, and the relays needed for that.

A node is remapped once, when it starts: each of its ports has one name. An output has the topic of its target, or one
of its own; an input has the name of the output that feeds it. Outputs that feed the same inputs, and no others, share a
name. If an input needs streams under several names, relays copy them to its topic.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

from cfgplan.domain import ComputationUnit, Environment, Stream
from cfgplan.errors import Fault, InputError
from cfgplan.ros.graph import resolved
from cfgplan.ros.sources import NodeSource
from cfgplan.ros.types import MessageType
from cfgplan.transformations import InputPort, OutputPort, Transformation


class PortEnd(NamedTuple):
    """A port of a unit."""

    unit: str
    port: str
    gives: bool


ACTION_PARTS = tuple(f"/_action/{part}" for part in ("send_goal", "cancel_goal", "get_result", "feedback", "status"))
"""The endings of the names of an action's services and topics."""


def remapped(own: str, name: str, kind: str | None) -> Mapping[str, str]:
    """The remappings by which a port's `own` name becomes another one. `kind` is its type, if the file says it.

    An action has those of its services and topics too: before Kilted, rcl knows no remapping of actions.
    """
    is_action = kind is not None and MessageType.read(kind).kind == "action"
    return {f"{own}{part}": f"{name}{part}" for part in ("", *(ACTION_PARTS if is_action else ()))}


class LaunchRelay(NamedTuple):
    """A relay: copies messages from one topic to another."""

    source: str
    target: str


@dataclass(frozen=True)
class NodeUnit:
    """A unit that is a ROS node; `name` is the full name of the node."""

    unit: ComputationUnit
    transformation: Transformation
    source: NodeSource
    name: str

    @property
    def is_foreign(self) -> bool:
        """Return whether the node is started outside of cfgplan, so that it can't be remapped."""
        return self.source.kind == "external"

    def own_name(self, end: PortEnd) -> str:
        """Return the node's own name of a port."""
        port = self.port(end)
        return port.remap or port.name

    def port(self, end: PortEnd) -> InputPort | OutputPort:
        """The port of one of its ends."""
        return self.transformation.output[end.port] if end.gives else self.transformation.input[end.port]

    @property
    def ends(self) -> Iterator[PortEnd]:
        """Its ports, inputs first."""
        yield from (PortEnd(self.unit.id, port, gives=False) for port in self.transformation.input)
        yield from (PortEnd(self.unit.id, port, gives=True) for port in self.transformation.output)


class TopicNames:
    """The names of all ends of an environment's running units. Raises InputError for units that are no nodes."""

    def __init__(self, environment: Environment) -> None:
        self._units = {each.unit.id: each for each in node_units(environment)}
        self.name = dict(self._names_of_outputs())
        self.relays = tuple(sorted(self._wire_inputs()))

    @property
    def units(self) -> tuple[NodeUnit, ...]:
        """The units, by id."""
        return tuple(self._units[unit] for unit in sorted(self._units))

    def remappings(self, node: NodeUnit) -> list[tuple[str, str]]:
        """Return pairs of a node's own name and the remapped name. Raises InputError if one own name needs
        two topics.
        """
        found: dict[str, str] = {}
        for end in node.ends:
            own = re.sub("^~/?", "~/", node.own_name(end))
            if found.get(own, self.name[end]) != self.name[end]:
                what = f"{node.unit.id}: two ports are {own!r} to the node, which can't be led to two topics"
                raise InputError.of(what, mend="leave one of them out of the file")
            found |= remapped(own, self.name[end], node.port(end).type)
        return sorted(found.items())

    @cached_property
    def _feeds(self) -> Mapping[PortEnd, frozenset[PortEnd]]:
        """The outputs that feed each input."""
        return {
            end: frozenset(map(_provider, each.unit.feeds.get(end.port, ())))
            for each in self._units.values()
            for end in each.ends
            if not end.gives
        }

    @cached_property
    def _topics(self) -> Mapping[PortEnd, list[str]]:
        """The topics of targets that each output is published on."""
        found: dict[PortEnd, list[str]] = defaultdict(list)
        for each in self._units.values():
            for published in each.unit.publications:
                found[PortEnd(each.unit.id, published.port, gives=True)].append(_absolute(published.topic))
        return found

    def _names_of_outputs(self) -> Iterator[tuple[PortEnd, str]]:
        outputs = [end for each in self._units.values() for end in each.ends if end.gives]
        shared = self._shared(outputs)
        for end in outputs:
            if self._units[end.unit].is_foreign:
                yield end, self._fixed(end)
            elif self._topics[end]:
                yield end, self._topics[end][0]
            else:
                yield end, self._new(shared.get(end, end))

    def _shared(self, outputs: Iterable[PortEnd]) -> Mapping[PortEnd, PortEnd]:
        """By each output that shares its name with others: whose name that is."""
        heard_with: dict[PortEnd, set[frozenset[PortEnd]]] = defaultdict(set)
        for feeds in self._feeds.values():
            for end in feeds:
                heard_with[end].add(feeds)

        def may_share(end: PortEnd) -> bool:
            return not self._units[end.unit].is_foreign and not self._topics[end] and len(heard_with[end]) == 1

        groups = ((end, next(iter(heard_with[end]))) for end in outputs if may_share(end))
        return {end: min(group) for end, group in groups if all(map(may_share, group))}

    def _wire_inputs(self) -> Iterator[LaunchRelay]:
        """Name the inputs, and yield the relays."""
        of_feeds: dict[frozenset[PortEnd], str] = {}
        for end, feeds in self._feeds.items():
            sources = {self.name[provider] for provider in feeds}
            if self._units[end.unit].is_foreign:
                name = self._fixed(end)
            elif len(sources) == 1:
                name = next(iter(sources))
            else:
                name = of_feeds.setdefault(feeds, self._new(end))
            self.name[end] = name
            if sources - {name}:
                self._refuse_services(end)
            yield from (LaunchRelay(source, name) for source in sources - {name})
        for end, topics in self._topics.items():
            yield from (LaunchRelay(self.name[end], topic) for topic in topics if topic != self.name[end])

    def _refuse_services(self, end: PortEnd) -> None:
        port = self._units[end.unit].port(end)
        if isinstance(port, InputPort) and port.service:
            what = f"{end.unit} calls its service {port.name} by a name that can't be that of who serves it"
            raise InputError.of(what, mend="services have no relays: let nodes that are external call by the same name")

    def _fixed(self, end: PortEnd) -> str:
        node = self._units[end.unit]
        return resolved(node.own_name(end), node.name.rpartition("/")[0], node.name)

    def _new(self, end: PortEnd) -> str:
        return f"{self._units[end.unit].name}/{'out' if end.gives else 'in'}/{word(end.port)}"


def node_units(environment: Environment) -> Iterator[NodeUnit]:
    """The running units as nodes. Raises InputError with all units that can't be nodes of ROS 2."""
    faults, taken = list[Fault](), dict[str, str]()
    for unit in sorted(environment.units, key=lambda unit: unit.id):
        if unit.standby:
            continue
        transformation = environment.transformation[unit.transformation]
        try:
            source = NodeSource.read(transformation.source)
            if source is None or source.kind == "nodelet":
                mend = "write node:PACKAGE/EXECUTABLE, node:./FILE, component:PACKAGE/PLUGIN or external:/NAME"
                said = transformation.source
                what = f"`{said}` is not a node of ROS 2" if said else f"{transformation.label} has no `source`"
                raise InputError.of(f"{unit.id}: {what}", mend=mend)
            name = source.name if source.kind == "external" else f"/{word(unit.id)}"
            if name in taken:
                mend = "give one of their transformations another label"
                raise InputError.of(f"{unit.id} and {taken[name]} would both be the node {name}", mend=mend)
            taken[name] = unit.id
            yield NodeUnit(unit, transformation, source, name)
        except InputError as error:
            faults += error.faults
    if faults:
        raise InputError(faults)


def word(text: str) -> str:
    """A text as ROS allows it in names: letters, digits and single underscores, no digit first."""
    found = re.sub(r"_+", "_", re.sub(r"\W", "_", text, flags=re.ASCII)).strip("_")
    return found if found[:1].isalpha() else f"n{found}"


def _provider(stream: Stream) -> PortEnd:
    return PortEnd(stream.unit, stream.port, gives=True)


def _absolute(topic: str) -> str:
    return f"/{topic.removeprefix('/')}"
