"""Warnings of rclpy and rclcpp about quality of service, in the words of a run.

A node warns that it gets no messages as soon as it sees an endpoint that does not fit. On the topics of its ports that
endpoint is the relay's, which then offers what the node asks for: the warning says the opposite of what happens.
"""

from __future__ import annotations

import re
from collections.abc import Collection

_WARNING = re.compile(
    r"New (?P<end>publisher|subscription) discovered on topic '(?P<topic>[^']+)', (offer|request)ing incompatible QoS"
    r".*Last incompatible policy: (?P<policy>[A-Z]+)"
)


class QualityWarnings:
    """Rewrites the warnings of a run's nodes, each to one line."""

    def __init__(self) -> None:
        self._told: set[tuple[str, str, str]] = set()

    def line(self, unit: str, line: str, ports: Collection[str]) -> str | None:
        """Return the line to show for a line that a unit has printed; None if it repeats a warning.

        `ports` are the names that the ports have in the node's code.
        """
        found = _WARNING.search(line)
        if found is None:
            return line
        key = unit, found["topic"], found["end"]
        if key in self._told:
            return None
        self._told.add(key)
        topic, policy = found["topic"], found["policy"].lower()
        is_port = any(topic == port or topic.endswith(f"/{port.removeprefix('~/').lstrip('/')}") for port in ports)
        if is_port:
            return f"cfgplan: {topic}: the relay's first offer did not fit ({policy}), and was changed to one that fits"
        if found["end"] == "publisher":
            return f"cfgplan: {topic}: a publisher there offers another {policy}: its messages do not arrive"
        return f"cfgplan: {topic}: a subscription there asks for another {policy}: it gets no messages"

    def forget(self, unit: str) -> None:
        """Report warnings of the next node of a unit again."""
        self._told = {key for key in self._told if key[0] != unit}
