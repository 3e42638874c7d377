"""From a graph of ROS nodes to an environment: its file, its ontology, and the guesses made for them."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from functools import cached_property
from typing import NamedTuple

import networkx

from cfgplan.domain import (
    ALL,
    ComputationUnit,
    Environment,
    Host,
    InputPort,
    OutputPort,
    RunOptions,
    Stream,
    Subscription,
    Target,
    Transformation,
)
from cfgplan.formats.imported import imported_text
from cfgplan.qualities import MICRO
from cfgplan.ros.code.package_sources import SourcePorts, ports_of_sources
from cfgplan.ros.graph import RosGraph, RosNode, RosPort
from cfgplan.ros.guesses import GuessTable
from cfgplan.ros.sources import REMAPS, NodeKind, NodeSource
from cfgplan.ros.types import MessageType
from cfgplan.ros.vocabulary import RosVocabulary
from cfgplan.summary import counted, some

LOCAL = "local"
"""The host of nodes that run where the launch file is started, as roslaunch calls it."""
_APART: tuple[Callable[[RosPort], str], ...] = (
    lambda port: ".out" if port.role.gives else "",
    lambda port: ".service" if port.role.is_service else "",
    lambda port: f".{port.type.name if port.type else 'any'}",
)
"""Endings for names that several ports of a node share, tried in order until the names differ."""


@dataclass(frozen=True, slots=True, order=True)
class Guessed:
    """A guess of an import: its subject, its value, and the reason."""

    about: str
    guess: str
    why: str


@dataclass(frozen=True)
class Imported:
    """The environment of a graph, its ontology in Turtle, and the guesses made."""

    graph: RosGraph
    environment: Environment
    ontology: str
    guesses: tuple[Guessed, ...]

    def text(self, ontology: str) -> str:
        """Return the environment file (YAML), which imports `ontology`; comments at its top list the guesses."""
        return imported_text(self.environment, ontology, self._heading())

    def _heading(self) -> Iterator[str]:
        yield f"Imported from {', '.join(self.graph.sources)}: {self.size}."
        for note in self.graph.notes:
            yield f"Unknown: {note}."
        for each in self.graph.dropped:
            yield f"Not imported: {each}."
        if self.guesses:
            yield "Guessed; check each, and correct it in a table for `--guesses FILE`:"
        for guess in self.guesses:
            yield f"  {guess.about}: {guess.guess} ({guess.why})"

    @property
    def size(self) -> str:
        """The size of the import, in words."""
        found = {"node": self.environment.library, "topic": self.graph.topics, "service": self.graph.services}
        return ", ".join(counted(len(each), noun) for noun, each in found.items())


def imported(graph: RosGraph, table: GuessTable, *, works: bool = False, keeps_topics: bool = False) -> Imported:
    """Return the environment in which the graph's nodes run, wired by the graph's topics and services.

    Each node becomes a transformation with one unit. A node becomes a target to run if no node takes its streams. If
    the graph `works` as it is, unfed inputs may stay unfed and every publisher is intended, whatever the table says.
    With `keeps_topics`, nodes outside of a run hear outputs on their topics of the graph.
    """
    return _Making(graph, table, works=works, keeps_topics=keeps_topics).imported


class _End(NamedTuple):
    """A port of a node, by the node's label and the port's name in the file."""

    node: str
    port: str


class _Making:
    """One graph becoming an environment; guesses are noted on the way."""

    def __init__(self, graph: RosGraph, table: GuessTable, *, works: bool, keeps_topics: bool) -> None:
        self._table = table
        self._works, self._keeps_topics = works, keeps_topics
        self._guesses: list[Guessed] = []
        ported = self._ported(graph)
        self._idle = {node.name: tuple(_idle_remaps(node)) for node in ported.nodes}
        self._graph = self._typed(self._without_noise(ported))
        self._words = RosVocabulary(self._graph)
        self._labels = {node.name: node.name.strip("/") or "node" for node in self._graph.nodes}
        self._stopped = {self._labels[node.name] for node in self._graph.nodes if node.runs is False}
        self._names = {node.name: port_names(node) for node in self._graph.nodes}

    @property
    def imported(self) -> Imported:
        inputs = {
            _End(self._labels[node.name], self._names[node.name][port]): (node, port)
            for node in self._graph.nodes
            for port in node.ports
            if not port.role.gives
        }
        feeds = {end: self._feeds(node, port) for end, (node, port) in inputs.items()}
        ports = {end: self._input(end, node, port, feeds) for end, (node, port) in inputs.items()}
        feeds = {end: self._taken(end, streams, ports[end]) for end, streams in feeds.items()}
        ports |= self._closing(ports, feeds, inputs)
        environment = Environment(
            units=tuple(self._unit(node, feeds) for node in self._graph.nodes if node.runs is not False),
            library=tuple(self._transformation(node, ports) for node in self._graph.nodes),
            targets=tuple(self._targets(ports, feeds)),
            hosts=tuple(map(Host, self._machines)),
        )
        return Imported(self._graph, environment, self._words.text, tuple(self._guesses))

    @cached_property
    def _machines(self) -> tuple[str, ...]:
        """The computers of the graph, by name; none where all nodes run on one."""
        named = {node.machine for node in self._graph.nodes if node.machine}
        return tuple(sorted(named | {LOCAL})) if named else ()

    def _machine_of(self, node: RosNode) -> str | None:
        return (node.machine or LOCAL) if self._machines else None

    def _guess(self, about: str, guess: str, why: str) -> None:
        self._guesses.append(Guessed(about, guess, why))

    def _ported(self, graph: RosGraph) -> RosGraph:
        """Return the graph in which nodes without ports have those of the table, or else of their own code."""
        nodes, silent, notes = [], [], list(graph.notes)
        for node in graph.nodes:
            if not node.ports:
                known = self._table.ports_of(node)
                if known is not None:
                    what = node.plugin or f"{node.package}/{node.executable}"
                    self._guess(node.name, f"has the ports of {what}", "the table knows it")
                else:
                    told = ports_of_sources(node, graph.parameters)
                    known = tuple(told.places)
                    notes += self._told_of_sources(node, told)
                node = replace(node, ports=known)
                if not known:
                    silent.append(node.name)
            nodes.append(node)
        if silent:
            mend = "name a live graph too, or say it under `nodes` in a file for --guesses"
            notes.append(f"which ports {some(silent)} have: {mend}")
        return replace(graph, nodes=tuple(nodes), notes=tuple(notes))

    def _told_of_sources(self, node: RosNode, told: SourcePorts) -> Iterator[str]:
        """Note each port from a node's sources as a guess; returns notes on computed names."""
        says = "a source of its package says so" if told.is_whole_package else "its source says so"
        for port, place in sorted(told.places.items(), key=lambda item: (item[1].file, item[1].line, item[0].name)):
            self._guess(node.name, f"{port.role.value} {port.name}", f"{says}: {place}")
        if told.unclear:
            yield f"which topics of {node.name} its code computes: {some(told.unclear, 3)}"

    def _without_noise(self, graph: RosGraph) -> RosGraph:
        table = self._table
        onlookers = [node.name for node in graph.nodes if table.is_noise(node.name)]
        kept = [node for node in graph.nodes if node.name not in onlookers]
        noisy = {port.name for node in kept for port in node.ports if table.is_noisy(port)}
        if onlookers:
            self._guess("nodes", f"left out {', '.join(onlookers)}", "tools that only observe")
        if noisy:
            self._guess("topics and services", f"left out {some(sorted(noisy), 3)}", "every graph has them")
        nodes = (replace(node, ports=tuple(p for p in node.ports if not table.is_noisy(p))) for node in kept)
        return replace(graph, nodes=tuple(nodes))

    def _typed(self, graph: RosGraph) -> RosGraph:
        """The graph in which an end without a type has the only type that the others of its name have."""

        def known(port: RosPort) -> MessageType | None:
            types = graph.types_of(port.name, is_service=port.role.is_service)
            return types[0] if len(types) == 1 else None

        nodes = []
        for node in graph.nodes:
            ports = []
            for port in node.ports:
                kind = port.type or known(port)
                if port.type is None:
                    guess, why = (f"of type {kind}", "its other ends are") if kind else ("of any type", "no end tells")
                    self._guess(f"{port.role.value} {port.name} at {node.name}", guess, why)
                ports.append(replace(port, type=kind))
            nodes.append(replace(node, ports=tuple(ports)))
        return replace(graph, nodes=tuple(nodes))

    @cached_property
    def _givers(self) -> Mapping[tuple[str, bool], list[_End]]:
        """The publishers of each topic and the servers of each service."""
        found: dict[tuple[str, bool], list[_End]] = defaultdict(list)
        for node in self._graph.nodes:
            for port in node.ports:
                if port.role.gives:
                    end = _End(self._labels[node.name], self._names[node.name][port])
                    found[port.name, port.role.is_service].append(end)
        return found

    def _feeds(self, node: RosNode, port: RosPort) -> list[_End]:
        """Return the outputs that feed an input; the node's own output counts only if no other node publishes the
        topic.
        """
        providers = self._givers.get((port.name, port.role.is_service), [])
        others = [end for end in providers if end.node != self._labels[node.name]]
        return others or providers

    def _input(self, end: _End, node: RosNode, port: RosPort, feeds: Mapping[_End, list[_End]]) -> InputPort:
        about = f"input {end.port} of {end.node}"
        tag, is_service = self._words.tag(port), port.role.is_service
        row = self._table.says(node.name, port, "optional")
        optional = row is not None and row.optional is True
        if row is not None and optional:
            self._guess(about, "it may stay unfed", row.why)
        if is_service:
            if not feeds[end] and not optional:
                self._guess(about, "it may stay unfed", "no node serves it now, and it is called now and then")
            is_optional = optional or not feeds[end]
            return InputPort(
                end.port, tag, service=True, optional=is_optional, type=_type(port), remap=_own(node, port)
            )
        if self._works and not optional and all(stream.node in self._stopped for stream in feeds[end]):
            optional = True
            self._guess(about, "it may stay unfed", "no node feeds it, and the graph works")
        row = self._table.says(node.name, port, "several")
        if self._works and row is not None and not row.several and len(feeds[end]) > 1:
            row = row.model_copy(update={"several": True, "why": "they publish, and the graph works"})
        several = len(feeds[end]) > 1 if row is None else bool(row.several)
        if row is not None and (several or len(feeds[end]) > 1):
            self._guess(about, "takes every stream" if several else "takes one stream", row.why)
        elif several:
            self._guess(about, "takes every stream", "it has several, and the table says nothing of its type")
        always = self._table.says(node.name, port, "feedback")
        feedback = always is not None and always.feedback is True
        if always is not None and feedback:
            self._guess(about, "may close a cycle", always.why)
        is_own = any(provider.node == end.node for provider in feeds[end])
        if is_own and not feedback:
            self._guess(about, "may close a cycle", "the node hears itself")
        count = ALL if several and not is_own else 1
        return InputPort(
            end.port,
            tag,
            feedback=feedback or is_own,
            optional=optional,
            count=count,
            type=_type(port),
            remap=_own(node, port),
            qos=_qos(port),
        )

    def _taken(self, end: _End, streams: list[_End], port: InputPort) -> list[_End]:
        """Return the streams that an input is wired to; a client with several servers gets only the first."""
        if port.service and len(streams) > 1:
            self._guess(f"input {end.port} of {end.node}", f"asks {streams[0].node}", "several serve it")
            return streams[:1]
        return streams

    def _closing(
        self,
        ports: Mapping[_End, InputPort],
        feeds: Mapping[_End, list[_End]],
        inputs: Mapping[_End, tuple[RosNode, RosPort]],
    ) -> dict[_End, InputPort]:
        """Return the inputs through which cycles are closed: first those that the table names, then those that lead
        back.
        """
        closing: dict[_End, InputPort] = {}

        def named(end: _End) -> tuple[str, RosPort]:
            return inputs[end][0].name, inputs[end][1]

        def wires() -> networkx.MultiDiGraph:
            graph = networkx.MultiDiGraph()
            for end, streams in feeds.items():
                if not ports[end].feedback and end not in closing:
                    graph.add_edges_from((stream.node, end.node, end) for stream in streams)
            return graph

        def on_cycles(graph: networkx.MultiDiGraph) -> list[_End]:
            cycles = {
                name: number
                for number, cycle in enumerate(networkx.strongly_connected_components(graph))
                for name in cycle
            }
            return sorted({end for one, other, end in graph.edges(keys=True) if cycles[one] == cycles[other]})

        while left := on_cycles(graph := wires()):
            rows = {end: self._table.says(*named(end), "feedback") for end in left}
            depth = _depths(graph)
            listed = [end for end, row in rows.items() if row is not None and row.feedback == "in_cycles"]
            back = max(listed or left, key=lambda end: (min(depth[s.node] for s in feeds[end]) - depth[end.node], end))
            closing[back] = replace(ports[back], feedback=True)
            row = rows[back] if back in listed else None
            why = "it leads back to where data comes in" if row is None else row.why
            self._guess(f"input {back.port} of {back.node}", "closes a cycle", why)
        return closing

    def _unit(self, node: RosNode, feeds: Mapping[_End, list[_End]]) -> ComputationUnit:
        label = self._labels[node.name]
        machine = self._machine_of(node)
        wires = (
            Subscription(end.port, Stream(_unit_of(stream.node), stream.port))
            for end, streams in feeds.items()
            if end.node == label
            for stream in streams
            if stream.node not in self._stopped
        )
        return ComputationUnit(_unit_of(label), label, tuple(wires), host=machine)

    def _transformation(self, node: RosNode, ports: Mapping[_End, InputPort]) -> Transformation:
        label = self._labels[node.name]
        names = self._names[node.name]
        source = _source(node, self._idle.get(node.name, ()))
        keeps_topics = self._keeps_topics and source.kind != "external"
        return Transformation(
            label,
            inputs=tuple(port for end, port in ports.items() if end.node == label),
            outputs=tuple(
                OutputPort(
                    names[port],
                    self._words.tag(port),
                    rate_uhz=round((port.rate_hz or 0) * MICRO),
                    type=_type(port),
                    remap=_own(node, port),
                    qos=_qos(port),
                    topic=port.name if keeps_topics and not port.role.is_service else None,
                )
                for port in node.ports
                if port.role.gives
            ),
            source=str(source),
            run=RunOptions(container=node.container_kind or "plain"),
            params=node.parameters,
            host=self._machine_of(node),
        )

    def _targets(self, ports: Mapping[_End, InputPort], feeds: Mapping[_End, list[_End]]) -> Iterator[Target]:
        """Yield a target for each wanted node, or if none are named, for each end of the graph: every needed node feeds
        one.
        """
        wanted = self._table.wanted
        if wanted is not None:
            for node in self._graph.nodes:
                if any(fnmatchcase(node.name, pattern) for pattern in wanted):
                    yield _to_run(self._labels[node.name])
            return
        needs = {end: streams for end, streams in feeds.items() if not ports[end].starts_nothing}
        for label in _ends(self._labels.values(), needs):
            self._guess(label, "treated as a target", "nothing subscribes to its streams")
            yield _to_run(label)


