"""Facts of the world that ROS 2 topics observe: the values in their messages are passed to the manager."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import partial
from pathlib import Path

from cfgplan.errors import Fault, InputError, InvalidValueError
from cfgplan.facts import Fact
from cfgplan.ros.qos import ServiceQuality
from cfgplan.ros.types import MessageType
from cfgplan_runtime.errors import EncodingError
from cfgplan_runtime.lifecycle.manager import Manager
from cfgplan_runtime.lifecycle.reports import Report, Reviewed
from cfgplan_runtime.outside.once import Once
from cfgplan_runtime.ros2.definitions import Definitions
from cfgplan_runtime.ros2.message_form import MessageForm
from cfgplan_runtime.ros2.topics import RosTopics, check_installed
from cfgplan_runtime.streams.closable import Closable

_FACT_DEPTH = 10


class RosFacts(Closable):
    """Reads, by a node of its own, the topics of all facts that name a message type.

    `folder` is that of the environment file. Raises InputError; `tell` is called with later faults, each once.
    """

    def __init__(self, run: str, folder: Path, manager: Manager, tell: Callable[[str], None]) -> None:
        self._folder, self._manager, self._once = folder, manager, Once(tell)
        self._read: dict[Fact, int] = {}
        self._node = RosTopics(f"cfgplan_facts_{re.sub('[^A-Za-z0-9]', '_', run)}", tell)
        self._follow()
        manager.listen(self._hear)

    def close(self) -> None:
        """End the node."""
        self._node.close()

    def _hear(self, report: Report) -> None:
        if isinstance(report, Reviewed):
            self._follow()

    def _follow(self) -> None:
        """Read the topics of the present world's facts, and no others."""
        wanted = {fact for fact in self._manager.world.environment.variable.values() if fact.type is not None}
        for fact in self._read.keys() - wanted:
            self._node.end(self._read.pop(fact))
        for fact in sorted(wanted - self._read.keys(), key=lambda each: each.key):
            try:
                form = form_of(fact, self._folder)
            except InputError as error:
                self._once.tell(fact.key, f"fact {fact.key} is not observed: {error}")
                continue
            quality = ServiceQuality.read(fact.qos or "")
            take = partial(self._take, fact, form)
            self._read[fact] = self._node.read(fact.observed_on or "", form, quality, _FACT_DEPTH, take)

    def _take(self, fact: Fact, form: MessageForm, data: bytes, _: int) -> None:
        try:
            value = fact.value_in(form.decode(data))
        except (EncodingError, InvalidValueError) as error:
            self._once.tell(f"{fact.key} value", f"{fact.observed_on} does not observe its fact: {error}")
        else:
            if value is not None:
                self._manager.observe_fact(fact.key, value)


def form_of(fact: Fact, folder: Path) -> MessageForm:
    """The form of the messages that observe a fact. Raises InputError."""
    return Definitions(folder=folder).form(MessageType.read(fact.type or ""))


def check_facts(facts: tuple[Fact, ...], file: Path) -> None:
    """Raise InputError if the message type of a fact of an environment file is not known."""
    check_installed()
    faults = list[Fault]()
    for fact in facts:
        try:
            form_of(fact, file.resolve().parent)
        except InputError as error:
            faults += [Fault(f"fact {fact.name}: {each.message}", str(file), mend=each.mend) for each in error.faults]
    if faults:
        raise InputError(faults)
