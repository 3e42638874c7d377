"""What is expected of a transformation of which nothing was observed: exploit what is known, or explore."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal, Protocol, TypeAlias

CostKind: TypeAlias = Literal["labor", "upkeep"]


@dataclass(frozen=True, slots=True)
class Costs:
    """Labor in microseconds, upkeep in microseconds per second."""

    labor_us: float
    upkeep_us: float

    def of(self, kind: CostKind) -> float:
        return self.labor_us if kind == "labor" else self.upkeep_us


class Guess(Protocol):
    """From what is declared, and the dearest labor and upkeep known so far, to what is expected."""

    def __call__(self, declared: Costs, dearest: Costs) -> Costs: ...


def declared(declared: Costs, dearest: Costs) -> Costs:  # noqa: ARG001
    """What the environment file says."""
    return declared


def optimistic(declared: Costs, dearest: Costs) -> Costs:  # noqa: ARG001
    """Free: so everything is tried once."""
    return Costs(0, 0)


def pessimistic(declared: Costs, dearest: Costs) -> Costs:
    """Twice as dear as the dearest: only what can't be done without is tried."""
    labor_us = 2 * max(declared.labor_us, dearest.labor_us)
    return Costs(labor_us, 2 * max(declared.upkeep_us, dearest.upkeep_us))


GUESSES: Mapping[str, Guess] = MappingProxyType(
    {"declared": declared, "optimistic": optimistic, "pessimistic": pessimistic}
)
