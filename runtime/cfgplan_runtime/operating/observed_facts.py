"""Facts that streams observe: the values of such streams are passed to the manager."""

from __future__ import annotations

from collections.abc import Callable

from cfgplan.errors import InvalidValueError
from cfgplan.facts import Fact
from cfgplan_runtime.lifecycle.manager import Manager
from cfgplan_runtime.operating.flows import Following
from cfgplan_runtime.runtime import Runtime
from cfgplan_runtime.streams.closable import Closable
from cfgplan_runtime.streams.element import Element
from cfgplan_runtime.streams.payload import decode


class ObservedFacts(Closable):
    """Follows the streams of a run that observe facts. `tell` is called once for each fact whose stream has no fitting
    value, and for values that came too early.
    """

    def __init__(self, runtime: Runtime, manager: Manager, tell: Callable[[str], object]) -> None:
        self._manager = manager
        self._tell = tell
        self._wrong: set[Fact] = set()
        """The facts whose last element had no fitting value."""
        self._following = Following(runtime, self._wanted, self._hear, tell, "observed")

    def follow(self) -> None:
        """Follow the streams that observe the facts of the present world, and no others."""
        self._following.look()

    def close(self) -> None:
        """Stop following all streams."""
        self._following.close()

    def _wanted(self) -> list[str]:
        facts = self._manager.world.environment.variable.values()
        topics = (fact.observed_on for fact in facts if fact.type is None)  # the others are topics of ROS
        return [topic for topic in topics if topic is not None]

    def _hear(self, topic: str, element: Element) -> None:
        known = self._manager.world.environment.variable.values()
        facts = [fact for fact in known if fact.observed_on == topic and fact.type is None]
        value = decode(element.payload) if facts else None
        for fact in facts:
            try:
                found = fact.value_in(value)
            except InvalidValueError as error:
                if fact not in self._wrong:
                    self._wrong.add(fact)
                    self._tell(f"{topic} does not observe its fact: {error}")
            else:
                self._wrong.discard(fact)
                if found is not None:
                    self._manager.observe_fact(fact.key, found)
