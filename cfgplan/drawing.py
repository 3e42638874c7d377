"""A configuration as a picture: units as nodes, streams as arrows, the changes of an update coloured.

Layout and rendering are Graphviz's, which the pygraphviz wheel brings along; Mermaid is text only.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Any

from cfgplan.costs import seconds
from cfgplan.domain import ALL, ChangeSet, ComputationUnit, Environment, Host, Stream, Target, amount_of
from cfgplan.figures import told_qualities
from cfgplan.qualities import MICRO
from cfgplan.qualities import units as units_of
from cfgplan.rows import shown_of

_SPECIAL_IN_MERMAID = '"#<>&%$`\\'
FORMATS = ("svg", "png", "dot", "mermaid")


class Mark(Enum):
    """How a unit or an arrow takes part in the update: legend text, line colour, fill colour."""

    KEPT = ("kept", "#57606a", "#f6f8fa")
    STARTED = ("started", "#1a7f37", "#dafbe1")
    REWIRED = ("rewired", "#9a6700", "#fff8c5")
    STOPPED = ("stopped", "#cf222e", "#ffebe9")
    CUT = ("disconnected", "#8250df", "#fbefff")

    @property
    def line(self) -> str:
        return self.value[1]

    @property
    def fill(self) -> str:
        return self.value[2]


GONE = (Mark.STOPPED, Mark.CUT)
"""The mark of an arrow that the update removes."""


@dataclass(frozen=True, slots=True)
class Node:
    """A unit or, where `is_target`, a target; on a `host` if there are any. A cold spare is ready, and does not run."""

    key: str
    lines: tuple[str, ...]
    mark: Mark
    is_target: bool = False
    host: str | None = None
    is_spare: bool = False


@dataclass(frozen=True, slots=True)
class Arrow:
    """A stream from a unit to a unit's input or to a target; a target's arrow has no input.

    `notes` say what limits it; the arrow of a service points both ways.
    """

    tail: str
    head: str
    port: str
    input: str
    mark: Mark
    notes: tuple[str, ...] = ()
    is_service: bool = False


@dataclass(frozen=True)
class Picture:
    """A picture without layout; `hosts` maps a host's name to further lines of text about it."""

    nodes: tuple[Node, ...]
    arrows: tuple[Arrow, ...]
    hosts: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    def dot(self) -> str:
        """The picture in Graphviz's DOT language."""
        return str(self._graph().to_string())

    def mermaid(self) -> str:
        """The picture as a Mermaid flowchart, which code hosts draw inside Markdown."""
        names = {node.key: f"n{number}" for number, node in enumerate(self.nodes)}
        lines = ["flowchart LR"]
        for number, (host, nodes) in enumerate(self._by_host().items()):
            if host is not None:
                lines.append(f'  subgraph h{number}["{_in_mermaid(", ".join(self._frame(host)))}"]')
            for node in nodes:
                text = "<br/>".join(map(_in_mermaid, node.lines))
                shape = f'(["{text}"])' if node.is_target else f'["{text}"]'
                lines.append(f"  {names[node.key]}{shape}:::{node.mark.name.lower()}")
            if host is not None:
                lines.append("  end")
        for arrow in self.arrows:
            stroke = ("<" if arrow.is_service else "") + ("-.->" if arrow.mark in GONE else "-->")
            lines.append(f'  {names[arrow.tail]} {stroke}|"{_in_mermaid(_arrow_text(arrow))}"| {names[arrow.head]}')
        lines += [f"  classDef {mark.name.lower()} stroke:{mark.line},fill:{mark.fill},color:#1f2328" for mark in Mark]
        return "\n".join(lines) + "\n"

    def render(self, format: str) -> bytes:  # noqa: A002 (the word that users of Graphviz know)
        """The picture as the bytes of a file in one of `FORMATS`."""
        if format == "mermaid":
            return self.mermaid().encode()
        if format == "dot":
            return self.dot().encode()
        graph = self._graph()
        with _silent_stderr():
            graph.layout(prog="dot")
            return bytes(graph.draw(format=format))

    def _frame(self, host: str) -> tuple[str, ...]:
        return self.hosts.get(host, (host,))

    def _by_host(self) -> dict[str | None, list[Node]]:
        """The nodes by host, in the order of the hosts; nodes without a host come first."""
        hosts = sorted({node.host for node in self.nodes if node.host is not None})
        return {host: [node for node in self.nodes if node.host == host] for host in (None, *hosts)}

    def _graph(self) -> Any:
        import pygraphviz

        graph = pygraphviz.AGraph(directed=True, strict=False, rankdir="LR", nodesep="0.25", ranksep="0.7")
        graph.graph_attr.update(fontname="Helvetica,Arial,sans-serif", bgcolor="white")
        units = {node.mark for node in self.nodes if not node.is_target}
        marks = units | {arrow.mark for arrow in self.arrows}
        if marks - {Mark.KEPT}:
            legend = [f'<font color="{mark.line}">&#9632; {mark.value[0]}</font>' for mark in Mark if mark in marks]
            space = '<font point-size="5">&#160;</font><br/>'
            graph.graph_attr.update(label=f"<{space}{'&#160;&#160;&#160;'.join(legend)}>", fontsize="11")
        graph.node_attr.update(
            shape="box", style="rounded,filled", fontname="Helvetica,Arial,sans-serif", fontsize="11"
        )
        graph.edge_attr.update(fontname="Helvetica,Arial,sans-serif", fontsize="9", arrowsize="0.7")
        for node in self.nodes:
            shape = "cds" if node.is_target else "box"
            width = "1" if node.mark is Mark.KEPT else "1.6"
            graph.add_node(
                _name_in_dot(node.key),
                label="\\n".join(map(_in_dot, node.lines)),
                shape=shape,
                margin="0.3,0.1" if node.is_target else "0.11,0.055",
                style="filled" if node.is_target else _node_style(node),
                color=node.mark.line,
                fillcolor="white" if node.is_spare else node.mark.fill,
                penwidth=width,
                id=_in_dot(f"node {node.key}"),
                **{"class": node.mark.name.lower() + " spare" * node.is_spare},
            )
        for number, (host, nodes) in enumerate(self._by_host().items()):
            if host is not None:
                graph.add_subgraph(
                    [_name_in_dot(node.key) for node in nodes],
                    name=f"cluster_{number}",
                    label="".join(f"{_in_dot(line)}\\l" for line in self._frame(host)),
                    labeljust="l",
                    style="rounded",
                    color="#d0d7de",
                    fontsize="11",
                )
        for number, arrow in enumerate(self.arrows):
            graph.add_edge(
                _name_in_dot(arrow.tail),
                _name_in_dot(arrow.head),
                key=str(number),
                label=_in_dot(_arrow_text(arrow)),
                color=arrow.mark.line,
                fontcolor=arrow.mark.line,
                style="dashed" if arrow.mark in GONE else "dotted" if arrow.is_service else "solid",
                dir="both" if arrow.is_service else "forward",
                id=_in_dot(f"arrow {arrow.tail}/{arrow.port} {arrow.head}/{arrow.input}"),
                **{"class": arrow.mark.name.lower()},
            )
        return graph


