"""The answers of units to the questions of hand-overs, and the doubts that later answers settle."""

from __future__ import annotations

from collections.abc import Mapping

from cfgplan_runtime.streams.element import Moment
from cfgplan_runtime.supervision.commands import AskPlaces, AskState, Doubt
from cfgplan_runtime.supervision.events import PlacesTold, StateNotExact, StateTold


class HandoverAnswers:
    """The last answers of the units that take part in hand-overs of states."""

    def __init__(self) -> None:
        self._places: dict[str, Mapping[str, Moment]] = {}
        self._states: dict[str, StateTold] = {}
        self._doubts: dict[str, Doubt] = {}

    def places(self, unit: str) -> Mapping[str, Moment] | None:
        """The places that a unit was last asked for; None if it has not told them."""
        return self._places.get(unit)

    def state(self, unit: str) -> StateTold | None:
        """The state that a unit was last asked for; None if it has not told it."""
        return self._states.get(unit)

    def ask(self, question: AskPlaces | AskState) -> None:
        """Forget the unit's answer to the last question of this kind."""
        (self._states if isinstance(question, AskState) else self._places).pop(question.unit, None)

    def note(self, answer: PlacesTold | StateTold) -> None:
        """Keep a unit's answer."""
        if isinstance(answer, StateTold):
            self._states[answer.unit] = answer
        else:
            self._places[answer.unit] = answer.moments

    def doubt(self, doubt: Doubt) -> None:
        """Keep a doubt until `settled`."""
        self._doubts[doubt.event.unit] = doubt

    def settled(self, unit: str) -> StateNotExact | None:
        """The event of a unit's doubt, once its places are known, if they show that elements are missing."""
        doubt, places = self._doubts.get(unit), self._places.get(unit)
        if doubt is None or places is None:
            return None
        del self._doubts[unit]
        is_late = any(moment > doubt.unless[name] for name, moment in places.items() if name in doubt.unless)
        return doubt.event if is_late else None

    def forget(self, unit: str) -> None:
        """Forget a unit that is gone."""
        self._places.pop(unit, None)
        self._states.pop(unit, None)
        self._doubts.pop(unit, None)
