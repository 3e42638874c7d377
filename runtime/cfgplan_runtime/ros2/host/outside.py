"""Publishes outputs on the topics by which nodes outside of the run know them, as long as one of those listens.

Units publish on topics of their own. An output that had a name in a graph has it again here: the graph shows the topic,
and the first subscription starts the copying.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from typing import Protocol

from cfgplan_runtime.ros2.host.endpoints import Publication, Sample, Source, UnknownTypeError
from cfgplan_runtime.ros2.host.host import Host
from cfgplan_runtime.ros2.host.qos import asked_of

_LISTENER_DEPTH = 100
_UNUSED_LOOKS = 5
"""The looks after which a topic ends that no unit gives any more: a replacement goes on with it."""


class OutputRelays(Protocol):
    """The methods of `Relays` that outside topics use."""

    def hold_source(self, unit: str, topic: str, key: str, kind: str | None) -> Source: ...

    def let_go(self, unit: str, topic: str) -> None: ...

    def is_led(self, topic: str) -> bool: ...


@dataclass(eq=False)
class _Output:
    """A unit's output: the `topic` of its node, and its name `outside` of the run."""

    unit: str
    topic: str
    key: str
    kind: str | None
    outside: str

    @property
    def holder(self) -> str:
        """The name by which its topic is held."""
        return f"{self.unit} outside"


class OutsideTopics:
    """The topics of all outputs that have a name outside of the run."""

    def __init__(self, host: Host, relays: OutputRelays) -> None:
        self._host, self._relays = host, relays
        self._outputs: list[_Output] = []
        self._publications: dict[str, Publication] = {}
        self._unused: dict[str, int] = {}

    def add(self, unit: str, topic: str, key: str, kind: str | None, outside: str) -> None:
        self._outputs.append(_Output(unit, topic, key, kind, outside))

    def remove(self, unit: str) -> None:
        """Forget the outputs of a unit that is gone."""
        for output in self._outputs:
            if output.unit == unit:
                self._relays.let_go(output.holder, output.topic)
        self._outputs = [one for one in self._outputs if one.unit != unit]

    def rename(self, old: str, new: str) -> None:
        """Note that the spare `old` is the unit `new` from now on."""
        for output in self._outputs:
            if output.unit == old:
                if self._is_heard(output):
                    self._relays.hold_source(f"{new} outside", output.topic, output.key, output.kind)
                    self._relays.let_go(output.holder, output.topic)
                output.unit = new

    def look(self) -> None:
        """Open topics of known types, and listen to the outputs that have a listener."""
        for output in self._outputs:
            with suppress(UnknownTypeError):  # who holds the output tells of that
                self._look_at(output)
        used = {output.outside for output in self._outputs}
        for name in list(self._publications):
            self._unused[name] = 0 if name in used else self._unused.get(name, 0) + 1
            if self._relays.is_led(name) or self._unused[name] >= _UNUSED_LOOKS:
                self._publications.pop(name).close()

    def pass_on(self, sample: Sample) -> None:
        """Publish a message on the outside topics of the output that it comes from."""
        for output in self._outputs:
            if output.topic == sample.source.topic and self._is_heard(output):
                self._publications[output.outside].publish(sample.raw)

    def _look_at(self, output: _Output) -> None:
        if self._relays.is_led(output.outside):
            self._relays.let_go(output.holder, output.topic)
            return
        found = self._host.node.get_publishers_info_by_topic(output.topic)
        publishers = [one for one in found if not self._host.is_own(one)]
        if not publishers:
            return
        publication = self._publications.get(output.outside)
        if publication is None:
            publication = self._publications[output.outside] = Publication(self._host, output.outside, {}, is_own=False)
            publication.depth = _LISTENER_DEPTH
        publication.kind = publishers[0].topic_type
        publication.is_latched = asked_of(publishers).is_latched
        publication.look()
        if self._is_heard(output):
            self._relays.hold_source(output.holder, output.topic, output.key, output.kind)
        else:
            self._relays.let_go(output.holder, output.topic)

    def _is_heard(self, output: _Output) -> bool:
        publication = self._publications.get(output.outside)
        return publication is not None and publication.matches() > 0