def _type(port: RosPort) -> str | None:
    return None if port.type is None else str(port.type)


def _qos(port: RosPort) -> str | None:
    return None if port.qos is None else str(port.qos)


def _own(node: RosNode, port: RosPort) -> str:
    """Return the node's own name of a topic or service, before remapping, as far as it is known.

    A name below the node's name is taken as private, one below its namespace as relative; so the name stays valid in
    every namespace.
    """
    if port.own is not None:
        return port.own
    return _from_within(node, next((own for own, name in node.remappings if name == port.name), port.name))


def _from_within(node: RosNode, full: str) -> str:
    """A full name as the node itself writes it: private, relative to its namespace, or full."""
    for above, mark in ((f"{node.name}/", "~"), (f"{node.name.rpartition('/')[0]}/", "")):
        if full.startswith(above) and full != above:
            return mark + full.removeprefix(above)
    return full


def _idle_remaps(node: RosNode) -> Iterator[str]:
    """The remappings of a node that rename none of its ports, as arguments; none where its ports are not known."""
    used = {port.name for port in node.ports}
    for own, name in node.remappings if node.ports else ():
        if name not in used and own not in node.shared:
            yield f"{_from_within(node, own)}{REMAPS}{name}"


def _source(node: RosNode, idle: tuple[str, ...]) -> NodeSource:
    """Return how the node is started; if that is unknown, it is external. `idle` are remappings of no port."""
    arguments = (*node.arguments, *idle)
    if node.package and node.plugin:
        kind: NodeKind = "component" if "::" in node.plugin else "nodelet"
        name = node.plugin.removeprefix(f"{node.package}/")
        return NodeSource(kind, node.package, name, arguments, node.container or "")
    if node.executable and (node.package or node.executable.startswith("/")):
        return NodeSource("node", node.package or "", node.executable, arguments)
    return NodeSource("external", "", node.name)


