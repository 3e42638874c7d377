"""The planning problem, its answer, and the protocol of a planner (Definition 10)."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import cached_property
from typing import Annotated, Any, Final, Protocol

from cfgplan.arguments import Natural, checked
from cfgplan.canonical import fields_of
from cfgplan.costs import LARGEST_COST_US, standby_cost_us, start_cost_us, transfer_cost_us
from cfgplan.domain import (
    CHANGE_HEADS,
    ENVIRONMENT_HEADS,
    ChangeSet,
    ComputationUnit,
    Environment,
    Objective,
    Similarity,
    Transformation,
    change_rows,
    changes_in_words,
    environment_rows,
)
from cfgplan.errors import CfgplanError, InputError, InvalidValueError
from cfgplan.qualities import price_us
from cfgplan.rows import Feature as Feature
from cfgplan.rows import Row, features
from cfgplan.summary import Summary, counted, cpu, summarised, summary
from cfgplan.transformations import MOST_INSTANCES


class Failures(StrEnum):
    """The kinds of single failure that a configuration can survive."""

    UNITS = "units"
    HOSTS = "hosts"
    """The failure of a host, with all its units, or of a unit."""


def _problem_summary(problem: Problem) -> Summary:
    pairs = sum(map(len, problem.similarity.offers.values()))
    line = f"{problem.environment.counted}; horizon {problem.horizon_s} s; {counted(pairs, 'pair')} of tags match"
    return summary(line, ENVIRONMENT_HEADS, environment_rows(problem.environment))


@summarised(_problem_summary)
@dataclass(frozen=True)
@checked
class Problem:
    """Find the optimal update of `environment`, in which tags match by `similarity`, over `horizon_s` seconds that
    costs at most `max_cost_us`.

    If the environment minimises something before the cost, `max_cost_us` still limits the cost: the answer is the best
    of the updates within that limit.
    With `survive`, no single failure of that kind may leave a target without a stream.
    Raises InvalidValueError if costs could add up to more than can be computed exactly.
    """

    environment: Environment
    similarity: Similarity
    horizon_s: Natural
    max_cost_us: Natural | None = None
    survive: Annotated[Failures | None, Row(feature=Feature.SURVIVAL, is_limit=True)] = None

    __getstate__ = fields_of

    def __post_init__(self) -> None:
        if self.largest_cost_us(self.horizon_s) > LARGEST_COST_US:
            raise InvalidValueError(
                "the costs add up to more than can be computed exactly: shorten the horizon or lower the costs"
            )
        if self.survive is Failures.HOSTS and not self.environment.hosts:
            raise InvalidValueError("the failure of a host can't be survived where no hosts are declared")

    @cached_property
    def features(self) -> frozenset[Feature]:
        """The features of the problem beyond the paper; see `Environment.features`."""
        of_units = features(ComputationUnit, self.environment.units)
        return features(Problem, [self]) | of_units | self.environment.features

    @property
    def is_plain(self) -> bool:
        """Whether the problem asks nothing beyond the paper."""
        return not self.features

    def with_parts(self, **parts: Any) -> Problem:
        """Return the problem with other parts of the environment; the same one if they are as they were."""
        environment = self.environment
        if all(getattr(environment, name) == part for name, part in parts.items()):
            return self
        return replace(self, environment=replace(environment, **parts))

    def after(self, plan: Plan) -> Environment:
        """Return the environment after a plan's update; the plan must have a change set."""
        assert plan.change_set is not None
        return self.environment.update(plan.change_set)

    def most_new(self, transformation: Transformation) -> int:
        """Return how many units of a transformation a plan may start: one, unless more are asked for or allowed.

        If it is a companion of others (`beside`): one for each host. If its outputs may feed inputs that count streams:
        the largest count. If failures have to be survived, one more.
        """
        tags = [output.tag for output in transformation.outputs]
        most = max((n for tag, n in self._counts.items() if any(self._may_feed(o, tag) for o in tags)), default=0)
        if transformation.max_instances is not None:
            return min(transformation.max_instances, max(most, MOST_INSTANCES))
        spares = 0 if self.survive is None else 1
        usual = 1 + spares
        if transformation.label in self.environment.companions:
            usual = max(usual, len(self.environment.hosts_for(transformation)))
        return max(usual, transformation.min_instances, most + spares)

    @cached_property
    def _counts(self) -> Mapping[str, int]:
        """The largest count of the inputs of each demanded tag, where that is more than one."""
        found: dict[str, int] = {}
        for port in (port for t in self.environment.library for port in t.inputs if port.count > 1):
            found[port.tag] = max(port.count, found.get(port.tag, 0))
        return found

    def _may_feed(self, offered: str, demanded: str) -> bool:
        return self.similarity.holds(offered, demanded) or self.similarity.is_open(offered, demanded)

    def largest_cost_us(self, horizon_s: int) -> int:
        """Return an upper bound for the cost of every plan over a horizon in seconds."""
        library = self.environment.transformation
        labels = [*library, *(u.transformation for u in self.environment.units if u.transformation in library)]
        if self.is_plain:
            return sum(start_cost_us(library[label], horizon_s) for label in labels)
        units, costs = [library[label] for label in labels], (start_cost_us, standby_cost_us)
        once_us = sum(
            max(cost(t, horizon_s, host) for host in (None, *self.environment.hosts) for cost in costs) for t in units
        )
        return self._largest_fleet_cost_us(once_us, horizon_s)

    def _largest_fleet_cost_us(self, once_us: int, horizon_s: int) -> int:
        environment = self.environment
        copies = max((self.most_new(t) for t in environment.library), default=1)
        worth_us = {t.label: sum(port.worth_us for port in t.inputs) for t in environment.library}
        unfed = sum(worth_us.values()) * copies + sum(worth_us.get(u.transformation, 0) for u in environment.units)
        outputs = [port for t in environment.library for port in t.outputs]
        carried = sum(transfer_cost_us(port, horizon_s, environment.prices_us[-1]) for port in outputs)
        prices = sum(
            price_us(attribute, wish, attribute.worst)
            for target in environment.targets
            for wish in target.quality
            for attribute in [environment.quality[wish.attribute]]
        )
        units = copies + len(environment.units)
        rents = sum(host.rent_us for host in environment.hosts) * horizon_s
        return rents + copies * once_us + units * len(environment.hosts) * carried + prices + unfed * horizon_s


