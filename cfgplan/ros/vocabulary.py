"""The small ontology of a graph: message types and names of topics as concepts, and the tags made of them."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator

from cfgplan.ros.graph import RosGraph, RosPort
from cfgplan.ros.types import MessageType
from cfgplan.selectors import KEYWORDS
from cfgplan.turtle import class_line, heading

ROS_NAMES = "urn:cfgplan:ros#"
"""Begins the IRI of each concept that stands for a message type, a topic or a service."""
_NO_CONCEPTS = KEYWORDS | {"thing", "nothing", "message", "topic", "service"}


class RosVocabulary:
    """The concept names in tags: one for each message type, and one for each topic and service.

    A topic's concept has `-` for `/`, which no name in ROS has: `/robot1/scan` is `robot1-scan`, and
    `sensor_msgs/LaserScan` is `sensor_msgs-LaserScan`.
    """

    def __init__(self, graph: RosGraph) -> None:
        ports = [port for node in graph.nodes for port in node.ports]
        self._taken: set[str] = set()
        types = sorted({port.type for port in ports if port.type is not None})
        self._types = {kind: self._concept(_type_words(kind)) for kind in types}
        definitions = sorted({(port.type, port.definition) for port in ports if port.type and port.definition})
        several = {kind for kind, number in Counter(kind for kind, _ in definitions).items() if number > 1}
        self._definitions = {
            (kind, digest): self._concept(f"{_type_words(kind)}/{_short(digest)}")
            for kind, digest in definitions
            if kind in several
        }
        self._topics = {name: self._concept(name, "topic") for name in graph.topics}
        self._services = {name: self._concept(name, "service") for name in graph.services}

    def tag(self, port: RosPort) -> str:
        """Return a port's tag: messages of its type on its topic."""
        topic = (self._services if port.role.is_service else self._topics)[port.name]
        if port.type is None:
            return topic
        return f"{self._definitions.get((port.type, port.definition or ''), self._types[port.type])} and {topic}"

    @property
    def text(self) -> str:
        """The ontology in Turtle."""
        return "\n".join([*self._lines(), ""])

    def _concept(self, name: str, kind: str = "type") -> str:
        word = "-".join(re.sub(r"\W", "_", part, flags=re.ASCII) for part in name.strip("/").split("/"))
        if word.casefold() in _NO_CONCEPTS or not word[:1].isalpha() or word[-1:] == "-":
            word = f"{kind}-{word or 'of_no_name'}"
        while word in self._taken:
            word += f"_{kind}"
        self._taken.add(word)
        return word

    def _lines(self) -> Iterator[str]:
        yield from heading(ROS_NAMES)
        yield "# Message types. Say here what is also what, such as"
        yield "#   :nav_msgs-Odometry rdfs:subClassOf :geometry_msgs-PoseWithCovarianceStamped ."
        yield ":Message a owl:Class ."
        yield from self._classes("Message", ((word, str(kind)) for kind, word in self._types.items()))
        if self._definitions:
            yield ""
            yield "# Types of which nodes have different definitions, and do not understand each other."
        for (kind, digest), word in self._definitions.items():
            yield from self._classes(self._types[kind], [(word, f"{kind} {digest}")])
        yield ""
        yield "# Topics. As long as a tag names its topic, only that topic feeds an input, as in ROS. To let others,"
        yield "# leave the topic out of the input's tag, or say here that one topic is as good as another, such as"
        yield "#   :scan_filtered rdfs:subClassOf :scan ."
        yield ":Topic a owl:Class ."
        yield from self._classes("Topic", ((word, name) for name, word in self._topics.items()))
        if self._services:
            yield ""
            yield "# Services and actions."
            yield ":Service a owl:Class ."
            yield from self._classes("Service", ((word, name) for name, word in self._services.items()))

    @staticmethod
    def _classes(above: str, members: Iterable[tuple[str, str]]) -> Iterator[str]:
        for word, label in sorted(members):
            yield class_line(word, above, label)


def _short(digest: str) -> str:
    """Return the short form of a definition's digest in names: 8 characters."""
    return digest.rpartition("_")[2][:8]


def _type_words(kind: MessageType) -> str:
    return kind.ros1 if kind.kind == "msg" else kind.ros2
