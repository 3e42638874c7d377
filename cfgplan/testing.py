"""A conformance kit for planners: whether one keeps what `cfgplan.planning.Planner` promises.

from cfgplan.testing import check_planner
from greedy import plan

def test_greedy():
    check_planner(plan, without=("distinct", "pinned", "required"))

It draws small problems, and holds each answer against the oracle, which tries every configuration, and the judge.
"""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from dataclasses import MISSING, Field, dataclass, field, fields, is_dataclass, replace
from enum import Enum, StrEnum
from queue import Empty, SimpleQueue
from random import Random
from typing import Annotated, Any, Literal, TypeAlias

from cfgplan.arguments import AtLeast, Natural, Seconds, checked
from cfgplan.domain import (
    ALL,
    ComputationUnit,
    Environment,
    Host,
    InputPort,
    Link,
    Objective,
    OutputPort,
    Publication,
    Similarity,
    Stream,
    Subscription,
    Target,
    Transformation,
)
from cfgplan.errors import InputError, InvalidValueError
from cfgplan.planners import exhaustive
from cfgplan.planning import REFUSED, Failures, Feature, Plan, Planner, Problem, Progress, Status
from cfgplan.qualities import MICRO, Better, Contribution, Over, QualityAttribute, QualityRule, Wish
from cfgplan.validity import plan_violations

__all__ = ["PlannerFault", "PlannerReport", "Promise", "check_planner", "examine_planner"]

Word: TypeAlias = Literal["distinct", "feedback", "max_cost", "pinned", "required", "running"]
"""A word of the paper's problems that a planner may be checked without."""
PATIENCE_S = 60.0
"""Seconds that a planner may exceed its time limit: computers are busy, and a first call imports libraries."""
_TAGS = ("A", "B", "C", "D")
_TOPIC_OF_NOBODY = "/stale"
_MOST_SMALLER = 200
_LARGE_LIMIT_S = 0.2


class Promise(StrEnum):
    """The promises of a planner."""

    ANSWERS = "a planner returns a Plan, and raises nothing but InputError"
    TAKES = "a planner takes the paper's problems, and those with features that it is said to know"
    VALID = "the judge accepts every plan"
    STATUS = "a planner says that there is no plan only where that is so"
    OPTIMAL = "no plan is better than an optimal one"
    BOUND = "no plan costs less than the bound"
    TIES = "no plan of this cost rewires or starts fewer units where ties are proven"
    REQUIRED = "no plan uses more of the required transformations where that is proven"
    REPORTS = "the progress that is reported is true"
    TIME = "a planner ends at its time limit"
    PURE = "a planner leaves the problem as it is"
    PROVES = "an exact planner proves its answer to a small problem"
    FINDS = "a planner finds a plan of some problem"


@dataclass(frozen=True)
class PlannerFault:
    """A broken promise, with the smallest problem that was found to break it, the answer, and its time limit."""

    promise: Promise
    text: str
    problem: Problem | None = None
    plan: Plan | None = None
    time_limit_s: float | None = None

    def __str__(self) -> str:
        limit = "" if self.time_limit_s is None else f" within {self.time_limit_s:g} s"
        shown = "" if self.problem is None else f"\n  problem{limit}: {_written(self.problem)}"
        return f"{self.promise}: {self.text}{shown}" + (
            "" if self.plan is None else f"\n  answer: {_written(self.plan)}"
        )


def _written(value: object) -> str:
    """A value as Python writes it, without the fields that have their defaults."""
    if isinstance(value, Enum):
        return f"{type(value).__name__}.{value.name}"
    if is_dataclass(value):
        told = [(each.name, getattr(value, each.name)) for each in fields(value) if not _is_default(value, each)]
        return f"{type(value).__name__}({', '.join(f'{name}={_written(each)}' for name, each in told)})"
    if isinstance(value, tuple):
        return f"({', '.join(map(_written, value))}{',' if len(value) == 1 else ''})"
    if isinstance(value, Mapping):
        return f"{ {key: value[key] for key in sorted(value)} }"
    return repr(value)


def _is_default(value: object, one: Field[Any]) -> bool:
    default = one.default_factory() if one.default_factory is not MISSING else one.default
    return bool(getattr(value, one.name) == default)


