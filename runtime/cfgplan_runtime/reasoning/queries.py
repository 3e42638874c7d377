"""Queries: a formula, its features, the timing of states, the subscriptions that it is answered over, and
its reports.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, fields, is_dataclass, replace
from typing import Any, Protocol, TypeAlias

from cfgplan.domain import Target
from cfgplan.errors import CfgplanError
from cfgplan_runtime.reasoning.conditions import Field
from cfgplan_runtime.reasoning.features import DeclaredFeatures, Feature
from cfgplan_runtime.reasoning.monitor import Waiting
from cfgplan_runtime.reasoning.parser import parse
from cfgplan_runtime.reasoning.program import Program, compiled
from cfgplan_runtime.reasoning.reader import Vocabulary
from cfgplan_runtime.reasoning.states import Timing
from cfgplan_runtime.reasoning.syntax import Formula
from cfgplan_runtime.reasoning.truth import Verdict

_SHORTEST_BEAT_NS = 10_000_000


@dataclass(frozen=True)
class Query:
    """A formula with its timing. `features` are the features that it names, sorted by name."""

    formula: Formula
    program: Program
    features: tuple[Feature, ...]
    declared: DeclaredFeatures
    timing: Timing


def query(text: str, declared: DeclaredFeatures, timing: Timing | None = None) -> Query:
    """Read a query. Raises InputError with all faults of the formula, each with its column and a hint."""
    formula = parse(text, Vocabulary(declared.features, declared.regions))
    program = compiled(formula)
    used = sorted({found.feature for found in _fields_of(formula)})
    timing = timing or Timing()
    beat = min([timing.beat_ns, *(max(_SHORTEST_BEAT_NS, width) for width in _widths(program))])
    features = tuple(declared.features[name] for name in used)
    return Query(formula, program, features, declared, replace(timing, beat_ns=beat))


def _widths(program: Program) -> list[int]:
    """The lengths of the bounded intervals in nanoseconds. Each needs a state, so that silence is noticed."""
    intervals = [operator.interval for operator in program.operators]
    return [each.end_ns - each.begin_ns for each in intervals if each.end_ns is not None]


def _fields_of(part: object) -> Iterator[Field]:
    if isinstance(part, Field):
        yield part
    elif is_dataclass(part):
        for each in fields(part):
            yield from _fields_of(getattr(part, each.name))


class Sample(Protocol):
    """An element of a stream."""

    @property
    def value(self) -> Any: ...

    @property
    def time_ns(self) -> int:
        """The time when it was made, in nanoseconds since 1970."""


class Samples(Protocol):
    """A topic's elements, until the stream ends.

    Iterating raises TimeoutError if none has come for a while, and may continue after that. It may have `dropped`, the
    number of elements that this consumer was too slow for, and `now_ns`, the time on the run's clock.
    """

    def __iter__(self) -> Iterator[Sample]: ...


class Subscriptions(Protocol):
    """Adds targets, keeps them, and removes them."""

    def add(self, targets: Sequence[Target]) -> None:
        """Add targets. Returns when the run has tried to meet them. Raises InputError for a tag that can't be used."""

    def unmet(self, labels: Sequence[str]) -> Mapping[str, str]:
        """The reason for each of these targets that is not met now, by label."""

    def remove(self, labels: Sequence[str]) -> None:
        """Remove targets. Units that only they needed are stopped."""

    def samples(self, topic: str, wait_s: float) -> AbstractContextManager[Samples]:
        """Subscribe to a topic, and wait up to `wait_s` seconds for it. Raises NoSuchTopicError."""

    def listen(self, tell: Callable[[str], None]) -> None:
        """Call `tell`, from any thread, with a sentence about each event of the subscriptions."""


class UnmetTargetsError(CfgplanError):
    """Features whose targets can't be met, with the reason for each by name."""

    def __init__(self, reasons: Mapping[str, str]) -> None:
        self.reasons = dict(reasons)
        super().__init__("; ".join(reasons.values()))


@dataclass(frozen=True, slots=True)
class SetUp:
    """The subscriptions are set up; `topics` by feature."""

    topics: Mapping[str, str]
    seconds: float


@dataclass(frozen=True, slots=True)
class Noted:
    """An event that affects the answer, such as a unit that died. A condition `is_unknown` for the answer if a value
    lacks a needed field.
    """

    text: str
    is_unknown: bool = False


@dataclass(frozen=True, slots=True)
class Progressed:
    """The progress of a query: the time of the last state, the open operators, and the answers that are
    still possible.
    """

    time_ns: int
    states: int
    waiting: Sequence[Waiting]
    possible: frozenset[Verdict]
    missing: Sequence[str]
    """The features without a value in the last state."""


@dataclass(frozen=True)
class Answer:
    """The answer of a query; its verdict may still be open.

    `time_ns` is the time of the state that decided, or of the last one; `first_ns` of the first. `delay_s` is from that
    time to the answer on the clock. `missing` counts for each feature the states without its value; `late` counts the
    samples that came too late.
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
    """The truth of each proposition in the last state."""
    missing: Mapping[str, int] = field(default_factory=dict)
    late: int = 0
    dropped: int = 0


QueryReport: TypeAlias = SetUp | Noted | Progressed | Answer
