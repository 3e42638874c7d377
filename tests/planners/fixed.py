"""Models of a problem with some of their booleans fixed: what each allows, and at what cost.

A `Fact` says something about a configuration; each model here knows which of its booleans says so. Solutions that are
not grounded are cut, as the searches do.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

from alone import search_alone
from ortools.sat.python.cp_model import OPTIMAL, CpModel, CpSolver, IntVar, LinearExprT

from cfgplan.domain import (
    ComputationUnit,
    Environment,
    InputPort,
    OutputPort,
    Publication,
    Similarity,
    Stream,
    Subscription,
    Target,
    Transformation,
)
from cfgplan.planners.exact.rules import RULES
from cfgplan.planners.exact.units import one_of_interchangeable_new_units_is_enough
from cfgplan.planners.tuning import USUAL, Fleets, Solve, Tuning
from cfgplan.planning import Problem

MOST_CUTS = 200
"""After so many the worlds of these tests, which have a few units each, have no solution left that is not grounded."""


@dataclass(frozen=True)
class Fact:
    """Something about a configuration that can be so or not."""

    kind: str
    of: tuple[str, ...]
    holds: bool = True

    def __invert__(self) -> Fact:
        return replace(self, holds=not self.holds)


def runs(unit: str) -> Fact:
    return Fact("runs", (unit,))


def waits(unit: str) -> Fact:
    """It is a cold spare."""
    return Fact("waits", (unit,))


def rewired(unit: str) -> Fact:
    """It ran before, and runs with other subscriptions or topics."""
    return Fact("rewired", (unit,))


def feeds(feeder: str, port: str) -> Fact:
    """A unit feeds an input, written `unit/port`."""
    return Fact("feeds", (feeder, port))


def publishes(unit: str, target: str) -> Fact:
    return Fact("publishes", (unit, target))


def on(unit: str, host: str) -> Fact:
    return Fact("on", (unit, host))


def uses(label: str) -> Fact:
    """A required transformation is used by some target."""
    return Fact("uses", (label,))


class Hubs:
    """What the model allows in which inputs share what meets them wherever they can; new units alike are apart."""

    is_apart = False
    tuning = USUAL
    rules = tuple(rule for rule in RULES if rule.add is not one_of_interchangeable_new_units_is_enough)

    def __init__(self, problem: Problem) -> None:
        self.problem = problem

    def allows(self, *facts: Fact) -> bool:
        """Whether some configuration has all these facts."""
        return self.least_us(*facts) is not None

    def least_us(self, *facts: Fact) -> int | None:
        """The least cost of a configuration with these facts; None if there is none."""
        return self._least(facts, lambda: self.model.cost())

    def fewest_changes(self, *facts: Fact) -> int | None:
        """The least that rewired and started units weigh."""
        return self._least(facts, lambda: self.model.changes())

    def _least(self, facts: Iterable[Fact], objective: Callable[[], LinearExprT]) -> int | None:
        cp = self.build()
        for fact in facts:
            ways = self.booleans(fact)
            if fact.holds:
                cp.add_bool_or(ways)
            else:
                cp.add_bool_and([way.negated() for way in ways])
        cp.minimize(objective())
        for _ in range(MOST_CUTS):
            solver = CpSolver()
            solver.parameters.num_workers = 1
            if solver.solve(cp) != OPTIMAL:
                return None
            if self.is_one(solver):
                return round(solver.objective_value)
        raise AssertionError(f"after {MOST_CUTS} cuts the solver's solution is still no configuration")

    def build(self) -> CpModel:
        """The model, anew."""
        self.search = search_alone(self.problem, is_apart=self.is_apart, rules=self.rules, tuning=self.tuning)
        self.candidates = self.search.model.candidates
        self.model = self.search.model
        return self.model.cp

    def booleans(self, fact: Fact) -> list[IntVar]:
        """Booleans one of which holds if the fact does; none if it can't."""
        model, index_of = self.model, self.candidates.index_of
        if fact.kind == "uses":
            return [model.uses_required[label] for label in fact.of if label in model.uses_required]
        unit = index_of.get(fact.of[0], -1)
        kept = {i: wired for i, wired in model.is_wired.items() if self.candidates.all[i].running is not None}
        states = {"runs": model.runs, "waits": model.waits, "rewired": kept}
        if fact.kind in states:
            return [states[fact.kind][unit]] if unit in states[fact.kind] else []
        if fact.kind == "on":
            places = (model.runs_on[unit], model.waits_on[unit])
            return [there for on in places for host, there in on.items() if host == fact.of[1]]
        if fact.kind == "publishes":
            return _from(fact.of[0], model.publishes[fact.of[1]])
        fed, port = fact.of[1].split("/")
        return _from(fact.of[0], model.connects[index_of[fed], port])

    def is_one(self, solver: CpSolver) -> bool:
        """Whether a solution is a configuration; if it is not, something is added that forbids it."""
        true = self.search.true_of(solver.boolean_value)
        if self.search.consider(true) is not None:
            return True
        self.search.forbid(true)
        return False