@dataclass(frozen=True)
class PlannerReport:
    """The result of a planner check: its faults, and the number of answers by status, refusals included."""

    faults: tuple[PlannerFault, ...]
    answers: Mapping[str, int] = field(default_factory=dict, hash=False)

    def __str__(self) -> str:
        numbers = ", ".join(f"{number} {status}" for status, number in sorted(self.answers.items()))
        return "\n".join([*map(str, self.faults), f"answers: {numbers}"])


@checked
def check_planner(
    plan: Planner,
    *,
    number: Annotated[int, AtLeast(1)] = 200,
    seed: Natural = 0,
    features: Collection[Feature] = (),
    without: Collection[Word] = (),
    is_exact: bool = False,
    patience_s: Seconds = PATIENCE_S,
    most: Annotated[int, AtLeast(1)] = 1,
) -> PlannerReport:
    """Check a planner against the oracle and the judge, as `examine_planner` does. Raises AssertionError with its
    faults.
    """
    __tracebackhide__ = True  # of pytest: the fault is the planner's
    report = examine_planner(
        plan,
        number=number,
        seed=seed,
        features=features,
        without=without,
        is_exact=is_exact,
        patience_s=patience_s,
        most=most,
    )
    if report.faults:
        raise AssertionError(f"the planner breaks promises\n{report}")
    return report


@checked
def examine_planner(
    plan: Planner,
    *,
    number: Annotated[int, AtLeast(1)] = 200,
    seed: Natural = 0,
    features: Collection[Feature] = (),
    without: Collection[Word] = (),
    is_exact: bool = False,
    patience_s: Seconds = PATIENCE_S,
    most: Annotated[int, AtLeast(1)] = 1,
) -> PlannerReport:
    """Let a planner answer `number` small problems and a large one, and report the promises that it breaks.

    The same `seed` draws the same problems. `features` are those that the planner knows: it must answer problems with
    no others, and may refuse the rest by InputError or answer them correctly. No problem has words of `without`. If it
    `is_exact`, it must prove each answer. The check ends after `most` different broken promises. A call that takes
    `patience_s` (seconds) longer than its time limit is abandoned; its thread keeps running.
    """
    bench = _Bench(plan, frozenset(features), is_exact, patience_s)
    random = Random(seed)
    faults: dict[Promise, PlannerFault] = {}
    for problem, limit_s in _cases(random, number, frozenset(without)):
        for fault in bench.faults(problem, limit_s):
            if fault.promise not in faults:
                faults[fault.promise] = bench.smallest(fault)
        if len(faults) >= most or Promise.TIME in faults:
            break
    if not faults and not {Status.OPTIMAL, Status.FEASIBLE} & bench.answers.keys():
        faults[Promise.FINDS] = PlannerFault(Promise.FINDS, f"none was found in {number} problems")
    return PlannerReport(tuple(faults.values()), dict(bench.answers))


def _cases(random: Random, number: int, without: frozenset[str]) -> Iterator[tuple[Problem, float | None]]:
    """Problems with time limits: small ones, some of them with no time at all, and a large one with little."""
    for at in range(number):
        if at == number // 2:
            yield drawn_library(random), _LARGE_LIMIT_S
        asked = random.sample(sorted(Feature), random.choice([0, 0, 1, 1, 2]))
        yield drawn_problem(random, frozenset(asked), without), 0.0 if at % 10 == 9 else None


