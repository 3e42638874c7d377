"""Pasted output of `ros2 node info`, `ros2 topic info -v` and `rosnode info`, in one text file, in any order."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from cfgplan.errors import Fault, InputError
from cfgplan.formats.files import read_text
from cfgplan.ros.graph import Role, RosGraph, RosNode, RosPort, merged, resolved
from cfgplan.ros.qos import ServiceQuality
from cfgplan.ros.types import MessageType, TypeKind

PASTED_FILES = (".txt",)
STANDARD_INPUT = "-"
_STDIN = "/dev/stdin"
_SECTIONS: dict[str, tuple[Role, TypeKind]] = {
    "Subscribers": (Role.SUBSCRIBES, "msg"),
    "Publishers": (Role.PUBLISHES, "msg"),
    "Service Servers": (Role.SERVES, "srv"),
    "Service Clients": (Role.CALLS, "srv"),
    "Action Servers": (Role.SERVES, "action"),
    "Action Clients": (Role.CALLS, "action"),
}
_SECTIONS1: dict[str, tuple[Role, TypeKind]] = {
    "Subscriptions": (Role.SUBSCRIBES, "msg"),
    "Publications": (Role.PUBLISHES, "msg"),
    "Services": (Role.SERVES, "srv"),
}
_ENDPOINT_ROLES = {"PUBLISHER": Role.PUBLISHES, "SUBSCRIPTION": Role.SUBSCRIBES}
_PORT_LINE = re.compile(r"(/[^\s:]+):\s+(\S+)")
_PORT1 = re.compile(r"\*\s+(/\S+)(?:\s+\[(.*)\])?")
_TOPIC_INFO = re.compile(r"(?:.*\s)?ros2\s+topic\s+info\b.*?\s(/\S+).*")
_FIELD_LINE = re.compile(r"([A-Z][\w /()]*?):\s*(.*)")
_SECONDS = re.compile(r"(\d+)\s+nanoseconds?")
_NEVER_NS = 9_000_000_000_000_000_000
"""Times from here on are infinite: DDS writes infinity as its largest number."""


def is_pasted(source: str) -> bool:
    """Whether a source is text: a file that ends so, or standard input."""
    return source == STANDARD_INPUT or Path(source).suffix in PASTED_FILES


def pasted_graph(source: str, generation: int) -> RosGraph:
    """The nodes that pasted text tells; `-` is standard input. Raises InputError with the line of each fault."""
    name = _STDIN if source == STANDARD_INPUT else source
    return graph_of_text(read_text(Path(name)), name, generation)


def graph_of_text(text: str, name: str, generation: int) -> RosGraph:
    """The nodes that a text of ROS 1 or 2 tells. Raises InputError."""
    reader = _Pasted(name)
    take: Callable[[str], None] = reader.of_ros1 if generation == 1 else reader.of_ros2
    for number, line in enumerate(text.splitlines(), 1):
        reader.line = number
        take(line.strip())
    return reader.graph()


class _Pasted:
    """One reading of a text, line by line."""

    def __init__(self, name: str) -> None:
        self.line = 0
        self._name = name
        self._node: str | None = None
        self._section: tuple[Role, TypeKind] | None = None
        self._topic: str | None = None
        self._nodes: list[RosNode] = []
        self._fields: dict[str, str] = {}
        self._begin = 0
        self._is_topic = False
        self._faults: list[Fault] = []

    def graph(self) -> RosGraph:
        self._end()
        if not self._faults and not self._nodes:
            self._fault(
                "no node is named", "paste the output of `ros2 node info /NAME` or `ros2 topic info -v /TOPIC`", 1
            )
        if self._faults:
            raise InputError(self._faults)
        return replace(merged(RosGraph((node,)) for node in self._nodes), sources=(f"the text {self._name}",))

    def of_ros2(self, line: str) -> None:
        if command := _TOPIC_INFO.fullmatch(line):
            self._end()
            self._topic, self._is_topic = command[1], False
        elif re.fullmatch(r"/[\w/]*\w", line):
            self._end()
            self._node, self._section, self._topic, self._is_topic = line, None, None, False
            self._nodes.append(RosNode(line, runs=True))
        elif line.removesuffix(":") in _SECTIONS and line.endswith(":"):
            self._begin_section(_SECTIONS[line.removesuffix(":")])
        elif line.startswith("Type:"):
            self._end()
            self._topic = None if self._is_topic else self._topic
            self._node, self._section, self._is_topic = None, None, True
            self._fields = {"Type": line.removeprefix("Type:").strip()}
        elif self._section is not None and line.startswith("/"):
            self._port(_PORT_LINE.fullmatch(line), "`/name: package/msg/Type`", self._section[1])
        elif self._is_topic and (field := _FIELD_LINE.fullmatch(line)):
            self._field(field[1], field[2])

    def of_ros1(self, line: str) -> None:
        if named := re.fullmatch(r"Node \[(/.*)\]", line):
            self._node, self._section = named[1], None
            self._nodes.append(RosNode(named[1], runs=True))
        elif (word := line.partition(":")[0]) in _SECTIONS1 and ":" in line:
            self._begin_section(_SECTIONS1[word])
        elif line.startswith("*") and self._section is not None:
            self._port(_PORT1.fullmatch(line), "` * /name [package/Type]`", self._section[1])
        else:
            self._section = None if line else self._section

    def _begin_section(self, section: tuple[Role, TypeKind]) -> None:
        self._end()
        self._section = section
        if self._node is None:
            self._section = None
            self._fault("this section is of no node", "paste the line with the node's name above it too")

    def _port(self, found: re.Match[str] | None, form: str, kind: TypeKind) -> None:
        if self._section is None or self._node is None:
            return
        if found is None:
            self._fault("this line describes no port", f"write it as {form}")
            return
        self._add(self._node, RosPort(self._section[0], found[1], self._type(found[2], kind)))

    def _type(self, text: str | None, kind: TypeKind) -> MessageType | None:
        if text is None or text in ("unknown type", "<unknown>"):
            return None
        try:
            return MessageType.read(text, kind)
        except InputError as error:
            self._fault(error.faults[0].message, error.faults[0].mend)
            return None

    def _add(self, node: str, port: RosPort) -> None:
        self._nodes.append(RosNode(node, (port,), runs=True))

    def _field(self, key: str, value: str) -> None:
        if key == "Node name":
            self._end()
            self._begin = self.line
        if self._begin or key == "Type":
            self._fields[key] = value

    def _end(self) -> None:
        """Finish an endpoint of a topic: make a port of its collected fields."""
        said, begin = self._fields, self._begin
        self._begin = 0
        self._fields = {"Type": said["Type"]} if "Type" in said else {}
        if not begin:
            return
        if self._topic is None:
            mend = "paste the command too: a line `ros2 topic info -v /TOPIC` above what it prints"
            self._fault("the topic of this endpoint is missing", mend, begin)
            return
        role = _ENDPOINT_ROLES.get(said.get("Endpoint type", ""))
        if role is None:
            self._fault("this endpoint says not whether it publishes", "paste its `Endpoint type:` too", begin)
            return
        node = resolved(said["Node name"], said.get("Node namespace", "/"), "")
        kind = self._type(said.get("Topic type") or said.get("Type"), "msg")
        digest = said.get("Topic type hash")
        definition = digest if digest and digest.startswith("RIHS") else None
        self._add(node, RosPort(role, self._topic, kind, definition=definition, qos=_quality(said)))

    def _fault(self, message: str, mend: str | None, line: int | None = None) -> None:
        self._faults.append(Fault(message, file=self._name, line=line or self.line, mend=mend))


def _quality(said: dict[str, str]) -> ServiceQuality | None:
    """Return the quality of service of an endpoint; None if the output does not have it."""
    if "Reliability" not in said and "Durability" not in said:
        return None
    return ServiceQuality(
        reliable=not said.get("Reliability", "").endswith("BEST_EFFORT"),
        transient_local=said.get("Durability", "").endswith("TRANSIENT_LOCAL"),
        deadline_s=_seconds(said.get("Deadline", "")),
        lease_s=_seconds(said.get("Liveliness lease duration", "")),
        manual="MANUAL" in said.get("Liveliness", ""),
    )


def _seconds(text: str) -> float | None:
    """Return a time in seconds; None if it is infinite or missing."""
    found = _SECONDS.fullmatch(text)
    return None if found is None or not 0 < int(found[1]) < _NEVER_NS else int(found[1]) / 1e9
