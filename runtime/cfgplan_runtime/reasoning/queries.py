"""A query: a formula, the features that it needs, and how their streams become states."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, is_dataclass, replace

from cfgplan_runtime.reasoning.conditions import Field
from cfgplan_runtime.reasoning.features import DeclaredFeatures, Feature
from cfgplan_runtime.reasoning.parser import parse
from cfgplan_runtime.reasoning.program import Program, compiled
from cfgplan_runtime.reasoning.reader import Vocabulary
from cfgplan_runtime.reasoning.states import Timing
from cfgplan_runtime.reasoning.syntax import Formula

_SHORTEST_BEAT_NS = 10_000_000


@dataclass(frozen=True)
class Query:
    """What is asked. `features` are those that the formula names, sorted by name."""

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
    beat = min(timing.beat_ns, *(max(_SHORTEST_BEAT_NS, width) for width in _widths(program)), timing.beat_ns)
    features = tuple(declared.features[name] for name in used)
    return Query(formula, program, features, declared, replace(timing, beat_ns=beat))


def _widths(program: Program) -> list[int]:
    """The lengths of bounded intervals: silence must be seen in each."""
    intervals = [operator.interval for operator in program.operators]
    return [each.end_ns - each.begin_ns for each in intervals if each.end_ns is not None]


def _fields_of(part: object) -> Iterator[Field]:
    if isinstance(part, Field):
        yield part
    elif is_dataclass(part):
        for each in fields(part):
            yield from _fields_of(getattr(part, each.name))