def _to_run(label: str) -> Target:
    return Target(label, run=label)


def _unit_of(label: str) -> str:
    return f"{label}.1"


def _depths(graph: networkx.MultiDiGraph) -> dict[str, int]:
    """Return each node's distance from unfed nodes; if all nodes are fed, from the first node."""
    sources = [name for name in sorted(graph) if not graph.in_degree(name)]
    depths: dict[str, int] = {}
    while len(depths) < len(graph):
        begin = [name for name in sources if name not in depths] or [min(name for name in graph if name not in depths)]
        reached = networkx.multi_source_dijkstra_path_length(graph, {*begin})
        depths = {**reached, **depths}
    return depths


def _ends(labels: Iterable[str], needs: Mapping[_End, list[_End]]) -> list[str]:
    """Return one label of each group of nodes that need each other's streams, if no other node needs the group's
    streams.
    """
    graph = networkx.DiGraph()
    graph.add_nodes_from(labels)
    for end, streams in needs.items():
        graph.add_edges_from((stream.node, end.node) for stream in streams)
    groups = networkx.condensation(graph)
    ends = (sorted(groups.nodes[group]["members"]) for group in groups if not groups.out_degree(group))
    return sorted(members[0] for members in ends)


def port_names(node: RosNode) -> dict[RosPort, str]:
    """Return a name for each port of a node: the shortest end of its topic's name unique among its ports, with dots.

    If a node publishes a topic that it also subscribes to, the output's name ends in `.out`.
    """
    names: dict[RosPort, str] = {}
    for gives in (False, True):
        ports = [port for port in node.ports if port.role.gives == gives]
        names |= {port: _short(port, ports) for port in ports}
    for ending in _APART:
        taken = Counter(names.values())
        names = {port: name if taken[name] == 1 else name + ending(port) for port, name in names.items()}
    return names


def _short(port: RosPort, ports: Iterable[RosPort]) -> str:
    """The shortest end of a port's name that no other of these has."""
    parts = port.name.strip("/").split("/")
    others = [other.name.strip("/").split("/") for other in ports if other.name != port.name]
    lengths = range(1, len(parts) + 1)
    length = next((n for n in lengths if all(other[-n:] != parts[-n:] for other in others)), len(parts))
    return ".".join(parts[-length:]) or "of_no_name"