class _Bench:
    """A planner with its claims; counts its answers."""

    def __init__(self, plan: Planner, features: frozenset[Feature], is_exact: bool, patience_s: float) -> None:
        self._plan, self._features, self._is_exact, self._patience_s = plan, features, is_exact, patience_s
        self.answers: Counter[str] = Counter()

    def faults(self, problem: Problem, limit_s: float | None) -> list[PlannerFault]:
        """The promises that the planner breaks with one problem; none if the oracle can't take it."""
        is_large = limit_s == _LARGE_LIMIT_S
        try:
            truth = None if is_large else exhaustive.plan(problem)
        except InputError:
            return []
        told: list[Progress] = []
        before = replace(problem)
        answer = self._answer(problem, limit_s, told)
        if not isinstance(answer, Plan):
            return [] if answer is None else [replace(answer, problem=problem, time_limit_s=limit_s)]
        self.answers[answer.status] += 1
        found = [*broken_promises(problem, answer, truth)]
        if truth is not None:
            found += _untrue_reports(problem, told, truth)
        if problem != before:
            found.append((Promise.PURE, "the problem is another one after the call"))
        if self._is_exact and limit_s is None and answer.status not in (Status.OPTIMAL, *REFUSED):
            found.append((Promise.PROVES, f"the answer is {answer.status}"))
        return [PlannerFault(promise, text, problem, answer, limit_s) for promise, text in found]

    def _answer(self, problem: Problem, limit_s: float | None, told: list[Progress]) -> Plan | PlannerFault | None:
        """A plan, the promise that is broken without one, or None for a problem that was rightly refused."""
        ended: SimpleQueue[Any] = SimpleQueue()

        def call() -> None:
            try:
                ended.put(self._plan(problem, time_limit_s=limit_s, report=told.append))
            except BaseException as error:  # of any kind: it is what the kit is to tell
                ended.put(error)

        threading.Thread(target=call, daemon=True, name="planner").start()
        began = time.monotonic()
        try:
            answer = ended.get(timeout=(limit_s or 0.0) + self._patience_s)
        except Empty:
            return PlannerFault(Promise.TIME, f"no answer after {time.monotonic() - began:.1f} s")
        if isinstance(answer, InputError):
            if problem.features <= self._features and limit_s != _LARGE_LIMIT_S:
                return PlannerFault(Promise.TAKES, f"it refused the problem: {answer}")
            self.answers["refused"] += 1
            return None
        if isinstance(answer, BaseException):
            return PlannerFault(Promise.ANSWERS, f"it raised {type(answer).__name__}: {answer}")
        if not isinstance(answer, Plan):
            return PlannerFault(Promise.ANSWERS, f"it returned {answer!r:.60}")
        return answer

    def smallest(self, fault: PlannerFault) -> PlannerFault:
        """Shrink the fault's problem until no part can be left out; unchanged if calls are slow or too many
        are needed.
        """
        counted = self.answers.copy()
        tried, is_smaller = 0, fault.promise is not Promise.TIME and fault.time_limit_s != _LARGE_LIMIT_S
        while is_smaller and tried < _MOST_SMALLER:
            is_smaller = False
            for problem in _smaller(fault.problem):
                tried += 1
                again = [one for one in self.faults(problem, fault.time_limit_s) if one.promise is fault.promise]
                if again:
                    fault, is_smaller = again[0], True
                    break
        self.answers = counted
        return fault


def broken_promises(problem: Problem, answer: Plan, truth: Plan | None) -> Iterator[tuple[Promise, str]]:
    """Each promise that an answer breaks, in words; `truth` is the oracle's answer, None if it is not known."""
    try:
        judged = plan_violations(problem, answer)
    except Exception as error:
        yield Promise.VALID, f"the judge can't read the plan: {type(error).__name__}: {error}"
        return
    for violation in judged:
        yield Promise.VALID, str(violation)
    if truth is None or judged:
        return
    if answer.status is Status.INFEASIBLE and truth.status is not Status.INFEASIBLE:
        yield Promise.STATUS, f"it says infeasible, but the oracle's answer is {truth.status}"
    if answer.status is Status.TOO_EXPENSIVE and truth.change_set is not None:
        yield Promise.STATUS, f"it says too expensive, but an update costs {truth.cost_us} us"
    if answer.change_set is not None and truth.change_set is None:
        yield Promise.STATUS, f"it has a plan that the judge accepts, but the oracle says {truth.status}"
        return
    used, most_used = len(answer.unused_required), len(truth.unused_required)
    if truth.cost_us is not None and used == most_used and not truth.objectives and answer.bound_us > truth.cost_us:
        yield Promise.BOUND, f"its bound is {answer.bound_us} us, but an update costs {truth.cost_us} us"
    if answer.change_set is None:
        return
    if answer.required_proven and used > most_used:
        yield Promise.REQUIRED, f"it leaves {used} unused, but {most_used} will do"
    if answer.status is Status.OPTIMAL and answer.rank[:-2] > truth.rank[:-2]:
        yield Promise.OPTIMAL, f"it costs {answer.cost_us} us, the oracle's {truth.cost_us} us{_unused(answer, truth)}"
    if answer.ties_proven and answer.rank[:-2] == truth.rank[:-2] and answer.rank > truth.rank:
        (*_, rewired, started), (*_, fewest, least) = answer.rank, truth.rank
        yield Promise.TIES, f"it rewires {rewired} and starts {started} units, but {fewest} and {least} will do"


