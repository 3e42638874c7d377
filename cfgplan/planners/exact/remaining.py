"""The labels that bounds have not ruled out: a better plan contains only these."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from cfgplan.planners.networks.core import Ints
from cfgplan.planners.networks.network import Network
from cfgplan.planners.solving.arrays import np

if TYPE_CHECKING:
    from cfgplan.planners.bounding.bounds import Bound


@dataclass(frozen=True)
class Remaining:
    """The labels, by their numbers in a network, that bounds have not ruled out, and a lower bound `value` on weights.

    With `is_complete` no other labels can be in a better plan. With `holds_for` all this holds only for plans that
    leave at most so many required transformations unused. `bound` has the landmarks.
    """

    labels: Sequence[int] | Ints
    value: int
    bound: Bound | None = None
    is_complete: bool = True
    holds_for: int | None = None

    @classmethod
    def by(cls, bound: Bound, limit: int) -> Remaining:
        """The labels that a plan of weight `limit` or less can contain."""
        return cls(bound.core.labels[bound.may_be_used(limit)], bound.value, bound)

    def names(self, network: Network) -> list[str]:
        """The labels of the transformations that are left."""
        return [network.labels[i] for i in self.labels]

    def landmarks(self, network: Network) -> list[tuple[list[str], int]]:
        """Short landmarks for plans that have no other labels, as (labels, number).

        A plan has so many of the labels or more, a label counts as often as it is named.
        """
        if self.bound is None:
            return []
        part = self.bound.restricted(np.isin(self.bound.core.labels, self.labels))
        return [*named_landmarks(part, network, is_short=True)]


def named_landmarks(bound: Bound, network: Network, *, is_short: bool) -> Iterator[tuple[list[str], int]]:
    """Yield the landmarks of a bound, or only short ones, as (labels, number)."""
    for one in bound.short() if is_short else bound.landmarks:
        yield [network.labels[i] for i in bound.core.labels[one.counted].tolist()], one.least
