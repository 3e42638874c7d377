"""The Python API's questions about plans: why, why not, alternatives, sensitivity; the judge checks every plan."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from threading import Event
from typing import TYPE_CHECKING, Annotated, Literal, TypeAlias

from cfgplan.api import World, accepted, interruptible, near_offers, nearest_offers
from cfgplan.arguments import AtLeast, Seconds, checked
from cfgplan.domain import Environment
from cfgplan.errors import InputError, known
from cfgplan.planners.undecided import Deciding
from cfgplan.planning import Decider, Plan, Planner, Problem, Progress
from cfgplan.reasons import pinned_reasons
from cfgplan.validity import Rule, Violation, violations

if TYPE_CHECKING:
    from cfgplan.explaining import Alternatives, BestEffort, Front, Sensitivity, Unreachable, Why, WhyNot, WiringFault
    from cfgplan.matching import Nearest


@checked
def why_not(
    world: World,
    problem: Problem,
    *,
    planner: str | Planner = "cpsat",
    time_limit_s: Seconds | None = None,
    reasoner: str = "auto",
    reasoner_limit_s: Seconds | None = None,
    decider: Decider | None = None,
) -> WhyNot:
    """Why a problem of this world has no plan, or why its plan leaves required transformations unused.

    `time_limit_s` holds for each of several calls of the planner, `reasoner_limit_s` for all questions about nearest
    offers together.
    """
    from cfgplan import explaining

    nearest = _nearest(world, reasoner, reasoner_limit_s)
    return explaining.why_not(problem, _Judged(planner, time_limit_s, decider), nearest)


def _nearest(world: World, reasoner: str, limit_s: float | None) -> Callable[[str], tuple[Nearest, ...]]:
    """A function from a demanded tag to its nearest offers. All its answers share one time limit."""
    start = time.monotonic()

    def nearest(demanded: str) -> tuple[Nearest, ...]:
        left_s = None if limit_s is None else max(0.0, start + limit_s - time.monotonic())
        return nearest_offers(world, demanded, reasoner=reasoner, time_limit_s=left_s)

    return nearest


def unfed_pinned(
    world: World, problem: Problem, *, reasoner: str = "auto", reasoner_limit_s: Seconds | None = None
) -> dict[str, Unreachable]:
    """Return why each pinned unit that can't be fed can't, by id, with the nearest outputs."""
    pinned = pinned_reasons(problem)
    if not pinned:
        return {}
    from cfgplan import explaining

    nearest = _nearest(world, reasoner, reasoner_limit_s)
    found = {}
    for unit in pinned:
        label = problem.environment.unit[unit].transformation
        (found[unit],) = explaining.unreachable(explaining.running(problem, label), nearest)
    return found


def wiring_faults(
    world: World, problem: Problem, *, reasoner: str = "auto", reasoner_limit_s: Seconds | None = None
) -> tuple[WiringFault, ...]:
    """Return wrong or odd wirings of the running configuration, the most probable fault first, each with similar
    streams.
    """
    from cfgplan import explaining

    environment = problem.environment
    left_out = world.environment.left_out
    found = [
        _with_reason(each, environment, left_out)
        for each in violations(environment, problem.similarity, problem.survive, problem.horizon_s)
    ]
    demands = explaining.wiring_demands(environment, found)
    near = near_offers(world, demands, reasoner=reasoner, time_limit_s=reasoner_limit_s)
    return explaining.wiring_faults(environment, found, near)


def _with_reason(violation: Violation, environment: Environment, left_out: Mapping[str, str]) -> Violation:
    """Return the violation; if the unit's transformation was left out because of a fact, its text names that fact."""
    unit = environment.unit.get(violation.unit or "")
    if violation.rule is not Rule.KNOWN or unit is None or unit.transformation not in left_out:
        return violation
    return replace(violation, text=f"unit {unit.id} may not run now: {left_out[unit.transformation]}")


Subject: TypeAlias = Literal["unit", "transformation", "stream"]