Pair = tuple[str, str]
"""An offered tag and a demanded one."""


class Status(StrEnum):
    """How a planner ended."""

    OPTIMAL = "optimal"
    """The plan is proven cheapest; `Plan.ties_proven` says more."""
    FEASIBLE = "feasible"
    """A plan was found, but is not proven cheapest."""
    INFEASIBLE = "infeasible"
    """Proven: no update meets every target."""
    TOO_EXPENSIVE = "too expensive"
    """Proven: every update that meets every target costs more than the problem allows. Without a `Plan.cost_us` it is
    not known whether any meets them.
    """
    UNKNOWN = "unknown"
    """Stopped without a plan and without a proof that none exists."""

    @classmethod
    def of_plan(
        cls, cost_us: int, bound_us: int, objectives: tuple[Measured, ...] = (), *, is_required_proven: bool
    ) -> Status:
        """Return optimal if the bound equals the cost, all objectives are proven, and no plan uses more required
        transformations; else feasible.
        """
        is_proven = is_required_proven and bound_us == cost_us and all(one.is_proven for one in objectives)
        return cls.OPTIMAL if is_proven else cls.FEASIBLE


REFUSED: Final = (Status.INFEASIBLE, Status.TOO_EXPENSIVE)
"""The statuses of a proof that no plan exists."""

Rank = tuple[int, ...]
"""Unused required transformations, objectives in order, cost in microseconds, rewired and started units: the least is
optimal.
"""


