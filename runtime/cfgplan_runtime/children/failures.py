"""Reports of failed steps: a new failure is reported at once, its repeats as counts at growing intervals."""

from __future__ import annotations

import re
import traceback
from collections.abc import Iterator
from dataclasses import dataclass

from cfgplan_runtime.children.messages import Trouble
from cfgplan_runtime.errors import EncodingError, WrongPortsError

_FIRST_PAUSE_NS, _LONGEST_PAUSE_NS = 500_000_000, 60_000_000_000
"""Repeats are reported after the first pause, then after pauses that double up to the longest."""
_MOST_FAULTS = 20
"""The number of different failures that are known at a time. One that has not come for the longest pause makes room for
another; without room, any further one counts as a repeat of the last.
"""
_KINDS_OF_END = ((WrongPortsError, "wrong ports"), (EncodingError, "can't be sent"))
_FIGURE = re.compile(r"\d+")


@dataclass
class _Repeated:
    """A failure that was reported, and its repeats since the last report."""

    kind: str
    text: str
    last_ns: int
    due_ns: int
    pause_ns: int = _FIRST_PAUSE_NS
    step: int = 0
    repeats: int = 0


class Failures:
    """Decides when a unit's failures are reported.

    Two failures are the same if their exceptions have one type, come from one line of code, and differ only in figures.
    """

    def __init__(self) -> None:
        self._known: dict[tuple[object, ...], _Repeated] = {}

    def take(self, error: Exception, step: int, now_ns: int) -> Trouble | None:
        """Count a failure in a step. Returns its report if it is new."""
        kind = next((kind for known, kind in _KINDS_OF_END if isinstance(error, known)), "raised")
        key = _key(error)
        known = self._known.get(key)
        if known is None and len(self._known) == _MOST_FAULTS:
            known = self._make_room(now_ns)
        if known is not None:
            known.step, known.last_ns, known.repeats = step, now_ns, known.repeats + 1
            return None
        text = "".join(traceback.format_exception(error)) if kind == "raised" else str(error)
        self._known[key] = _Repeated(kind, text, now_ns, now_ns + _FIRST_PAUSE_NS)
        return Trouble(kind, step, text)

    def _make_room(self, now_ns: int) -> _Repeated | None:
        """Forget the failures whose repeats have ended and are told. Returns the last one if there are none."""
        old = [key for key, one in self._known.items() if not one.repeats and now_ns - one.last_ns >= _LONGEST_PAUSE_NS]
        for key in old:
            del self._known[key]
        return None if old else next(reversed(self._known.values()))

    def due(self, now_ns: int, *, is_last: bool = False) -> Iterator[Trouble]:
        """Yield a report for each failure whose repeats are due; at the last call, for each failure with repeats."""
        for known in self._known.values():
            if known.repeats and (is_last or now_ns >= known.due_ns):
                yield Trouble(known.kind, known.step, known.text, known.repeats)
                known.repeats, known.pause_ns = 0, min(2 * known.pause_ns, _LONGEST_PAUSE_NS)
                known.due_ns = now_ns + known.pause_ns


def _key(error: Exception) -> tuple[object, ...]:
    place = error.__traceback__
    while place is not None and place.tb_next is not None:
        place = place.tb_next
    where = None if place is None else (place.tb_frame.f_code.co_filename, place.tb_lineno)
    said = "".join(traceback.format_exception_only(error))  # also if its own `__str__` fails
    return type(error), where, _FIGURE.sub("0", said)
