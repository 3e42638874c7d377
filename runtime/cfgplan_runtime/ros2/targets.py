"""The targets of a run that name a message type, as ROS 2 topics of one node."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from cfgplan.domain import Environment, Target
from cfgplan.errors import Fault, InputError
from cfgplan_runtime.outside.once import Once
from cfgplan_runtime.ros2.message_form import MessageForm, MisfitError
from cfgplan_runtime.ros2.topics import RosPublisher, RosTopics, check_installed
from cfgplan_runtime.ros2.units import PublisherParams
from cfgplan_runtime.streams.element import Element
from cfgplan_runtime.streams.payload import decode


@dataclass(frozen=True)
class _Topic:
    form: MessageForm
    publisher: RosPublisher


class RosTargets:
    """Publishes each target that has a message `type` under its topic, as a node of its own.

    `folder` is that of the environment file. Raises InputError; `tell` is called with later faults.
    """

    def __init__(self, run: str, folder: Path, tell: Callable[[str], None]) -> None:
        self._folder = folder
        self._once = Once(tell)
        self._topics: dict[str, _Topic] = {}
        self._node = RosTopics(f"cfgplan_{re.sub('[^A-Za-z0-9]', '_', run)}", tell)

    def wanted(self, environment: Environment) -> list[Target]:
        """The targets that say their message type."""
        return _typed(environment)

    def begin(self, target: Target) -> bool:
        """Be ready to publish a target. Returns whether it can be published."""
        try:
            params = _params(target)
            form = params.form(self._folder)
            publisher = self._node.publisher(target.topic, form, params.quality, params.depth)
        except InputError as error:
            for fault in error.faults:
                self._once.tell(fault.message, f"{target.topic} is not published in ROS 2: {fault.message}")
            return False
        self._topics[target.topic] = _Topic(form, publisher)
        return True

    def end(self, target: Target) -> None:
        """Publish a target no more."""
        self._topics.pop(target.topic).publisher.close()

    def put(self, topic: str, element: Element) -> None:
        """Publish an element."""
        published = self._topics.get(topic)
        if published is None:
            return
        try:
            published.publisher.put(published.form.encode(decode(element.payload), element.time_ns))
        except MisfitError as error:
            self._once.tell(topic + error.path, f"{topic}: a value is not published in ROS 2: {error}")

    def close(self) -> None:
        """End the node."""
        self._node.close()


def check_targets(environment: Environment, folder: Path) -> None:
    """Raise InputError if no target names a message type, or if a target that names one can't be published."""
    check_installed()
    typed = _typed(environment)
    if not typed:
        mend = "add one to a target, such as `type: nav_msgs/Odometry`, or leave out --ros2"
        raise InputError.of("no target has a message `type` for ROS 2", mend=mend)
    faults = list[Fault]()
    for target in typed:
        try:
            _params(target).form(folder)
        except InputError as error:
            faults += (
                Fault(f"target {target.label}: {each.message}", each.file, mend=each.mend) for each in error.faults
            )
    if faults:
        raise InputError(faults)


def _typed(environment: Environment) -> list[Target]:
    return [target for target in environment.stream_targets if target.type is not None]


def _params(target: Target) -> PublisherParams:
    """How a target is published. Raises InputError."""
    params = PublisherParams(topic=target.topic, type=target.type or "")
    params.check()
    return params