@dataclass(frozen=True, slots=True)
@checked
class Measured:
    """An objective's value in a plan. No plan that is as good in all earlier objectives has a value below `bound`."""

    objective: Objective
    value: int
    bound: int

    @property
    def is_proven(self) -> bool:
        return self.value == self.bound

    @property
    def gap(self) -> float:
        """How far the value may be above the optimum, as a share of it."""
        return (self.value - self.bound) / self.value if self.value else 0.0


def _plan_summary(plan: Plan) -> Summary:
    cost = "" if plan.cost_us is None else f", {cpu(plan.cost_us)} of CPU, at least {cpu(plan.bound_us)}"
    if plan.change_set is None:
        return summary(f"{plan.status} by {plan.planner}{cost}", ("", "why"), plan.reasons.items())
    line = f"{plan.status} by {plan.planner}{cost}; {changes_in_words(plan.change_set)}"
    return summary(line, CHANGE_HEADS, change_rows(plan.change_set))


@summarised(_plan_summary)
@dataclass(frozen=True)
@checked
class Plan:
    """A planner's answer; `status` says how far it got.

    `change_set` is set exactly if the status is optimal or feasible. `cost_us` is the cost of the update
    (Definition 8) in microseconds of CPU time; if every update is too expensive, that of the cheapest one if known.
    `bound_us` is proven: no update is cheaper.
    `reasons` says why a target can't be met, by its label, and why a pinned unit that can't be fed is stopped, by its
    id. `unused_required` names the required transformations that the plan does not use. `seconds` is the wall time of
    each phase; `counts` are the planner's own figures (nodes, conflicts, rounds).

    Three fields say how much is proven besides the cost. `ties_proven`: no plan of this cost rewires fewer running
    units, or as many and starts fewer. `required_proven`: no valid configuration uses more of the required
    transformations; without it, a plan that leaves some unused is not optimal. `undecided`: the (offered, demanded)
    pairs of tags on which the bound depends; a cheaper plan may exist if they match. It is empty for an optimal plan.

    If the environment minimises more than the cost, `objectives` lists the objectives in order. Then `bound_us` holds
    for updates that are as good in all objectives before the cost, a plan is optimal if all of `objectives` are proven,
    and `gap` is that of the first objective not yet proven.
    """

    planner: str
    status: Status
    change_set: ChangeSet | None = None
    cost_us: int | None = None
    bound_us: int = 0
    reasons: Mapping[str, str] = field(default_factory=dict, hash=False)
    unused_required: tuple[str, ...] = ()
    ties_proven: bool = False
    required_proven: bool = False
    undecided: tuple[Pair, ...] = ()
    seconds: Mapping[str, float] = field(default_factory=dict, compare=False)
    counts: Mapping[str, int] = field(default_factory=dict, compare=False)
    objectives: tuple[Measured, ...] = ()

    @property
    def measured(self) -> tuple[Measured, ...]:
        """The values of the objectives, in order: only the cost if no other is minimised; empty if the cost
        is unknown.
        """
        alone = () if self.cost_us is None else (Measured(Objective.COST, self.cost_us, self.bound_us),)
        return self.objectives or alone

    @property
    def unproven(self) -> Plan:
        """The same plan, with the same status, but nothing proven."""
        objectives = tuple(replace(one, bound=0) for one in self.objectives)
        return replace(self, bound_us=0, ties_proven=False, required_proven=False, objectives=objectives)

    @property
    def gap(self) -> float | None:
        """How far the first objective not proven may be above its optimum, as a share of it; None without a cost."""
        if self.cost_us is None:
            return None
        return next((one.gap for one in self.measured if not one.is_proven), 0.0)

    @property
    def rank(self) -> Rank:
        """The plan's sort key in the order of optimality; the plan must have a change set."""
        assert self.change_set is not None and self.cost_us is not None
        changes = self.change_set
        first = [one.value for one in self.objectives]
        return len(self.unused_required), *first, self.cost_us, len(changes.rewired), len(changes.started)


