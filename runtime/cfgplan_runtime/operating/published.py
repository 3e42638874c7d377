"""The targets of a run that are published elsewhere, as topics of ROS 2 or at a broker of MQTT."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Protocol

from cfgplan.domain import Environment, Target
from cfgplan_runtime.lifecycle.reports import Report, Reviewed
from cfgplan_runtime.operating.flows import Following
from cfgplan_runtime.operating.operation import Operation
from cfgplan_runtime.streams.closable import Closable
from cfgplan_runtime.streams.element import Element


class Outside(Protocol):
    """Where targets are published. It reports by itself the elements that it can't publish."""

    def wanted(self, environment: Environment) -> Iterable[Target]:
        """The targets of an environment that have to be published."""
        ...

    def begin(self, target: Target) -> bool:
        """Be ready to publish a target. Returns whether it can be published."""
        ...

    def end(self, target: Target) -> None:
        """Publish a target no more."""
        ...

    def put(self, topic: str, element: Element) -> None:
        """Publish an element of a target that is published, or has just been ended."""
        ...

    def close(self) -> None: ...


class PublishedTargets(Closable):
    """Publishes targets outside as long as the run has them. A context manager."""

    def __init__(self, operation: Operation, outside: Outside) -> None:
        self._operation = operation
        self._outside = outside
        self._published: dict[str, Target] = {}
        """By topic."""
        self._following = Following(operation.runtime, self._take_targets, outside.put, operation.show, "published")
        operation.manager.listen(self._hear)

    def close(self) -> None:
        self._following.close()
        self._outside.close()

    def _hear(self, report: Report) -> None:
        if isinstance(report, Reviewed):
            self._following.look()

    def _take_targets(self) -> Iterable[str]:
        """Publish the targets that are wanted now, and return their topics. Called by one thread at a time."""
        wanted = {target.topic: target for target in self._outside.wanted(self._operation.manager.world.environment)}
        for topic, target in list(self._published.items()):
            if topic not in wanted or wanted[topic].type != target.type:
                self._outside.end(self._published.pop(topic))
        for topic in sorted(wanted.keys() - self._published.keys()):
            if self._outside.begin(wanted[topic]):
                self._published[topic] = wanted[topic]
        return self._published
