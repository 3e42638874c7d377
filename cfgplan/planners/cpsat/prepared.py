"""What preprocessing hands to the search."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Prepared:
    """What preprocessing leaves: labels that may be used, a first plan, its cost, a bound, landmarks.

    `usable_within` says which labels may be in a plan of at most some cost.
    """

    labels: list[str]
    plan: list[str] | None = None
    cost_us: int | None = None
    bound_us: int = 0
    landmarks: list[list[str]] = field(default_factory=list)
    counts: dict[str, int] = field(default_factory=dict)
    usable_within: Callable[[int], Collection[str]] | None = None