class WithoutTwins(Hubs):
    """The same in which of new units alike one is enough."""

    rules = RULES


class Apart(Hubs):
    """The model in which every possible subscription has a boolean."""

    is_apart = True


class Explained(Apart):
    """The same, but each solution that is no plan has to be cut for its reason, and none is forbidden alone.

    As in large problems, units that might feed each other have no places in an order.
    """

    tuning = Tuning(fleet=Fleets(few=0), solve=Solve(unexplained=0))


def _from(unit: str, choices: dict[Stream, IntVar]) -> list[IntVar]:
    return [taken for stream, taken in choices.items() if stream.unit == unit]


PLAIN_OUTPUT = OutputPort("x", "")


def kind(
    label: str,
    wants: str = "",
    gives: str = "",
    labor_us: int = 1,
    *,
    distinct: Collection[int] = (),
    feedback: Collection[int] = (),
    output: OutputPort = PLAIN_OUTPUT,
    first: Mapping[str, object] = MappingProxyType({}),
    **more: object,
) -> Transformation:
    """A transformation with inputs in0, in1 ... for the letters of `wants`, outputs x0, x1 ... for those of `gives`.

    `first` has more attributes of the first input.
    """
    inputs = tuple(
        InputPort(f"in{i}", tag, "g" if i in distinct else None, i in feedback, **({} if i else first))  # type: ignore[arg-type]
        for i, tag in enumerate(wants)
    )
    outputs = tuple(replace(output, name=f"x{i}", tag=tag) for i, tag in enumerate(gives))
    return Transformation(label, inputs, outputs, labor_us, **more)  # type: ignore[arg-type]


def unit(label: str, *fed: str, topic: str = "", number: int = 1, **more: object) -> ComputationUnit:
    """A running unit: the streams that feed its inputs, and the target on whose topic its first output is."""
    subscriptions = tuple(Subscription(f"in{i}", Stream.parse(stream)) for i, stream in enumerate(fed) if stream)
    publications = (Publication("x0", f"/{topic}"),) if topic else ()
    return ComputationUnit(f"{label}.{number}", label, subscriptions, publications, **more)  # type: ignore[arg-type]


def world(
    wanted: str | tuple[Target, ...],
    *library: Transformation,
    units: tuple[ComputationUnit, ...] = (),
    horizon_s: int = 1,
    survive: object = None,
    **more: object,
) -> Problem:
    """Targets for the letters of `wanted`, each with its letter as label and topic; each tag matches itself."""
    targets = tuple(Target(tag, tag, f"/{tag}") for tag in wanted) if isinstance(wanted, str) else wanted
    environment = Environment(units, library, targets, **more)  # type: ignore[arg-type]
    similarity = Similarity({tag: frozenset(tag) for tag in "ABCDEFG"})
    return Problem(environment, similarity, horizon_s, survive=survive)  # type: ignore[arg-type]
