"""What preprocessing hands to the search."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Prepared:
    """What preprocessing leaves: labels that may be used, a first plan, its cost, a bound, landmarks.

    Of a landmark's labels, of which those count twice that are in it twice, a plan has so many or more.
    A plan that costs as little as the bound rewires and starts at least `fewest_changes` units, if these are known.
    With `is_complete` no other labels can be in a better plan. If `holds_for` is given, all that is so for plans that
    leave no more required transformations unused.
    """

    labels: list[str]
    plan: list[str] | None = None
    cost_us: int | None = None
    bound_us: int = 0
    landmarks: Callable[[], list[tuple[list[str], int]]] = list
    counts: dict[str, int] = field(default_factory=dict)
    holds_for: int | None = None
    fewest_changes: tuple[int, int] | None = None
    is_complete: bool = True
