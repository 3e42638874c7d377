"""Why a plan uses a unit, a transformation or an output: the targets that it serves, and the cost of removing it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from enum import StrEnum

from cfgplan.domain import ComputationUnit, Environment, Objective
from cfgplan.explaining.kept import Kept
from cfgplan.explaining.what_if import requiring, without_transformations
from cfgplan.onward import reached
from cfgplan.planning import Feature, Plan, Planner, Problem, Status
from cfgplan.summary import Summary, cpu, summarised, summary
from cfgplan.validity import unused_required


class Choice(StrEnum):
    """The planner's reason to use a subject, or not to."""

    FORCED = "forced"
    """No plan exists without it."""
    CHEAPER = "cheaper"
    """The next best plan costs more, or is worse in an objective before the cost."""
    LESS_CHANGE = "less change"
    """The next best plan costs the same, but rewires or starts more units."""
    TIE = "tie"
    """The next best plan is as good."""
    DEMANDED = "demanded"
    """It is required or pinned: the plan without it would be cheaper or as good."""
    IMPOSSIBLE = "impossible"
    """It is not used, and no plan can use it without leaving another required transformation unused."""
    UNREAD = "unread"
    """An output without subscribers; the cost of using it is not computed."""
    UNDECIDED = "undecided"
    """The planner did not find out in time."""


def _why_summary(why: Why) -> Summary:
    difference = "" if why.difference_us is None else f"; the next best plan costs {cpu(why.difference_us)} more"
    rows = [
        ("units", ", ".join(why.units)),
        ("serve", ", ".join(why.targets)),
        ("feed", ", ".join(why.consumers)),
        ("else would run", ", ".join(why.more)),
        ("else would not", ", ".join(why.less)),
    ]
    return summary(f"{why.subject} is {why.choice}{difference}", ("", "which"), [row for row in rows if row[1]])


@summarised(_why_summary)
@dataclass(frozen=True)
class Why:
    """Why a plan uses `subject`, or why not: a unit, the units of a transformation, or one of their outputs.

    `units` are the units concerned that run after the update; empty if the subject is not used. They serve `targets`
    and feed `consumers` (as unit/port). `otherwise` is the next best plan: without the subject, or with it if it is not
    used. It costs `difference_us` more, whatever the largest cost is, and then runs the transformations `more` but not
    those in `less`. `decides` is the first objective in which it differs, by `difference` more; the cost if it differs
    in none. If `is_spare`, the units are spares, ready for a failure.
    """

    subject: str
    units: tuple[str, ...]
    targets: tuple[str, ...]
    consumers: tuple[str, ...]
    choice: Choice
    otherwise: Plan
    difference_us: int | None = None
    more: tuple[str, ...] = ()
    less: tuple[str, ...] = ()
    is_spare: bool = False
    decides: Objective = Objective.COST
    difference: int | None = None


def why_unit(problem: Problem, planner: Planner, plan: Plan, unit: str) -> Why:
    """Why a plan with a change set runs, or stops, the unit with this id.

    The alternative to a running unit is planned as if it had died, that to a new one as if its transformation did not
    exist.
    """
    environment = problem.environment
    after = problem.after(plan)
    label = (after.unit.get(unit) or environment.unit[unit]).transformation
    units = [u for u in after.units if u.id == unit]
    if unit not in environment.unit:
        other = without_transformations(problem, {label})
    else:
        rest = tuple(u for u in environment.units if u.id != unit)
        other = problem.with_parts(units=rest)
    return _why(problem, planner, plan, unit, label, units, other)


def why_transformation(problem: Problem, planner: Planner, plan: Plan, label: str) -> Why:
    """Why a plan with a change set has units of a transformation, or none."""
    units = [u for u in problem.after(plan).units if u.transformation == label]
    return _why(problem, planner, plan, label, label, units, without_transformations(problem, {label}))


def why_stream(problem: Problem, planner: Planner, plan: Plan, label: str, port: str) -> Why:
    """The reason why an output port of a transformation is used, or not.

    The alternative is planned as if the transformation had no such output.
    """
    environment = problem.environment
    after = problem.after(plan)
    units = [u for u in after.units if u.transformation == label and _readers(after, [u], port)]
    if not units:
        return Why(f"{label}/{port}", (), (), (), Choice.UNREAD, plan)
    library = tuple(
        replace(t, outputs=tuple(p for p in t.outputs if p.name != port)) if t.label == label else t
        for t in environment.library
    )
    other = problem.with_parts(library=library)
    return _why(problem, planner, plan, f"{label}/{port}", label, units, other, port)


