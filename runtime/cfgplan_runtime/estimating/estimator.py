"""Estimates of labor and upkeep, learned from observations, in the form that planners need (paper, section IV-C)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from types import MappingProxyType

from cfgplan import costs
from cfgplan.costs import LARGEST_COST_US
from cfgplan.domain import Host, Transformation
from cfgplan.qualities import MICRO
from cfgplan_runtime.estimating.evidence import Evidence, declaration, family
from cfgplan_runtime.estimating.expectations import Expectations, Origin
from cfgplan_runtime.estimating.forecasters import FORECASTERS, Forecaster, Trend
from cfgplan_runtime.estimating.guesses import GUESSES, Costs, Guess, declared
from cfgplan_runtime.estimating.settings import Learning
from cfgplan_runtime.supervision.observation import Observation

_SHORTEST_RUN_S = 1e-3
"""Two observations of a unit within this time count as one."""

_REFRESHES = 200
"""How often an estimate is updated without observations, per half-life `forget_s`."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """The expected cost of a unit of a transformation, in microseconds (upkeep and failing: per second).

    `running_us` is the mean upkeep over the horizon, `failing_us` the expected cost of failures.
    """

    labor_us: int
    running_us: int
    failing_us: int
    labor_origin: Origin
    upkeep_origin: Origin

    @property
    def upkeep_us(self) -> int:
        return self.running_us + self.failing_us


@dataclass(frozen=True, slots=True)
class _Made:
    """An estimate, with the evidence that it was made from."""

    estimate: Estimate
    basis: tuple[object, ...]
    horizon_s: int
    at_s: float


@dataclass(slots=True)
class _Family:
    """The transformations of one template; `changes` counts the observations of all of them."""

    members: dict[str, Evidence] = field(default_factory=dict)
    changes: int = 0
    _observed: tuple[Evidence, ...] = ()
    _observed_changes: int = -1

    def observed(self) -> tuple[Evidence, ...]:
        """The members with observations."""
        if self._observed_changes != self.changes:
            self._observed = tuple(one for one in self.members.values() if not one.is_empty)
            self._observed_changes = self.changes
        return self._observed


class LearningEstimator:
    """Learns the costs of each transformation's units, and the costs of their failures.

    Units of one transformation share an estimate, on each host by itself. `forecaster` forecasts upkeep; with None the
    costs are those of `guess`, and only failures are learned. Times `now_s` are in seconds on any one monotonic clock.
    """

    def __init__(
        self,
        forecaster: Callable[[float], Forecaster] | None = Trend,
        guess: Guess = declared,
        settings: Learning | None = None,
    ) -> None:
        self.settings = settings or Learning()
        self.evidence: dict[str, Evidence] = {}
        self.on_hosts: dict[str, LearningEstimator] = {}
        """The estimators of hosts, by name."""
        self._forecaster, self._guess = forecaster, guess
        self._scaled: dict[tuple[str, str], tuple[Transformation, Host, Transformation]] = {}
        self._expectations = Expectations(forecaster, guess, self.settings)
        self._units: dict[str, tuple[Observation, float]] = {}
        self._families: dict[str, _Family] = {}
        self._declared: dict[str, Transformation] = {}
        self._largest = Costs(0, 0)
        self._made: dict[str, _Made] = {}
        self._now_s = 0.0

    def observe(self, observations: Sequence[Observation], now_s: float) -> None:
        """Learn from the running units; upkeep is the CPU time that each has used since the last call.

        The CPU time of a silent unit counts only once its next element comes. If a middleware does not count a unit's
        CPU time (`cpu_us` is 0), the observation's `upkeep_us` is used.
        """
        before, self._units, self._now_s = self._units, {}, now_s
        here = [seen for seen in observations if seen.host is None]
        for host in {seen.host for seen in observations if seen.host is not None} | self.on_hosts.keys():
            self.at(host).observe([replace(seen, host=None) for seen in observations if seen.host == host], now_s)
        for seen in here:
            last, since_s = before.get(seen.unit, (None, now_s))
            ran_s = now_s - since_s
            if last is None or not _is_same_process(last, seen):
                if _given(seen) != 0:
                    self._units[seen.unit] = (seen, now_s)
                    with self._learning(seen.transformation) as evidence:
                        evidence.started(seen.labor_us, now_s)
            elif ran_s < _SHORTEST_RUN_S or (_given(seen) is not None and _given(seen) == _given(last)):
                self._units[seen.unit] = (last, since_s)
            else:
                self._units[seen.unit] = (seen, now_s)
                upkeep_us = (seen.cpu_us - last.cpu_us) / ran_s if seen.cpu_us else seen.upkeep_us
                if upkeep_us is not None:
                    with self._learning(seen.transformation) as evidence:
                        evidence.ran(since_s, now_s, upkeep_us)
        # Now there is time for it; at the next perturbation there is none.
        for label in sorted({seen.transformation for seen, _ in self._units.values()} & self._made.keys()):
            self.estimate(self._declared[label], self._made[label].horizon_s)

    def failed(self, transformation: str, now_s: float, host: str | None = None) -> None:
        """Learn that a unit could not start, died, hung or kept failing. Call it once per unit.

        It counts for the unit's host, or for all hosts if that is None.
        """
        self._now_s = now_s
        if host is not None:
            self.at(host).failed(transformation, now_s)
            return
        for there in self.on_hosts.values():
            there.failed(transformation, now_s)
        with self._learning(transformation) as evidence:
            evidence.failed(now_s)

    def at(self, host: str) -> LearningEstimator:
        """The estimator of a host."""
        if host not in self.on_hosts:
            self.on_hosts[host] = LearningEstimator(self._forecaster, self._guess, self.settings)
        return self.on_hosts[host]

    def labor_us(self, transformation: Transformation, horizon_s: int, host: Host | None = None) -> int:
        """The CPU time of one start, in microseconds."""
        return self._estimate_on(host, transformation, horizon_s).labor_us

    def upkeep_us(self, transformation: Transformation, horizon_s: int, host: Host | None = None) -> int:
        """The CPU time per second, in microseconds: the mean over the horizon plus the cost of failures, rounded half
        up.
        """
        return self._estimate_on(host, transformation, horizon_s).upkeep_us

    def estimated(self, library: Iterable[Transformation], horizon_s: int) -> tuple[Transformation, ...]:
        """The library with estimated instead of declared costs."""
        known = tuple(library)
        for transformation in known:
            self._declare(transformation)
        return tuple(_with_costs(one, self.estimate(one, horizon_s)) for one in known)

    def estimate(self, transformation: Transformation, horizon_s: int) -> Estimate:
        """The expected cost of a unit of a transformation that has its declared costs.

        The estimate changes only if the costs have moved by more than noise explains, so that noise causes no new plan.
        """
        own = self._declare(transformation)
        label = transformation.label
        counts = own.changes if own.is_known else self._families[family(label)].changes
        basis = (own.declared, horizon_s, self._largest, own.is_known, counts)
        made = self._made.get(label)
        if made and made.basis == basis and self._now_s - made.at_s < self.settings.forget_s / _REFRESHES:
            return made.estimate
        last = made.estimate if made and made.basis[:2] == basis[:2] else None
        members = () if own.is_known else self._families[family(label)].observed()
        relatives = [one for one in members if one.source == own.source]
        estimate = self._fresh(own, relatives, horizon_s, last)
        self._made[label] = _Made(estimate, basis, horizon_s, self._now_s)
        if estimate.upkeep_origin == Origin.OBSERVED:
            self._widen(estimate.labor_us, estimate.running_us)
        return estimate

    def _estimate_on(self, host: Host | None, transformation: Transformation, horizon_s: int) -> Estimate:
        """The cost of a unit on a host; without samples of this host the cost on other hosts, scaled by the hosts'
        speeds.
        """
        if host is None:
            return self.estimate(transformation, horizon_s)
        label, there = transformation.label, self.at(host.name)
        own = there.estimate(self._declared_on(host, transformation), horizon_s)
        if there.evidence[label].is_known:
            return own
        known = [
            (self._scaled[name, label][1].speed, other.estimate(other._declared[label], horizon_s))
            for name, other in self.on_hosts.items()
            if (name, label) in self._scaled and label in other._declared and other.evidence[label].is_known
        ]
        if not known:
            return own
        labor = sum(speed * seen.labor_us for speed, seen in known) / len(known) / host.speed
        running = sum(speed * seen.running_us for speed, seen in known) / len(known) / host.speed
        return replace(own, labor_us=round(labor), running_us=round(running))

    def _declared_on(self, host: Host, transformation: Transformation) -> Transformation:
        """A transformation with its declared costs scaled to a host; the same object while transformation and host stay
        the same.
        """
        key = host.name, transformation.label
        if key not in self._scaled or self._scaled[key][0] is not transformation or self._scaled[key][1] != host:
            there = transformation
            if host.speed != MICRO:
                there = replace(there, labor_us=costs.labor_us(there, host), upkeep_us=costs.upkeep_us(there, host))
            self._scaled[key] = transformation, host, there
        return self._scaled[key][2]

    def take_over(self, evidence: Mapping[str, Evidence]) -> None:
        """Continue with earlier evidence, whose times are on this estimator's clock."""
        for label, one in evidence.items():
            self._keep(label, one)
        self._made.clear()
        self._declared.clear()

    def _fresh(self, own: Evidence, relatives: Iterable[Evidence], horizon_s: int, last: Estimate | None) -> Estimate:
        labor = self._expectations.of("labor", own, relatives, self._largest, self._now_s)
        upkeep = self._expectations.of("upkeep", own, relatives, self._largest, self._now_s)
        failing = own.failures.rate(self._now_s) * (labor.forecast.level + self.settings.failure_us)
        old = (
            last.labor_us if last and last.labor_origin == labor.origin else None,
            last.running_us if last and last.upkeep_origin == upkeep.origin else None,
            last.failing_us if last and failing else None,
        )
        # As many units as there may be must add up to what can be computed exactly.
        most_us = LARGEST_COST_US // (8 * len(self.evidence) * max(1, horizon_s))
        settled = self.settings.settled
        # Their price rises with each failure, and falls when it has fallen by more than a Poisson process explains.
        falls = old[2] is not None and failing < old[2]
        failing_error = failing / max(1.0, own.failures.failures) ** 0.5 if falls else 0.0
        return Estimate(
            min(most_us, settled(old[0], labor.forecast.level, labor.forecast.error)),
            min(most_us, settled(old[1], upkeep.forecast.mean(horizon_s), upkeep.forecast.error)),
            min(most_us, settled(old[2], failing, failing_error)),
            labor.origin,
            upkeep.origin,
        )

    def _declare(self, transformation: Transformation) -> Evidence:
        """The evidence about a transformation; it is empty if the declaration has changed."""
        own = self._evidence_of(transformation.label)
        if self._declared.get(transformation.label) is transformation:
            return own
        self._declared[transformation.label] = transformation
        says = declaration(transformation)
        if own.declared != says:
            fresh = self._nothing() if own.declared else own
            fresh.declared, fresh.source = says, transformation.source
            fresh.labor_us, fresh.upkeep_us = transformation.labor_us, transformation.upkeep_us
            self._keep(transformation.label, fresh)
            return fresh
        return own

    def _evidence_of(self, label: str) -> Evidence:
        if label not in self.evidence:
            self._keep(label, self._nothing())
        return self.evidence[label]

    def _nothing(self) -> Evidence:
        return Evidence("", None, 0, 0, self.settings.labor(), self.settings.upkeep(), self.settings.failures())

    def _keep(self, label: str, evidence: Evidence) -> None:
        relatives = self._families.setdefault(family(label), _Family())
        relatives.changes += 1
        self.evidence[label] = relatives.members[label] = evidence
        self._widen(evidence.labor_us, evidence.upkeep_us)

    @contextmanager
    def _learning(self, label: str) -> Iterator[Evidence]:
        """Give the evidence about a transformation, to be extended."""
        evidence = self._evidence_of(label)
        before = evidence.changes
        yield evidence
        self._families[family(label)].changes += evidence.changes - before

    def _widen(self, labor_us: float, upkeep_us: float) -> None:
        self._largest = Costs(max(self._largest.labor_us, labor_us), max(self._largest.upkeep_us, upkeep_us))


