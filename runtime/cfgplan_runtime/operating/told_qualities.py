"""Qualities that topics of ROS tell beside the streams: diagnostics, and in ROS 2 topic statistics."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from math import isfinite
from typing import Any, Final

from cfgplan.domain import Environment, Statement
from cfgplan.qualities import Teller, Told
from cfgplan_runtime.lifecycle.manager import Manager
from cfgplan_runtime.operating.outside_topics import TopicReader, follow_world
from cfgplan_runtime.outside.once import Once
from cfgplan_runtime.streams.closable import Closable
from cfgplan_runtime.streams.said_qualities import PlausibleNumbers

_TYPES: Final = {
    Teller.DIAGNOSTICS: "diagnostic_msgs/DiagnosticArray",
    Teller.STATISTICS: "statistics_msgs/MetricsMessage",
}
_TOLD_DEPTH: Final = 50
_MEAN: Final = 1
"""The kind of a data point of topic statistics that is the mean of a window."""
_SECONDS_OF: Final = {"ms": 1e-3, "s": 1.0}


class ToldQualities(Closable):
    """Reads `/diagnostics` and `/statistics`, as far as outputs are observed there.

    `tell` is called with faults, each once. Raises InputError.
    """

    def __init__(self, reader: TopicReader, manager: Manager, tell: Callable[[str], None]) -> None:
        self._reader, self._manager, self._once = reader, manager, Once(tell)
        self._plausible: dict[Statement, PlausibleNumbers] = {}
        follow_world(manager, reader, _tellers, self._read)

    def close(self) -> None:
        """End the node."""
        self._reader.close()

    def _read(self, teller: Teller) -> int:
        take = partial(self._take, teller)
        return self._reader.read(f"/{teller}", _TYPES[teller], "best_effort", _TOLD_DEPTH, take)

    def _take(self, teller: Teller, message: Any) -> None:
        numbers = dict(told_in(teller, message))
        for statement, told in self._manager.world.environment.told.items():
            if told not in numbers:
                continue
            value = numbers[told]
            if value is None:
                self._once.tell(str(statement), f"/{teller} does not report {statement}: {told.key} is not a number")
                continue
            counted, _ = self._plausible.setdefault(statement, PlausibleNumbers()).after(value)
            for each in counted:
                self._manager.tell_quality(statement, each)


def _tellers(environment: Environment) -> list[Teller]:
    """The topics at which outputs are observed, in order."""
    return sorted({told.teller for told in environment.told.values()})


def told_in(teller: Teller, message: Mapping[str, Any]) -> Iterator[tuple[Told, float | None]]:
    """Yield each quality in a message with its number (statistics: in seconds), or None if its text is no number."""
    if teller is Teller.DIAGNOSTICS:
        for status in message["status"]:
            for pair in status["values"]:
                yield Told(teller, status["name"], pair["key"]), _number(pair["value"])
        return
    key = message["metrics_source"].removeprefix("message_")
    means = [point["data"] for point in message["statistics"] if point["data_type"] == _MEAN]
    scale = _SECONDS_OF.get(message["unit"])
    if means and isfinite(means[0]) and scale is not None:
        yield Told(teller, message["measurement_source_name"], key), means[0] * scale


def _number(text: str) -> float | None:
    try:
        number = float(text)
    except ValueError:
        return None
    return number if isfinite(number) else None