def _why(
    problem: Problem,
    planner: Planner,
    plan: Plan,
    subject: str,
    label: str,
    units: list[ComputationUnit],
    without: Problem,
    port: str | None = None,
) -> Why:
    other = without if units else requiring(problem, {label, *problem.environment.required})
    after = problem.after(plan)
    otherwise = planner(replace(other, max_cost_us=None))
    if not units and label in otherwise.unused_required:
        otherwise = _feeding_what_stays(other, planner, label) or otherwise
    choice = _choice(plan, otherwise)
    lost = set(otherwise.unused_required) - set(plan.unused_required)
    usable = label in problem.environment.transformation and label not in otherwise.unused_required
    if not units and (lost or not usable):
        choice = Choice.IMPOSSIBLE
    targets, consumers = _served(after, units, port), _readers(after, units, port)
    is_spare = bool(units) and not targets and problem.survive is not None
    why = Why(subject, tuple(u.id for u in units), targets, consumers, choice, otherwise, is_spare=is_spare)
    if otherwise.change_set is None or choice is Choice.IMPOSSIBLE:
        return why
    assert plan.cost_us is not None and otherwise.cost_us is not None
    then = {u.transformation for u in other.after(otherwise).units}
    now = {u.transformation for u in after.units}
    decides, difference = _apart(plan, otherwise)
    return replace(
        why,
        decides=decides,
        difference=difference,
        difference_us=otherwise.cost_us - plan.cost_us,
        more=tuple(sorted(then - now)),
        less=tuple(sorted(now - then)),
    )


def _feeding_what_stays(problem: Problem, planner: Planner, label: str) -> Plan | None:
    """Return the best plan in which `label` serves units that run anyway, such as pinned ones; None if no plan does."""
    if Feature.SURVIVAL in problem.features:
        return None
    kept = Kept(problem)
    wanted = kept.with_own_targets()
    if wanted is problem:
        return None
    found = planner(wanted)
    if found.change_set is None or label in found.unused_required:
        return None
    plan = kept.without_artificial_targets(found, wanted)
    unused = unused_required(problem.after(plan))
    return replace(plan, unused_required=tuple(each for each in unused if each != label))


def _choice(plan: Plan, otherwise: Plan) -> Choice:
    if otherwise.status is Status.INFEASIBLE:
        return Choice.FORCED
    if otherwise.status is not Status.OPTIMAL or plan.status is not Status.OPTIMAL:
        return Choice.UNDECIDED
    _, difference = _apart(plan, otherwise)
    if difference:
        return Choice.CHEAPER if difference > 0 else Choice.DEMANDED
    if not (plan.ties_proven and otherwise.ties_proven):
        return Choice.UNDECIDED
    one, two = plan.rank[1:], otherwise.rank[1:]
    if one == two:
        return Choice.TIE
    return Choice.LESS_CHANGE if one < two else Choice.DEMANDED


def _apart(plan: Plan, otherwise: Plan) -> tuple[Objective, int]:
    """Return the first objective in which two plans differ, and the other's surplus; the cost if they differ
    in none.
    """
    both = zip(plan.measured, otherwise.measured, strict=True)
    differences = ((one.objective, other.value - one.value) for one, other in both)
    return next((each for each in differences if each[1]), (Objective.COST, 0))


def _served(environment: Environment, units: Iterable[ComputationUnit], port: str | None) -> tuple[str, ...]:
    """The labels of the targets that use the units, or one output of them, directly or through others."""
    topics = {p.topic for u in units for p in u.publications if port in (None, p.port)}
    units = list(units)

    def served_by(users: list[ComputationUnit], port: str | None) -> list[str]:
        readers = [reader.rpartition("/")[0] for reader in _readers(environment, users, port)]
        return readers + ([] if port is not None else _running_with(environment, users))

    through = reached(served_by(units, port), lambda unit: served_by([environment.unit[unit]], None))
    topics.update(p.topic for unit in through for p in environment.unit[unit].publications)
    used = {*through, *(u.id for u in units if port is None)}
    to_run = environment.wanted_to_run.keys()
    met = {label for label, u in environment.meeting(environment.units).items() if u.id in used and label in to_run}
    return tuple(target.label for target in environment.targets if target.topic in topics or target.label in met)


def _running_with(environment: Environment, units: Iterable[ComputationUnit]) -> list[str]:
    """The ids of the running units that run with some units on their hosts."""
    there, library = {(unit.transformation, unit.host) for unit in units}, environment.transformation
    running = [unit for unit in environment.units if not unit.standby and unit.transformation in library]
    return [u.id for u in running if any((label, u.host) in there for label in library[u.transformation].beside)]


def _readers(environment: Environment, units: Iterable[ComputationUnit], port: str | None) -> tuple[str, ...]:
    """Return the subscribers of the units, or of one of their outputs: inputs as unit/port, and topics."""
    ids = {unit.id for unit in units}
    readers = (
        f"{user.id}/{s.port}"
        for user in environment.units
        for s in user.subscriptions
        if s.stream.unit in ids and port in (None, s.stream.port)
    )
    return tuple(dict.fromkeys(readers))
