"""Perturbations that no review has answered yet."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from math import inf

from cfgplan_runtime.lifecycle.inbox import Outcome
from cfgplan_runtime.lifecycle.perturbations import Perturbation, UpdateFailed


@dataclass(frozen=True)
class Entry:
    """A perturbation, when it was noticed, when a review is due, and who waits for that review."""

    perturbation: Perturbation
    at_s: float
    due_s: float
    outcomes: tuple[Outcome, ...] = ()


class Pending:
    """The perturbations since the last review. Only the manager's thread changes them; any may look."""

    def __init__(self) -> None:
        self.entries: tuple[Entry, ...] = ()
        self._waiting: dict[str, list[Outcome]] = {}

    def add(
        self, perturbation: Perturbation, at_s: float, outcomes: Iterable[Outcome] = (), *, due_s: float | None = None
    ) -> None:
        entry = Entry(perturbation, at_s, at_s if due_s is None else due_s, tuple(outcomes))
        self.entries = (*self.entries, entry)

    def take(self) -> tuple[Entry, ...]:
        """All of them, due or not: they make one review."""
        entries, self.entries = self.entries, ()
        return entries

    def put_back(self, entries: tuple[Entry, ...]) -> None:
        """They were not answered after all."""
        self.entries = (*entries, *self.entries)

    @property
    def due_s(self) -> float:
        """When the next review is due; inf if there is no perturbation."""
        return min((entry.due_s for entry in self.entries), default=inf)

    def wait_for(self, unit: str, outcome: Outcome) -> None:
        """Somebody waits for the review that follows a unit's end."""
        self._waiting.setdefault(unit, []).append(outcome)

    @property
    def is_empty(self) -> bool:
        """Whether nothing is pending but what a faulty middleware is asked again, and no end of a unit is awaited."""
        faults = (isinstance(each.perturbation, UpdateFailed) and each.perturbation.is_fault for each in self.entries)
        return all(faults) and not self._waiting

    def waiting_for(self, unit: str) -> tuple[Outcome, ...]:
        """Those who wait for a unit's end, which has come."""
        return tuple(self._waiting.pop(unit, ()))

    def give_up(self, error: Exception) -> None:
        """Nothing will be reviewed any more: tell all who wait."""
        waiting = [outcome for outcomes in self._waiting.values() for outcome in outcomes]
        self._waiting.clear()
        for outcome in [*waiting, *(outcome for entry in self.take() for outcome in entry.outcomes)]:
            outcome.set_exception(error)
