"""Topics of ROS that a run reads beside its units: those that observe facts, and those that tell qualities."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol, TypeAlias

from cfgplan.errors import InputError, InvalidValueError
from cfgplan.facts import Fact
from cfgplan_runtime.lifecycle.manager import Manager
from cfgplan_runtime.lifecycle.reports import Report, Reviewed
from cfgplan_runtime.outside.once import Once
from cfgplan_runtime.streams.closable import Closable

TakeValue: TypeAlias = Callable[[object], None]
"""Called with the value of a message, a mapping from field to value, in a thread of the reader."""
_FACT_DEPTH = 10


class TopicReader(Protocol):
    """A node of its own that reads topics, whoever publishes there. It reports messages that it can't read, once for
    each topic.
    """

    def read(self, topic: str, kind: str, qos: str, depth: int, take: TakeValue) -> int:
        """Read the messages of a type from a topic. Returns the number by which `end` ends it. Raises InputError."""

    def end(self, number: int) -> None:
        """Stop reading a topic."""

    def close(self) -> None:
        """End the node."""


class OutsideFacts(Closable):
    """Reads the topics of all facts that name a message type. `tell` is called with faults, each once."""

    def __init__(self, reader: TopicReader, manager: Manager, tell: Callable[[str], None]) -> None:
        self._reader, self._manager, self._once = reader, manager, Once(tell)
        self._read: dict[Fact, int] = {}
        self._follow()
        manager.listen(self._hear)

    def close(self) -> None:
        """End the node."""
        self._reader.close()

    def _hear(self, report: Report) -> None:
        if isinstance(report, Reviewed):
            self._follow()

    def _follow(self) -> None:
        """Read the topics of the present world's facts, and no others."""
        wanted = {fact for fact in self._manager.world.environment.variable.values() if fact.type is not None}
        for fact in self._read.keys() - wanted:
            self._reader.end(self._read.pop(fact))
        for fact in sorted(wanted - self._read.keys(), key=lambda each: each.key):
            topic, take = fact.observed_on or "", self._taking(fact)
            try:
                self._read[fact] = self._reader.read(topic, fact.type or "", fact.qos or "", _FACT_DEPTH, take)
            except InputError as error:
                self._once.tell(fact.key, f"fact {fact.key} is not observed: {error}")

    def _taking(self, fact: Fact) -> TakeValue:
        def take(message: object) -> None:
            try:
                value = fact.value_in(message)
            except InvalidValueError as error:
                self._once.tell(f"{fact.key} value", f"{fact.observed_on} does not observe its fact: {error}")
            else:
                if value is not None:
                    self._manager.observe_fact(fact.key, value)

        return take
