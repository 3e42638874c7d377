"""Facts that streams observe: the values of such streams are passed to the manager."""

from __future__ import annotations

from collections.abc import Callable

from cfgplan.errors import InvalidValueError
from cfgplan.facts import Fact
from cfgplan_runtime.lifecycle.manager import Manager
from cfgplan_runtime.operating.flows import Following
from cfgplan_runtime.streams.closable import Closable
from cfgplan_runtime.streams.element import Element
from cfgplan_runtime.streams.payload import decode


class ObservedFacts(Closable):
    """Follows the streams of a run that observe facts. `tell` is called once for each fact whose stream has no fitting
    value.
    """

    def __init__(self, run: str, manager: Manager, tell: Callable[[str], object]) -> None:
        self._manager = manager
        self._tell = tell
        self._following = Following(run, self._hear)
        self._wrong: set[Fact] = set()
        """The facts whose last element had no fitting value."""

    def follow(self) -> None:
        """Follow the streams that observe the facts of the present world, and no others."""
        facts = self._manager.world.environment.variable.values()
        topics = (fact.observed_on for fact in facts if fact.type is None)  # the others are topics of ROS
        self._following.follow(topic for topic in topics if topic is not None)

    def close(self) -> None:
        """Stop following all streams."""
        self._following.close()

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
