"""Views of targets and units, made of the manager's immutable values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from cfgplan.domain import Environment, Stream, Target
from cfgplan_runtime.lifecycle.configuration import Situation
from cfgplan_runtime.lifecycle.reports import Decision, Review, TargetView, UnitView
from cfgplan_runtime.lifecycle.silence import Silence
from cfgplan_runtime.supervision.observation import Observation
from cfgplan_runtime.supervision.wiring import starved_units


def target_views(
    world: Environment, running: Environment, reviews: Sequence[Review], silences: Sequence[Silence], now_s: float
) -> tuple[TargetView, ...]:
    """Each target with the unit that meets it, and the stream on its topic, or why there is none."""
    starved = starved_units(running)
    fed = [unit for unit in running.units if unit.id not in starved]
    meeting = world.meeting(fed)
    streams = {p.topic: Stream(unit.id, p.port) for unit in fed for p in unit.publications}
    reasons = reviews[-1].unmet if reviews else {}
    silent = {silence.target: silence_reason(silence, now_s) for silence in silences if silence.topic in streams}

    def reason(target: Target) -> str:
        if target.label in meeting:
            return silent.get(target.label, "")
        return reasons.get(target.label, "it waits for a review")

    return tuple(
        TargetView(
            target.label,
            target.tag,
            target.topic,
            target.priority,
            streams.get(target.topic),
            reason(target),
            target.label in silent,
            unit.id if (unit := meeting.get(target.label)) else None,
        )
        for target in world.targets
    )


def silence_reason(silence: Silence, now_s: float) -> str:
    """The reason why a silent target counts as unmet."""
    return f"nothing has come from {silence.stream} for {now_s - silence.since_s:.0f} s"


def unit_views(
    running: Environment, situation: Situation, observations: Mapping[str, Observation]
) -> tuple[UnitView, ...]:
    """Each running unit and cold spare, with its host and its last observation."""
    units = situation.units
    return tuple(
        UnitView(
            unit,
            known.host if (known := units.get(unit.id)) else unit.host,
            observations.get(unit.id),
            unit.standby and unit.id in situation.prepared,
        )
        for unit in running.units
    )


def saving_us(reviews: Sequence[Review]) -> int:
    """The saving of the update that the last review has put off, in microseconds of CPU time; 0 without one."""
    last = reviews[-1] if reviews else None
    if last is None or last.decision is not Decision.DEFERRED or last.cost_us is None:
        return 0
    return max(0, last.cost_before_us - last.cost_us)
