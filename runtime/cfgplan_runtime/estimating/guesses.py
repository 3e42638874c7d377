"""Guesses of the costs of transformations without observations: exploit the known ones, or explore all."""

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
    """Guesses costs from the declared costs, and from the largest labor and upkeep known."""

    def __call__(self, declared: Costs, largest: Costs) -> Costs: ...


def declared(declared: Costs, largest: Costs) -> Costs:  # noqa: ARG001
    """The costs that the environment file declares."""
    return declared


def optimistic(declared: Costs, largest: Costs) -> Costs:  # noqa: ARG001
    """Zero costs, so that every transformation is tried once."""
    return Costs(0, 0)


def pessimistic(declared: Costs, largest: Costs) -> Costs:
    """Twice the largest costs, so that only necessary transformations are tried."""
    labor_us = 2 * max(declared.labor_us, largest.labor_us)
    return Costs(labor_us, 2 * max(declared.upkeep_us, largest.upkeep_us))


GUESSES: Mapping[str, Guess] = MappingProxyType(
    {"declared": declared, "optimistic": optimistic, "pessimistic": pessimistic}
)