class PlannerFaultError(CfgplanError):
    """A bug of a planner, not of the input, after a plan was found: `plan` is that plan, with nothing proven.

    `message` says what went wrong.
    """

    def __init__(self, message: str, plan: Plan) -> None:
        self.plan = plan
        if plan.change_set is not None and plan.cost_us is not None:
            self.plan = replace(plan.unproven, status=Status.FEASIBLE)
        super().__init__(message)


class OwnPlannerError(CfgplanError):
    """A user's planner, or its module, raised an exception that it must not (the cause), or it returned no `Plan`.

    `text` says which, and `mend` how to correct it.
    """

    def __init__(self, text: str, *, mend: str = "CFGPLAN_TRACEBACK=1 shows where") -> None:
        super().__init__(text)
        self.mend = mend


@dataclass(frozen=True, slots=True)
@checked
class Progress:
    """A planner's state while it works: after `elapsed_s` seconds the best plan costs `cost_us` microseconds of CPU
    time (None: there is none yet), and it is proven that none costs less than `bound_us`.
    """

    elapsed_s: float
    cost_us: int | None
    bound_us: int


OnProgress = Callable[[Progress], None]
"""A callback for each better plan and each higher bound."""


class Planner(Protocol):
    """A function of a problem. `report` is called whenever the best cost or the bound improves."""

    def __call__(
        self, problem: Problem, *, time_limit_s: float | None = None, report: OnProgress | None = None
    ) -> Plan: ...


class Decider(Protocol):
    """Decides whether open pairs of tags match."""

    @property
    def similarity(self) -> Similarity:
        """The similarity as far as it is known."""
        ...

    @property
    def counts(self) -> Mapping[str, int]:
        """Figures for `Plan.counts`: how many pairs were asked about by now, and decided by whom."""
        ...

    def decide(self, pairs: Sequence[Pair]) -> int:
        """Ask about pairs, the most wanted first. Returns how many were asked; `similarity` has the answers."""
        ...


@checked
def fresh_unit_ids(environment: Environment, labels: Collection[str]) -> dict[str, str]:
    """Return an id for one new unit of each of the `labels`: `camera.N` with the least N that nothing runs or refers
    to.
    """
    return {label: ids[0] for label, ids in fresh_units(environment, dict.fromkeys(labels, 1)).items()}


def fresh_units(environment: Environment, numbers: Mapping[str, int]) -> dict[str, tuple[str, ...]]:
    """Return ids for several new units of each label; the first of each is that of `fresh_unit_ids`."""
    taken = {unit.id for unit in environment.units}
    taken.update(s.stream.unit for unit in environment.units for s in unit.subscriptions)
    first = {label: _free_id(label, taken) for label, number in numbers.items() if number}
    return {
        label: (first[label], *(_free_id(label, taken) for _ in range(number - 1))) if number else ()
        for label, number in numbers.items()
    }


def refuse_order(problem: Problem, who: str) -> None:
    """Raise InputError if a problem minimises anything before or beside the cost."""
    if Feature.ORDER in problem.features:
        named = ", ".join(problem.environment.minimise)
        raise InputError.of(f"{who} compare costs, but `minimise` is [{named}]", mend="leave `minimise` out")


@checked
def refuse_features(problem: Problem, who: str) -> None:
    """Raise InputError if a problem has features beyond the paper, which only `cpsat` and `exhaustive` know.

    `who` is the name of the planner that refuses it.
    """
    if problem.features:
        known = " and ".join(sorted(problem.features))
        raise InputError.of(f"{who} does not support {known}", mend="use the planner cpsat")


def _free_id(label: str, taken: set[str]) -> str:
    number = 1
    while f"{label}.{number}" in taken:
        number += 1
    taken.add(f"{label}.{number}")
    return f"{label}.{number}"
