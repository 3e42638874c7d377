"""Topics of ROS 2 that a run reads beside its units, and the check of facts that are observed there."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

from cfgplan.errors import Fault, InputError
from cfgplan.facts import Fact
from cfgplan.ros.qos import ServiceQuality
from cfgplan.ros.types import MessageType
from cfgplan_runtime.errors import EncodingError
from cfgplan_runtime.operating.outside_topics import TakeValue
from cfgplan_runtime.outside.once import Once
from cfgplan_runtime.ros2.definitions import Definitions
from cfgplan_runtime.ros2.message_form import MessageForm
from cfgplan_runtime.ros2.topics import RosTopics, check_installed


class Ros2Reader:
    """A `TopicReader` of ROS 2. Message types are found in the environment file's `folder` too.

    `purpose` is part of its node's name. Raises InputError; `tell` is called with later faults, each once.
    """

    def __init__(self, purpose: str, run: str, folder: Path, tell: Callable[[str], None]) -> None:
        self._folder, self._once = folder, Once(tell)
        self._node = RosTopics(f"cfgplan_{purpose}_{re.sub('[^A-Za-z0-9]', '_', run)}", tell)

    def read(self, topic: str, kind: str, qos: str, depth: int, take: TakeValue) -> int:
        """See `TopicReader.read`."""
        form = form_of(kind, self._folder)

        def taken(data: bytes, _: int) -> None:
            try:
                value = form.decode(data)
            except EncodingError as error:
                self._once.tell(topic, f"messages of {topic} can't be read: {error}")
            else:
                take(value)

        return self._node.read(topic, form, ServiceQuality.read(qos), depth, taken)

    def end(self, number: int) -> None:
        """Stop reading a topic."""
        self._node.end(number)

    def close(self) -> None:
        """End the node."""
        self._node.close()


def form_of(kind: str, folder: Path) -> MessageForm:
    """The form of the messages of a type. Raises InputError."""
    return Definitions(folder=folder).form(MessageType.read(kind))


def check_facts(facts: tuple[Fact, ...], file: Path) -> None:
    """Raise InputError if the message type of a fact of an environment file is not known."""
    check_installed()
    faults = list[Fault]()
    for fact in facts:
        try:
            form_of(fact.type or "", file.resolve().parent)
        except InputError as error:
            faults += [Fault(f"fact {fact.name}: {each.message}", str(file), mend=each.mend) for each in error.faults]
    if faults:
        raise InputError(faults)