def picture(environment: Environment, change_set: ChangeSet | None = None) -> Picture:
    """Draw the running configuration or, with a change set, the update: before and after in one."""
    change_set = change_set or ChangeSet()
    after = environment.update(change_set)
    mark = {unit.id: Mark.KEPT for unit in after.units}
    mark |= {unit.id: Mark.REWIRED for unit in change_set.rewired}
    mark |= {unit.id: Mark.STARTED for unit in change_set.started}
    mark |= dict.fromkeys(change_set.stopped, Mark.STOPPED)
    units = {**environment.unit, **after.unit}
    nodes = [
        Node(unit.id, _unit_lines(after, unit), mark[unit.id], host=unit.host, is_spare=unit.standby)
        for unit in units.values()
    ]
    reached_qualities = told_qualities(after, after.units)
    arrows = [
        *_arrows(environment, before=environment, after=after),
        *(arrow for arrow in _arrows(after, before=environment, after=after) if arrow.mark is Mark.STARTED),
    ]
    met = after.meeting(after.units).keys()
    for target in environment.targets:
        reached = Mark.KEPT if target.label in met else Mark.STOPPED
        lines: tuple[str, ...] = (target.label, target.topic or target.tag)
        lines += () if reached is Mark.KEPT else ("(not met)",)
        values = reached_qualities.get(target.label, {}) if reached is Mark.KEPT else {}
        lines += tuple(f"{name} {after.quality[name].shown(value)}" for name, value in values.items())
        nodes.append(Node(_target_key(target), lines, reached, is_target=True, host=target.host))
    known = {node.key for node in nodes}
    gone = {arrow.tail for arrow in arrows if arrow.tail not in known}
    nodes += [Node(key, (key, "(gone)"), Mark.STOPPED) for key in sorted(gone)]
    drawn = {node.key for node in nodes}
    shown = tuple(arrow for arrow in arrows if arrow.head in drawn)
    return Picture(tuple(nodes), shown, {host.name: _host_lines(host) for host in environment.hosts})


def _unit_lines(after: Environment, unit: ComputationUnit) -> tuple[str, ...]:
    """Its id, which optional inputs are not fed afterwards, and rules of its transformation."""
    if unit.standby:
        return unit.id, "(cold spare)"
    kind = after.transformation.get(unit.transformation) if unit.id in after.unit else None
    unfed = [] if kind is None else [p.name for p in kind.inputs if p.optional and p.name not in unit.feeds]
    shown = [] if kind is None else shown_of(kind)
    return unit.id, *([f"({', '.join(unfed)}: not fed)"] if unfed else []), *shown


