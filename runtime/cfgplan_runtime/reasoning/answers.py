"""What an engine reports: that it is set up, where it is, and its answer."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TypeAlias

from cfgplan.errors import CfgplanError
from cfgplan_runtime.reasoning.monitor import Waiting
from cfgplan_runtime.reasoning.truth import Verdict


class UnmetTargetsError(CfgplanError):
    """Features that can't be had, with the reason for each by name."""

    def __init__(self, reasons: Mapping[str, str]) -> None:
        self.reasons = dict(reasons)
        super().__init__("; ".join(reasons.values()))


@dataclass(frozen=True, slots=True)
class SetUp:
    """The subscriptions are there; `topics` by feature."""

    topics: Mapping[str, str]
    seconds: float


@dataclass(frozen=True, slots=True)
class Noted:
    """Something that concerns the answer: a unit died, a value has no such field."""

    text: str


@dataclass(frozen=True, slots=True)
class Progressed:
    """Where the query is: the time of the last state, what it waits for, and which answers are still possible."""

    time_ns: int
    states: int
    waiting: Sequence[Waiting]
    possible: frozenset[Verdict]
    missing: Sequence[str]
    """The features without a value in the last state."""


@dataclass(frozen=True)
class Answer:
    """The answer, or that it is open still.

    `time_ns` is the time of the state that decided, or of the last one; `first_ns` of the first. `delay_s` is from
    that time to the answer on the clock. `missing` says in how many states each feature had no value; `late` how
    many samples came too late.
    """

    verdict: Verdict
    states: int
    first_ns: int | None = None
    time_ns: int | None = None
    delay_s: float | None = None
    waiting: Sequence[Waiting] = ()
    possible: frozenset[Verdict] = frozenset()
    expired: Sequence[Waiting] = ()
    """The operators whose intervals ended with the state that decided."""
    last: Mapping[str, Verdict] = field(default_factory=dict)
    """What was true, false or unknown in the last state."""
    missing: Mapping[str, int] = field(default_factory=dict)
    late: int = 0
    dropped: int = 0


QueryReport: TypeAlias = SetUp | Noted | Progressed | Answer