@checked
def why(
    problem: Problem,
    plan: Plan,
    kind: Subject,
    name: str,
    *,
    planner: str | Planner = "cpsat",
    time_limit_s: Seconds | None = None,
    decider: Decider | None = None,
) -> Why:
    """Return why a plan with a change set uses, or does not use, the part of this `name`.

    Its `kind` is `unit` (the name is an id), `transformation` (a label) or `stream` (an output, transformation/port).
    Raises InputError if the plan has no change set, or nothing has that name.
    """
    from cfgplan import explaining

    if plan.change_set is None:
        raise InputError.of("there is no plan to ask about", mend="ask `why_not`")
    environment = problem.environment
    after = environment.update(plan.change_set)
    subjects: dict[str, Iterable[str]] = {
        "unit": {*environment.unit, *after.unit},
        "transformation": environment.transformation,
        "stream": environment.outputs,
    }
    known(name, subjects[kind], "output" if kind == "stream" else kind)
    ask = _Judged(planner, time_limit_s, decider)
    if kind == "unit":
        return explaining.why_unit(problem, ask, plan, name)
    if kind == "transformation":
        return explaining.why_transformation(problem, ask, plan, name)
    label, _, port = name.rpartition("/")
    return explaining.why_stream(problem, ask, plan, label, port)


@checked
def front(
    problem: Problem,
    target: str,
    attribute: str,
    *,
    planner: str | Planner = "cpsat",
    time_limit_s: Seconds | None = None,
    decider: Decider | None = None,
) -> Front:
    """Return the price of better quality of the stream of `target`, a label: the cheapest plan for each value of the
    quality `attribute` that some plan reaches; see `cfgplan.explaining`.

    The time limit is for all plans together. Raises InputError for an unknown target or attribute.
    """
    from cfgplan import explaining

    known(target, problem.environment.target, "target")
    known(attribute, problem.environment.quality, "quality attribute")
    return explaining.front(problem, _Judged(planner, None, decider), target, attribute, time_limit_s=time_limit_s)


@checked
def alternatives(
    problem: Problem,
    count: Annotated[int, AtLeast(1)],
    *,
    planner: str | Planner = "cpsat",
    time_limit_s: Seconds | None = None,
    decider: Decider | None = None,
) -> Alternatives:
    """Return the `count` best configurations that run different transformations, in order; see `cfgplan.explaining`.

    Raises InvalidValueError for a count below 1.
    """
    from cfgplan import explaining

    judged = _Judged(planner, None, decider)
    found = explaining.alternatives(problem, judged, count, time_limit_s=time_limit_s)
    return replace(found, plans=tuple(accepted(judged.known(problem), each) for each in found.plans))


@checked
def sensitivity(
    problem: Problem,
    *,
    upkeep_of: str | None = None,
    planner: str | Planner = "cpsat",
    time_limit_s: Seconds | None = None,
    decider: Decider | None = None,
) -> Sensitivity:
    """Return the optimal plan of each span of horizons, or of a transformation's upkeep; see `cfgplan.explaining`.

    `upkeep_of` is the label of a transformation; None: horizons. The time limit is for each call of the planner. Raises
    InputError for an unknown transformation.
    """
    from cfgplan import explaining

    ask = _Judged(planner, time_limit_s, decider)
    if upkeep_of is None:
        return explaining.horizon_sensitivity(problem, ask)
    known(upkeep_of, problem.environment.transformation, "transformation")
    return explaining.upkeep_sensitivity(problem, ask, upkeep_of)


@checked
def best_effort(
    problem: Problem,
    *,
    planner: str | Planner = "cpsat",
    time_limit_s: Seconds | None = None,
    decider: Decider | None = None,
) -> BestEffort:
    """Return the best update that meets as many targets as possible, important ones first; see `cfgplan.explaining`."""
    from cfgplan import explaining

    judged = _Judged(planner, None, decider)
    found = explaining.best_effort(problem, judged, time_limit_s=time_limit_s)
    return replace(found, problem=judged.known(found.problem))


class _Judged:
    """A planner whose every answer is accepted by the judge; a decider, if given, decides open pairs."""

    def __init__(self, planner: str | Planner, limit_s: float | None, decider: Decider | None) -> None:
        # A single plan that is stopped by Ctrl-C is the best so far; what asks for many of them has to end.
        self._stop = Event()
        self._limit_s = limit_s
        self._deciding = Deciding(interruptible(planner, self._stop), decider, self._stop.is_set)
        self.known = self._deciding.known

    def __call__(
        self, problem: Problem, *, time_limit_s: Seconds | None = None, report: Callable[[Progress], None] | None = None
    ) -> Plan:
        limit_s = min((limit for limit in (self._limit_s, time_limit_s) if limit is not None), default=None)
        found = self._deciding(problem, time_limit_s=limit_s, report=report)
        if self._stop.is_set():
            raise KeyboardInterrupt
        return accepted(self.known(problem), found)
