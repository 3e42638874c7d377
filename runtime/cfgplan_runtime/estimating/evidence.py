"""The observations of the units of one transformation."""

from __future__ import annotations

import hashlib

import msgspec

from cfgplan.domain import Transformation
from cfgplan_runtime.estimating.guesses import CostKind, Costs
from cfgplan_runtime.estimating.history import CostSample, FailureHistory, History, NotNegative, Second


class Evidence(msgspec.Struct):
    """The observations of one transformation, with its declaration at that time. After a change of the declaration they
    no longer count.

    Labor has one sample per start, at 1, 2, 3, ...; upkeep is over time on the estimator's clock, in seconds.
    """

    declared: str
    source: str | None
    labor_us: NotNegative
    upkeep_us: NotNegative
    labor: History
    upkeep: History
    failures: FailureHistory
    starts: int = 0
    seen_s: Second = 0.0
    """The time of the last observation."""
    changes: int = 0
    """Counts samples and failures, so that earlier forecasts are known to be stale. An observation that becomes part of
    an existing sample does not count.
    """

    @property
    def declared_costs(self) -> Costs:
        return Costs(self.labor_us, self.upkeep_us)

    @property
    def is_known(self) -> bool:
        """Whether labor and upkeep were both observed."""
        return bool(self.labor.samples and self.upkeep.samples)

    @property
    def is_empty(self) -> bool:
        return not (self.labor.samples or self.upkeep.samples or self.failures.failures)

    @property
    def is_in_order(self) -> bool:
        """Whether the samples can have come from observations; samples from a file may not."""
        starts_fit = not self.labor.samples or self.labor.samples[-1].until <= self.starts
        times_fit = not self.upkeep.samples or self.upkeep.samples[-1].until <= self.seen_s + 1e-3
        return starts_fit and times_fit and self.labor.is_in_order and self.upkeep.is_in_order

    def samples(self, kind: CostKind) -> list[CostSample]:
        return (self.labor if kind == "labor" else self.upkeep).samples

    def started(self, labor_us: float, now_s: float) -> None:
        self._note(now_s)
        self.starts += 1
        self.labor.add(self.starts, self.starts, labor_us, 1.0)

    def ran(self, since_s: float, now_s: float, upkeep_us: float) -> None:
        self.changes += self.upkeep.add(since_s, now_s, upkeep_us, now_s - since_s)
        self.failures.ran(now_s - since_s, now_s)
        self.seen_s = now_s

    def failed(self, now_s: float) -> None:
        self._note(now_s)
        self.failures.failed(now_s)

    def moved(self, by: float) -> Evidence:
        """The same evidence on a clock that is ahead by `by` seconds."""
        upkeep, failures = self.upkeep.moved(by), self.failures.moved(by)
        return msgspec.structs.replace(self, upkeep=upkeep, failures=failures, seen_s=self.seen_s + by)

    def _note(self, now_s: float) -> None:
        self.changes += 1
        self.seen_s = now_s


def family(label: str) -> str:
    """The name before the bracket: transformations of one template, such as `segmenter(piff)`, form a family."""
    name, bracket, _ = label.partition("(")
    return name.strip() if bracket and name.strip() else label


def declaration(transformation: Transformation) -> str:
    """A digest of everything that a transformation's costs depend on. Evidence counts only while the digest stays the
    same.
    """
    params = {name: transformation.params[name] for name in sorted(transformation.params)}
    parts = (
        transformation.source,
        transformation.host,
        params,
        transformation.run.rate_hz,
        transformation.labor_us,
        transformation.upkeep_us,
    )
    return hashlib.sha256(repr(parts).encode()).hexdigest()[:16]
