"""Sums of the qualities that a unit's elements say, from one sign of life to the next."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Final

from cfgplan_runtime.streams.measured_stream import MEASURED, NONE_SAID, MeasuredStream, Quality, measured_kinds

_LARGEST_NUMBER: Final = 1e12
"""In units of an attribute, far beyond every scale; larger numbers are cut, since sums of their squares have no end."""

_GOOD_AGAIN: Final = 100
"""A fault is told again only after so many good values in a row."""


_ABSURD: Final = 1000
"""A number more than this many times as large as usual is absurd.

Bursts are smaller: a latency a hundred times as long is common. A sensor's code for "nothing seen", such as 65535,
mostly is larger.
"""
_SURROUNDINGS: Final = 5
"""The median of this many numbers is usual: two large ones in a row are absurd, three are usual."""


class PlausibleNumbers:
    """The numbers of a series without absurd ones.

    A single absurd number in a mean hides the other numbers for minutes. A number that seems absurd counts later
    if the next ones show that it is usual now.
    """

    def __init__(self) -> None:
        self._last: list[tuple[float, bool]] = []
        """The last numbers, each with whether it counts."""

    def after(self, number: float) -> tuple[list[float], float | None]:
        """Take in a number. Returns the numbers that count from now on, and one that turned out to be absurd."""
        last = [*self._last, (number, False)]
        absurd = next((each for each, counts in last[:-_SURROUNDINGS] if not counts), None)
        last = last[-_SURROUNDINGS:]
        most = _ABSURD * sorted(abs(each) for each, _ in last)[(len(last) - 1) // 2]
        self._last = [(each, counts or most == 0 or abs(each) <= most) for each, counts in last]
        return [each for (each, counts), (_, counted) in zip(self._last, last, strict=True) if counts > counted], absurd


@dataclass(frozen=True, slots=True)
class _Missing:
    """The field that a value does not have."""

    field: str


class SaidQualities:
    """Takes in the values that a unit gives. `stated` has the attributes of each output, with the field that says them.

    A value says an attribute by its field, or by the mapping that unit code gives beside it, which counts first. A
    field `measured.rate` is measured instead: `note` each value too.
    """

    def __init__(self, stated: Mapping[str, Mapping[str, str | None]]) -> None:
        self._stated = stated
        self._fields = {
            port: {
                attribute: field.split(".")
                for attribute, field in fields.items()
                if field is not None and not field.startswith(MEASURED)
            }
            for port, fields in stated.items()
        }
        self._measured = {port: MeasuredStream(kinds) for port in stated if (kinds := measured_kinds(stated[port]))}
        self._plausible: dict[tuple[str, str], PlausibleNumbers] = {}
        self._sums: dict[tuple[str, str], Quality] = {}
        self._faulty: dict[tuple[str, str], int] = {}
        """By output and attribute with a reported fault: the number of good values in a row since then."""

    def take(self, port: str, value: object, beside: Mapping[str, float]) -> list[str]:
        """Take in a value of an output. Returns faults in words, each once until 100 values in a row are good."""
        found = []
        said: dict[str, object] = {}
        for attribute, steps in self._fields.get(port, {}).items():
            said[attribute] = value if attribute in beside else _within(value, steps)
        said.update(beside)
        for attribute, number in said.items():
            if fault := self._taken(port, attribute, number):
                if (port, attribute) not in self._faulty:
                    found.append(f"output {port} {fault}")
                self._faulty[port, attribute] = 0
            elif (port, attribute) in self._faulty:
                self._faulty[port, attribute] += 1
                if self._faulty[port, attribute] >= _GOOD_AGAIN:
                    del self._faulty[port, attribute]
        return found

    def _taken(self, port: str, attribute: str, said: object) -> str:
        """Add a value of an attribute. Returns why it can't be used; empty if it can."""
        if attribute not in self._stated.get(port, ()):
            return f"says its {attribute}, which the environment does not state for it"
        if isinstance(said, _Missing):
            return f"does not say its {attribute}: a value has no field {said.field!r}"
        try:
            number = float(said) if not isinstance(said, str | bytes | bool) else None  # type: ignore[arg-type]
        except Exception:  # unit code may give any object, with a conversion of its own
            number = None
        if number is None or not isfinite(number):
            return f"does not say its {attribute}: {said!r:.60} is not a finite number"
        number = min(max(number, -_LARGEST_NUMBER), _LARGEST_NUMBER)
        counted, absurd = self._plausible.setdefault((port, attribute), PlausibleNumbers()).after(number)
        sums = self._sums.get((port, attribute), NONE_SAID)
        for each in counted:
            sums = sums.with_more(Quality(1, each, 0.0))
        if sums.elements:
            self._sums[port, attribute] = sums
        if absurd is None:
            return ""
        return f"says {absurd:g} as its {attribute}, more than {_ABSURD} times as much as usual: it does not count"

    def note(self, port: str, age_s: float) -> None:
        """Measure an output at a value that comes now."""
        if port in self._measured:
            self._measured[port].note(age_s, time.monotonic())

    def taken(self) -> dict[str, dict[str, Quality]]:
        """The sums since the last call, by output and attribute."""
        found: dict[str, dict[str, Quality]] = {}
        for (port, attribute), sums in self._sums.items():
            found.setdefault(port, {})[attribute] = sums
        self._sums = {}
        for port, stream in self._measured.items():
            if sums_of_stream := stream.taken(time.monotonic()):
                found.setdefault(port, {}).update(sums_of_stream)
        return found


def _within(value: object, steps: Sequence[str]) -> object:
    """Return the value of a nested field or, by its number, of a list; `_Missing` if it is absent."""
    for step in steps:
        try:
            value = value[step] if isinstance(value, Mapping) else value[_position(step)]  # type: ignore[index]
        except Exception:  # unit code may give any object, with an index of its own
            return _Missing(".".join(steps))
    return value


def _position(step: str) -> int:
    """Return the number that a step is. Raises ValueError: a negative one would count from the end."""
    if not step.isdecimal():
        raise ValueError(step)
    return int(step)
