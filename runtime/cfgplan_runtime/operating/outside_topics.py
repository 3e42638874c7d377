"""Topics of ROS that a run reads beside its units: those that observe facts, and those that tell qualities."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from typing import Protocol, TypeAlias, TypeVar

from cfgplan.domain import Environment
from cfgplan.errors import InputError, InvalidValueError
from cfgplan.facts import Fact
from cfgplan_runtime.lifecycle.manager import Manager
from cfgplan_runtime.lifecycle.reports import Report, Reviewed
from cfgplan_runtime.outside.once import Once
from cfgplan_runtime.streams.closable import Closable

TakeValue: TypeAlias = Callable[[object], None]
"""Called with the value of a message, a mapping from field to value, in a thread of the reader."""
_FACT_DEPTH = 10

Reading = TypeVar("Reading", bound=Hashable)


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


def follow_world(
    manager: Manager,
    reader: TopicReader,
    wanted: Callable[[Environment], Sequence[Reading]],
    read: Callable[[Reading], int | None],
) -> None:
    """Read the topics that the present world wants, and no others, now and after each review.

    `read` begins to read one with `reader`, and returns its number; None if it can't be read. Raises its exceptions.
    """
    numbers = dict[Reading, int]()

    def follow() -> None:
        present = wanted(manager.world.environment)
        for one in numbers.keys() - set(present):
            reader.end(numbers.pop(one))
        for one in present:
            number = None if one in numbers else read(one)
            if number is not None:
                numbers[one] = number

    def hear(report: Report) -> None:
        if isinstance(report, Reviewed):
            follow()

    follow()
    manager.listen(hear)


class OutsideFacts(Closable):
    """Reads the topics of all facts that name a message type. `tell` is called with faults, each once."""

    def __init__(self, reader: TopicReader, manager: Manager, tell: Callable[[str], None]) -> None:
        self._reader, self._manager, self._once = reader, manager, Once(tell)
        follow_world(manager, reader, _observed, self._read)

    def close(self) -> None:
        """End the node."""
        self._reader.close()

    def _read(self, fact: Fact) -> int | None:
        topic, kind, qos = fact.observed_on or "", fact.type or "", fact.qos or ""
        try:
            return self._reader.read(topic, kind, qos, _FACT_DEPTH, self._taking(fact))
        except InputError as error:
            self._once.tell(fact.key, f"fact {fact.key} is not observed: {error}")
            return None

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


def _observed(environment: Environment) -> list[Fact]:
    """The facts that name a message type, by key."""
    named = (fact for fact in environment.variable.values() if fact.type is not None)
    return sorted(named, key=lambda fact: fact.key)