ESTIMATORS: Mapping[str, Callable[[float], Forecaster] | None] = MappingProxyType({"declared": None, **FORECASTERS})
"""The forecasters of upkeep by name. With `declared`, upkeep is that of the environment file, and only failures are
learned.
"""


def make_estimator(name: str = "trend", guess: str = "declared", settings: Learning | None = None) -> LearningEstimator:
    """An estimator by one of the names of ESTIMATORS and one of GUESSES."""
    return LearningEstimator(ESTIMATORS[name], GUESSES[guess], settings)


def _given(seen: Observation) -> int | None:
    """The number of elements that a unit has sent; None if it has no output, or the middleware does not count them."""
    return sum(counts.elements for counts in seen.outputs.values()) if seen.outputs else None


def _is_same_process(last: Observation, seen: Observation) -> bool:
    """Whether two observations are of one process, not of two processes with one unit id."""
    return (last.transformation, last.labor_us) == (seen.transformation, seen.labor_us) and seen.cpu_us >= last.cpu_us


def _with_costs(transformation: Transformation, estimate: Estimate) -> Transformation:
    """The transformation with the estimated costs; the same object if they equal the declared ones."""
    if (transformation.labor_us, transformation.upkeep_us) == (estimate.labor_us, estimate.upkeep_us):
        return transformation
    return replace(transformation, labor_us=estimate.labor_us, upkeep_us=estimate.upkeep_us)