def _host_lines(host: Host) -> tuple[str, ...]:
    """Return a host's name, labels and properties: `h (robot, spot)`, `rent 0.5 s/s, speed 0.5, 1 gpu, energy 36000 W
    s`.
    """
    labels = f" ({', '.join(host.labels)})" if host.labels else ""
    words = [f"rent {seconds(host.rent_us):f} s/s"] if host.rent_us else []
    words += [f"speed {units_of(host.speed):f}"] if host.speed != MICRO else []
    words += [amount_of(resource, amount) for resource, amount in host.offers.items() if amount]
    words += [f"energy {host.energy} W s"] if host.energy is not None else []
    return f"{host.name}{labels}", *([", ".join(words)] if words else [])


def _arrows(drawn: Environment, *, before: Environment, after: Environment) -> Iterator[Arrow]:
    nothing = ComputationUnit("", "")
    for unit in drawn.units:
        was, becomes = before.unit.get(unit.id, nothing), after.unit.get(unit.id, nothing)
        stays = unit.id in after.unit
        for subscription in unit.subscriptions:
            stream = subscription.stream
            both_stay = stays and stream.unit in after.unit
            mark = _mark(subscription, was.subscriptions, becomes.subscriptions, stays=both_stay)
            kind = drawn.transformation.get(unit.transformation)
            port = None if kind is None else kind.input.get(subscription.port)
            several = (
                [] if port is None or port.count == 1 else [f"one of {'all' if port.count == ALL else port.count}"]
            )
            notes = (*_serves(drawn, stream), *several)
            is_service = port is not None and port.service
            yield Arrow(stream.unit, unit.id, stream.port, subscription.port, mark, notes, is_service)
        for publication in unit.publications:
            mark = _mark(publication, was.publications, becomes.publications, stays=stays)
            notes = _serves(drawn, Stream(unit.id, publication.port))
            yield Arrow(unit.id, _topic_key(publication.topic), publication.port, "", mark, notes)
    then, now = _wanted_units(before), _wanted_units(after)
    for target, unit_id in _wanted_units(drawn):
        mark = _mark((target, unit_id), then, now, stays=unit_id in after.unit)
        yield Arrow(unit_id, _target_key(drawn.target[target]), "", "", mark)


def _serves(environment: Environment, stream: Stream) -> tuple[str, ...]:
    """How many inputs and topics may take a stream, in words; nothing if it has no limit."""
    unit = environment.unit.get(stream.unit)
    kind = None if unit is None else environment.transformation.get(unit.transformation)
    port = None if kind is None else kind.output.get(stream.port)
    return () if port is None or port.serves is None else (f"serves {port.serves}",)


def _wanted_units(environment: Environment) -> tuple[tuple[str, str], ...]:
    """The targets that want a unit to run, each with the id of the one that does."""
    met = environment.meeting(environment.units)
    return tuple((target, met[target].id) for target in environment.wanted_to_run if target in met)


def _mark(item: object, before: tuple[object, ...], after: tuple[object, ...], *, stays: bool) -> Mark:
    """The mark of an arrow; `stays` says that the units at its ends run on."""
    if item not in after:
        return Mark.CUT if stays else Mark.STOPPED
    return Mark.KEPT if item in before else Mark.STARTED


def _target_key(target: Target) -> str:
    return _topic_key(target.topic) if target.run is None else f"target {target.label}"


def _topic_key(topic: str) -> str:
    return f"topic {topic}"


def _arrow_text(arrow: Arrow) -> str:
    ports = arrow.port if arrow.input in ("", arrow.port) else f"{arrow.port} → {arrow.input}"
    return f"{ports} ({', '.join(arrow.notes)})" if arrow.notes else ports


def _name_in_dot(key: str) -> str:
    """A node's name: Graphviz keeps those that begin with % to itself, and reads <a> as HTML."""
    return f" {key}" if key.startswith(("%", "<")) else key


def _in_dot(text: str) -> str:
    """Text as it is: Graphviz would read backslashes, entities and <a>."""
    text = text.replace("\\", "\\\\").replace("&", "&amp;")
    return f"\\{text}" if text.startswith("<") else text


def _in_mermaid(text: str) -> str:
    """Text as it is: Mermaid would read quotes, HTML, entities, directives and formulas."""
    return "".join(f"#{ord(c)};" if c in _SPECIAL_IN_MERMAID else c for c in text)


def _node_style(node: Node) -> str:
    return "rounded,filled,dashed" if node.is_spare or node.mark is Mark.STOPPED else "rounded,filled"


@contextmanager
def _silent_stderr() -> Iterator[None]:
    """Keep the font library's complaints about the system's font settings off the user's screen."""
    sys.stderr.flush()
    saved = os.dup(2)
    with Path(os.devnull).open("wb") as nothing:
        os.dup2(nothing.fileno(), 2)
    try:
        yield
    finally:
        os.dup2(saved, 2)
        os.close(saved)
