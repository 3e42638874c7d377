"""The outputs of ROS nodes whose messages say how good they are, as a relay reads them.

The helper in the user's ROS Python imports this module, which needs nothing but the standard library.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from cfgplan_runtime.nodes.message_layout import Layout, NumberReader, UnreadableError, field_fault
from cfgplan_runtime.streams.measured_stream import MEASURED, Quality
from cfgplan_runtime.streams.said_qualities import SaidQualities


class ObservedOutputs:
    """The observed outputs of all units, by the topics that they publish on.

    `tell` is called with a unit and a fault in words, once for each attribute until messages are good again.
    `is_aligned` says whether messages are of ROS 2 or of ROS 1.
    """

    def __init__(self, tell: Callable[[str, str], object], *, is_aligned: bool) -> None:
        self._tell, self._is_aligned = tell, is_aligned
        self._outputs: dict[str, list[_ObservedOutput]] = {}

    def __contains__(self, topic: object) -> bool:
        return topic in self._outputs

    def observe(self, unit: str, port: str, topic: str, fields: Mapping[str, str]) -> None:
        """Read from now on the `fields` of messages on a topic, by the attributes of a unit's output that they say."""
        self._outputs.setdefault(topic, []).append(_ObservedOutput(unit, port, fields, is_aligned=self._is_aligned))

    def forget(self, unit: str) -> list[str]:
        """Read no more outputs of a unit. Returns the topics that nothing is read of any more."""
        kept = {topic: [one for one in outputs if one.unit != unit] for topic, outputs in self._outputs.items()}
        self._outputs = {topic: outputs for topic, outputs in kept.items() if outputs}
        return [topic for topic, outputs in kept.items() if not outputs]

    def note(self, topic: str, age_s: float) -> None:
        """Measure an observed topic, on which a message of that age comes now."""
        for output in self._outputs[topic]:
            output.note(age_s)

    def take(self, topic: str, message: bytes | bytearray, layout: Layout) -> None:
        """Read an observed topic's message."""
        for output in self._outputs[topic]:
            for fault in output.take(message, layout):
                self._tell(output.unit, fault)

    def taken(self) -> dict[str, dict[str, dict[str, Quality]]]:
        """Return the sums since the last call, by unit, output and attribute."""
        found: dict[str, dict[str, dict[str, Quality]]] = {}
        for outputs in self._outputs.values():
            for output in outputs:
                if sums := output.taken():
                    found[output.unit] = {**found.get(output.unit, {}), **sums}
        return found


class _ObservedOutput:
    """An output, with readers of its fields once the type of its messages is known."""

    def __init__(self, unit: str, port: str, fields: Mapping[str, str], *, is_aligned: bool) -> None:
        self.unit, self._port, self._is_aligned = unit, port, is_aligned
        self._fields = {name: field for name, field in fields.items() if not field.startswith(MEASURED)}
        self._said = SaidQualities({port: self._fields})
        self._measured = SaidQualities({port: {name: fields[name] for name in fields.keys() - self._fields.keys()}})
        self._layout: Layout | None = None
        self._readers: dict[str, NumberReader] = {}

    def note(self, age_s: float) -> None:
        """Measure the output, of which a message of that age comes now."""
        self._measured.note(self._port, age_s)

    def taken(self) -> dict[str, dict[str, Quality]]:
        """Return the sums since the last call, by output and attribute."""
        said = {**self._said.taken().get(self._port, {}), **self._measured.taken().get(self._port, {})}
        return {self._port: said} if said else {}

    def take(self, message: bytes | bytearray, layout: Layout) -> list[str]:
        """Take in a message. Returns faults in words, each once."""
        faults = [] if layout is self._layout else self._read_by(layout)
        said: dict[str, float] = {}
        try:
            for attribute, reader in self._readers.items():
                number = reader.number(message)
                if number is not None:
                    said[attribute] = number
        except UnreadableError as error:
            self._readers = {}
            return [*faults, f"output {self._port} says nothing of its quality: {error}"]
        return [*faults, *(self._said.take(self._port, None, said) if self._readers else ())]

    def _read_by(self, layout: Layout) -> list[str]:
        """Read messages of this layout from now on. Returns the faults of fields that it does not have."""
        self._layout = layout
        faults = {attribute: field_fault(layout, path) for attribute, path in self._fields.items()}
        self._readers = {
            attribute: NumberReader(layout, path, is_aligned=self._is_aligned)
            for attribute, path in self._fields.items()
            if not faults[attribute]
        }
        self._said = SaidQualities({self._port: {attribute: self._fields[attribute] for attribute in self._readers}})
        return [f"output {self._port} does not say its {each}: {why}" for each, why in faults.items() if why]
