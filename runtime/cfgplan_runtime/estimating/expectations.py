"""Expected costs of a transformation: from its own observations, else from its family's, else a guess."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

from cfgplan_runtime.estimating.evidence import Evidence
from cfgplan_runtime.estimating.forecasters import Average, Damped, Forecast, Forecaster
from cfgplan_runtime.estimating.guesses import CostKind, Costs, Guess
from cfgplan_runtime.estimating.settings import Learning


class Origin(StrEnum):
    """The source of an expectation."""

    GUESS = "guess"
    FAMILY = "family"
    OBSERVED = "observed"


@dataclass(frozen=True, slots=True)
class Expectation:
    """A forecast in microseconds (upkeep: per second), and its source."""

    forecast: Forecast
    origin: Origin


class Expectations:
    """Makes expectations from evidence. `forecaster` makes the forecaster of upkeep from its memory; with None,
    observed costs do not count.
    """

    def __init__(self, forecaster: Callable[[float], Forecaster] | None, guess: Guess, settings: Learning) -> None:
        self._learns = forecaster is not None
        self._guess = guess
        self._settings = settings
        self._levels: dict[tuple[int, CostKind], tuple[Evidence, int, float]] = {}
        self._forecasters = {
            "labor": Damped(Average(settings.memory_starts)),
            "upkeep": Damped((forecaster or Average)(settings.memory_s)),
        }

    def of(
        self, kind: CostKind, own: Evidence, relatives: Iterable[Evidence], largest: Costs, now_s: float
    ) -> Expectation:
        """The forecast of one quantity of a transformation from `now_s` on."""
        if self._learns and own.samples(kind):
            return Expectation(self._observed(kind, own, largest, now_s), Origin.OBSERVED)
        known = [one for one in relatives if self._learns and one.samples(kind)]
        if known:
            return Expectation(Forecast(self._familiar(kind, own, known), 0.0), Origin.FAMILY)
        return Expectation(Forecast(self._guess(own.declared_costs, largest).of(kind), 0.0), Origin.GUESS)

    def _level(self, kind: CostKind, evidence: Evidence) -> float:
        """The observed level of a relative, cached because all its relatives read it."""
        known, changes, level = self._levels.get((id(evidence), kind), (None, 0, 0.0))
        if known is not evidence or changes != evidence.changes:
            level = self._forecasters[kind](evidence.samples(kind)).level
            self._levels[id(evidence), kind] = (evidence, evidence.changes, level)
        return level

    def _observed(self, kind: CostKind, own: Evidence, largest: Costs, now_s: float) -> Forecast:
        """The forecast from observations. Without new observations it moves towards the guess, and its trend ends."""
        forecast = self._forecasters[kind](own.samples(kind))
        idle_s = max(0.0, now_s - own.seen_s)
        guess = self._guess(own.declared_costs, largest).of(kind)
        return replace(
            forecast,
            level=guess + (forecast.level - guess) * 0.5 ** (idle_s / self._settings.forget_s),
            slope=forecast.slope * 0.5 ** (idle_s / self._settings.memory_s),
            low=min(guess, forecast.low),
            high=max(guess, forecast.high),
        )

    def _familiar(self, kind: CostKind, own: Evidence, known: Sequence[Evidence]) -> float:
        """The mean cost of relatives. If all of them declare costs, it is scaled by the declared ones."""
        levels = [self._level(kind, one) for one in known]
        declared = [one.declared_costs.of(kind) for one in known]
        mean = sum(levels) / len(levels)
        if own.declared_costs.of(kind) and all(declared):
            return own.declared_costs.of(kind) * mean * len(levels) / sum(declared)
        return mean