def _unused(answer: Plan, truth: Plan) -> str:
    used = len(answer.unused_required), len(truth.unused_required)
    return "" if used[0] == used[1] else f"; it leaves {used[0]} required ones unused, the oracle {used[1]}"


def _untrue_reports(problem: Problem, told: list[Progress], truth: Plan) -> Iterator[tuple[Promise, str]]:
    """Yield each false progress report; if another objective precedes the cost, costs may be below the optimum."""
    if truth.cost_us is None or truth.objectives or problem.environment.required:
        return
    for progress in told:
        if progress.bound_us > truth.cost_us:
            yield Promise.REPORTS, f"a bound of {progress.bound_us} us was reported, the optimum is {truth.cost_us} us"
        if progress.cost_us is not None and progress.cost_us < truth.cost_us:
            yield Promise.REPORTS, f"a cost of {progress.cost_us} us was reported, the optimum is {truth.cost_us} us"


def _smaller(problem: Problem | None) -> Iterator[Problem]:
    """The problems with one part left out."""
    if problem is None:
        return
    environment = problem.environment
    for part in ("targets", "units", "library", "links", "hosts", "qualities"):
        whole = getattr(environment, part)
        for at in range(len(whole)):
            try:
                yield problem.with_parts(**{part: (*whole[:at], *whole[at + 1 :])})
            except InvalidValueError:  # something else names it
                continue
    if problem.max_cost_us is not None:
        yield replace(problem, max_cost_us=None)
    if problem.survive is not None:
        yield replace(problem, survive=None)
    if problem.horizon_s > 1:
        yield replace(problem, horizon_s=1)


# How problems are drawn.


def drawn_problem(random: Random, features: Collection[Feature] = (), without: Collection[str] = ()) -> Problem:
    """Return a small random problem that may use the features; its running units may be wired wrongly."""
    asked = frozenset(features) | ({Feature.HOSTS, Feature.QUALITY} if Feature.LATENCY in features else set())
    labels = [f"t{number}" for number in range(random.randint(1, 3 if asked else 5))]
    hosts = _hosts(random) if Feature.HOSTS in asked else ()
    qualities = _attributes(random) if Feature.QUALITY in asked else ()
    library: list[Transformation] = []
    for label in labels:
        given = [port.tag for transformation in library for port in transformation.outputs]
        library.append(_transformation(random, label, labels, given, hosts, qualities, asked, without))
    similarity = _similarity(random)
    targets = _targets(random, library, hosts, qualities, asked)
    survive = None
    if Feature.SURVIVAL in asked:
        survive = random.choice([Failures.UNITS, Failures.HOSTS if hosts else Failures.UNITS])
    is_running = "running" not in without and random.random() < 0.6
    units = _units(random, library, targets, hosts, similarity) if is_running else []
    max_cost_us = random.randint(0, 30) if "max_cost" not in without and random.random() < 0.3 else None
    minimise = random.sample(sorted(Objective), 2) if Feature.ORDER in asked else [Objective.COST]
    links = _links(random, qualities, asked) if len(hosts) > 1 else ()
    environment = Environment(
        tuple(units),
        tuple(library),
        tuple(targets),
        hosts,
        qualities,
        random.choice([0, 700_000]) if hosts else 0,
        links,
        tuple(minimise),
    )
    return Problem(environment, similarity, random.choice([0, 1, 1, 2, 10]), max_cost_us, survive)


def drawn_library(random: Random, *, size: int = 60) -> Problem:
    """Return a problem too large for the oracle: layers of transformations, each fed by the layer before."""
    layers = 6
    library = []
    for number in range(size):
        layer = number % layers
        needed = [f"L{layer - 1}.{random.randrange(3)}" for _ in range(random.randint(1, 3))] if layer else []
        inputs = tuple(InputPort(f"i{at}", tag) for at, tag in enumerate(needed))
        outputs = (OutputPort("x", f"L{layer}.{random.randrange(3)}"),)
        library.append(Transformation(f"t{number}", inputs, outputs, random.randint(1, 99), random.randint(1, 99)))
    tags = [f"L{layer}.{kind}" for layer in range(layers) for kind in range(3)]
    given = sorted({t.outputs[0].tag for t in library if t.outputs[0].tag.startswith(f"L{layers - 1}")})
    targets = tuple(Target(tag, tag, f"/{tag}") for tag in given)
    return Problem(Environment((), tuple(library), targets), Similarity({tag: frozenset({tag}) for tag in tags}), 10)


