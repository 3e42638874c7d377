"""The targets of a run that name a message type, as ROS 2 topics of one node."""

from __future__ import annotations

import re
import threading
from dataclasses import dataclass
from pathlib import Path

from cfgplan.domain import Environment, Target
from cfgplan.errors import Fault, InputError
from cfgplan_runtime.lifecycle.reports import Report, Reviewed
from cfgplan_runtime.operating.flows import Following
from cfgplan_runtime.operating.operation import Operation
from cfgplan_runtime.ros2.message_form import MessageForm, MisfitError
from cfgplan_runtime.ros2.once import Once
from cfgplan_runtime.ros2.topics import RosPublisher, RosTopics, check_installed
from cfgplan_runtime.ros2.units import PublisherParams
from cfgplan_runtime.streams.closable import Closable
from cfgplan_runtime.streams.element import Element
from cfgplan_runtime.streams.payload import decode


@dataclass(frozen=True)
class _Topic:
    type: str
    form: MessageForm
    publisher: RosPublisher


class PublishedTargets(Closable):
    """Publishes each target that has a message `type` under its topic, as long as the run has the target.

    A context manager. `folder` is that of the environment file. Raises InputError at the start; later faults are shown.
    """

    def __init__(self, operation: Operation, folder: Path) -> None:
        self._operation = operation
        self._folder = folder
        self._once = Once(operation.show)
        self._lock = threading.Lock()
        self._topics: dict[str, _Topic] = {}
        self._node = RosTopics(f"cfgplan_{re.sub('[^A-Za-z0-9]', '_', operation.id)}", operation.show)
        self._following = Following(operation.id, self._publish)
        operation.manager.listen(self._hear)
        self._take_targets()

    def close(self) -> None:
        self._following.close()
        self._node.close()

    def _hear(self, report: Report) -> None:
        if isinstance(report, Reviewed):
            self._take_targets()

    def _take_targets(self) -> None:
        wanted = {target.topic: target for target in _typed(self._operation.manager.world.environment)}
        with self._lock:
            for topic, published in list(self._topics.items()):
                if topic not in wanted or wanted[topic].type != published.type:
                    self._topics.pop(topic).publisher.close()
            for topic in sorted(wanted.keys() - self._topics.keys()):
                self._begin(wanted[topic])
            self._following.follow(self._topics)

    def _begin(self, target: Target) -> None:
        try:
            params = _params(target)
            form = params.form(self._folder)
            publisher = self._node.publisher(target.topic, form, params.quality, params.depth)
        except InputError as error:
            for fault in error.faults:
                self._once.tell(fault.message, f"{target.topic} is not published in ROS 2: {fault.message}")
        else:
            self._topics[target.topic] = _Topic(params.type, form, publisher)

    def _publish(self, topic: str, element: Element) -> None:
        published = self._topics.get(topic)
        if published is None:
            return
        try:
            published.publisher.put(published.form.encode(decode(element.payload), element.time_ns))
        except MisfitError as error:
            self._once.tell(topic + error.path, f"{topic}: a value is not published in ROS 2: {error}")


def check_targets(environment: Environment, folder: Path) -> None:
    """Raises InputError if no target can be published, or one can't that says its message type."""
    check_installed()
    typed = _typed(environment)
    if not typed:
        mend = "add one to a target, such as `type: nav_msgs/Odometry`, or leave out --ros2"
        raise InputError.of("no target says as what message `type` it is to be published in ROS 2", mend=mend)
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
