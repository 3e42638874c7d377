"""The truth of a program's propositions in a state, by the conditions in them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from cfgplan_runtime.reasoning.conditions import Condition, FeatureValues, NoValueError, UnsuitableValueError
from cfgplan_runtime.reasoning.program import Program, truth_of
from cfgplan_runtime.reasoning.regions import Region
from cfgplan_runtime.reasoning.truth import FALSE, TRUE, UNKNOWN, Truth

_MOST_TOLD = 12


class Evaluator:
    """Decides the propositions of a program; `tell` is called once for each sort of unsuitable value."""

    def __init__(self, program: Program, regions: Mapping[str, Region], tell: Callable[[str], None]) -> None:
        self._propositions = program.propositions
        self._regions = regions
        self._tell = tell
        self._told: set[str] = set()
        self.last: Mapping[object, Truth] = {}
        """The truth of each condition that mattered in the last state."""

    def truths(self, features: Mapping[str, Any]) -> Sequence[Truth]:
        """The truth of each proposition in a state; a feature without a value is missing."""
        values = FeatureValues(features, self._regions)
        known: dict[object, Truth] = {}

        def atom(condition: Any) -> Truth:
            if condition not in known:
                known[condition] = self._truth(condition, values)
            return known[condition]

        found = [truth_of(proposition, atom) for proposition in self._propositions]
        self.last = known
        return found

    def _truth(self, condition: Condition, values: FeatureValues) -> Truth:
        try:
            return TRUE if condition.holds(values) else FALSE
        except NoValueError:
            return UNKNOWN
        except UnsuitableValueError as error:
            text = f"{condition} is unknown where {error}"
            if text not in self._told and len(self._told) < _MOST_TOLD:
                self._told.add(text)
                self._tell(text)
            return UNKNOWN