def _one_in(random: Random, number: int) -> bool:
    return random.randrange(number) == 0


def _similarity(random: Random) -> Similarity:
    """Every tag matches itself; some match others, in any direction."""
    rows = {tag: {tag} for tag in _TAGS}
    for _ in range(random.randint(0, 3)):
        rows[random.choice(_TAGS)].add(random.choice(_TAGS))
    return Similarity({tag: frozenset(row) for tag, row in rows.items()})


def _hosts(random: Random) -> tuple[Host, ...]:
    speeds, rents = [MICRO, MICRO, MICRO // 2, 3 * MICRO], [0, 0, 1, 4]
    hosts = (
        Host("h0", 9, 4, {"gpu": 1}, random.choice(speeds), ("a",), random.choice(rents)),
        Host("h1", 6, None, {"gpu": 3}, random.choice(speeds), ("a", "b"), random.choice(rents)),
        Host("h2", energy=random.choice([None, 1, 20])),
    )
    return hosts[: random.randint(1, 3)]


def _links(random: Random, qualities: tuple[QualityAttribute, ...], asked: Collection[Feature]) -> tuple[Link, ...]:
    between = random.choice([("a", "a"), ("h0", "not h0"), ("a", "h2")])
    link = Link(between, random.choice([None, 0, 1, 8]), random.choice([None, 0, 400_000]))
    slow = [attribute.name for attribute in qualities if attribute.better is Better.LOWER]
    if Feature.LATENCY in asked and slow:
        return (replace(link, latency=random.choice([1, 2, 5]), adds=random.choice(slow)),)
    return (link,) if _one_in(random, 2) else ()


def _attributes(random: Random) -> tuple[QualityAttribute, ...]:
    better = random.choice([*Better])
    worst, best = (20, random.choice([0, 2])) if better is Better.LOWER else (random.choice([0, 2]), 20)
    return (QualityAttribute("e", better, worst=worst, best=best),)


def _transformation(
    random: Random,
    label: str,
    labels: list[str],
    given: list[str],
    hosts: tuple[Host, ...],
    qualities: tuple[QualityAttribute, ...],
    asked: Collection[Feature],
    without: Collection[str],
) -> Transformation:
    """Return a transformation with two outputs and up to three inputs; most of these accept a tag in `given`."""
    more: dict[str, Any] = {}
    if hosts:
        names = [host.name for host in hosts]
        more["hosts"] = tuple(random.sample(names, random.randint(1, len(names)))) if _one_in(random, 3) else ()
        more["on"] = random.choice([None, None, None, "a", "not a"])
        more["needs"] = random.choice([{}, {}, {"gpu": 1}, {"power": 1}])
        more["memory_mb"] = random.choice([None, 1, 3])
    if Feature.CONFLICTS in asked:
        more["conflicts"] = tuple({random.choice(labels)} - {label}) if _one_in(random, 2) else ()
        more["conflicts_on_host"] = tuple({random.choice(labels)} - {label}) if _one_in(random, 2) else ()
    if Feature.BESIDE in asked and _one_in(random, 2):
        more["beside"] = (random.choice(labels),)
    if Feature.INSTANCES in asked:
        more["min_instances"] = random.choice([0, 0, 0, 1])
        more["max_instances"] = random.choice([None, 1, 2])
    if Feature.SURVIVAL in asked:
        more["standby_us"] = random.choice([None, 0, 1])
    ports = ("a", "b", "c")[: random.choice([0, 0, 1, 1, 2, 3]) if given else random.choice([0, 0, 0, 1])]
    return Transformation(
        label,
        tuple(_input(random, name, given, asked, without) for name in ports),
        tuple(_output(random, name, qualities, hosts, asked) for name in ("x", "y")[: random.choice([1, 1, 2])]),
        labor_us=random.choice([0, 1, 1, 2, 3, 5, 8]),
        upkeep_us=random.choice([0, 0, 1, 2, 3]),
        pinned="pinned" not in without and _one_in(random, 6),
        required="required" not in without and _one_in(random, 6),
        **more,
    )


def _input(
    random: Random, name: str, given: list[str], asked: Collection[Feature], without: Collection[str]
) -> InputPort:
    more: dict[str, Any] = {}
    if Feature.OPTIONAL in asked and _one_in(random, 2):
        more |= {"optional": True, "worth_us": random.choice([0, 1, 8])}
    if Feature.COUNTS in asked:
        more["count"] = random.choice([1, 2, ALL])
    group = "g" if "distinct" not in without and _one_in(random, 3) else None
    is_back = "feedback" not in without and _one_in(random, 6)
    tag = random.choice(given if given and random.random() < 0.8 else [*_TAGS])
    return InputPort(name, tag, group, is_back, **more)


def _output(
    random: Random,
    name: str,
    qualities: tuple[QualityAttribute, ...],
    hosts: tuple[Host, ...],
    asked: Collection[Feature],
) -> OutputPort:
    stated = []
    for attribute in qualities:
        rule = random.choice([*QualityRule])
        value = random.choice([0, MICRO // 2, MICRO]) if rule is QualityRule.SCALE else random.choice([0, 1, 3, 8])
        stated.append(Contribution(attribute.name, rule, value, random.choice([*Over])))
    rate, size = (random.choice([0, MICRO]), random.choice([0, 1, 3])) if hosts else (0, 0)
    serves = random.choice([None, 1, 2]) if Feature.LIMITS in asked else None
    return OutputPort(name, random.choice(_TAGS), tuple(stated), rate, size, serves)


def _targets(
    random: Random,
    library: list[Transformation],
    hosts: tuple[Host, ...],
    qualities: tuple[QualityAttribute, ...],
    asked: Collection[Feature],
) -> list[Target]:
    """Return one to three targets; the library may meet most of them."""
    given = sorted({port.tag for transformation in library for port in transformation.outputs})
    targets = []
    for number in range(random.choice([1, 1, 1, 2, 3])):
        wishes = tuple(Wish(each.name, random.choice([None, 3, 8]), random.choice([0, MICRO])) for each in qualities)
        at = random.choice(hosts).name if hosts and _one_in(random, 3) else None
        tag = random.choice(given if random.random() < 0.9 else [*_TAGS])
        targets.append(Target(f"q{number}", tag, f"/{number}", quality=wishes, host=at))
    if Feature.RUNS in asked:
        label = random.choice(library).label
        targets = [*targets[random.randint(0, 1) :], Target(f"a unit of {label}", run=label)]
    return targets


def _units(
    random: Random, library: list[Transformation], targets: list[Target], hosts: tuple[Host, ...], relation: Similarity
) -> list[ComputationUnit]:
    """Running units with gaps, dead feeders, unfit streams and stale topics; some of a transformation that left."""
    gone = Transformation("gone", (), (OutputPort("x", "A"),))
    kinds = [random.choice([*library, *library, gone]) for _ in range(random.randint(1, 3))]
    ids = [f"{kind.label}.{number}" for number, kind in enumerate(kinds, 1)]
    offered = [(p.tag, Stream(unit, p.name)) for unit, kind in zip(ids, kinds, strict=True) for p in kind.outputs]
    topics = [*(target.topic for target in targets if target.run is None), _TOPIC_OF_NOBODY]
    units = []
    for unit, kind in zip(ids, kinds, strict=True):
        feeds = []
        for port in kind.inputs:
            fit = [stream for tag, stream in offered if relation.holds(tag, port.tag)]
            unfit = [*(stream for _, stream in offered), Stream("t0.1", "x"), Stream("dead.1", "x"), None]
            stream = random.choice(fit if fit and random.random() < 0.7 else unfit)
            feeds += [] if stream is None else [Subscription(port.name, stream)]
        published = [Publication(random.choice(kind.outputs).name, topic) for topic in topics if _one_in(random, 2)]
        at = random.choice(hosts).name if hosts else None
        units.append(ComputationUnit(unit, kind.label, tuple(feeds), tuple(published), at))
    return units
