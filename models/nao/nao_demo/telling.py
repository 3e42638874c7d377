"""Describes the results of a step in words and figures, for the terminal and the page."""

from __future__ import annotations

from collections.abc import Iterator
from decimal import Decimal

from cfgplan_runtime.lifecycle.perturbations import Perturbation, SubscriptionLost, UnitGone, WorldChanged
from cfgplan_runtime.lifecycle.reports import PHASES, Decision

from cfgplan.costs import keep_cost_us
from nao_demo.played import Played

_PHASE_WORDS = {
    "detect": "gathered",
    "match": "matched",
    "estimate": "estimated",
    "plan": "planned",
    "judge": "judged",
    "apply": "carried out",
}


def cpu(cost_us: int) -> str:
    """Format a cost in microseconds, rounded to hundredths of a CPU second: `20.55 s`."""
    return f"{Decimal(cost_us) / 1_000_000:.2f} s"


def span(seconds: float) -> str:
    """Format a duration: `3.2 ms`, `48 ms`, `1.25 s`."""
    if seconds >= 1:
        return f"{seconds:.2f} s"
    return f"{seconds * 1000:.0f} ms" if seconds >= 0.01 else f"{seconds * 1000:.1f} ms"


def noticed(played: Played) -> list[str]:
    """Return the perturbations that the manager noticed, in words."""
    return list(dict.fromkeys(_noticed(played.review.perturbations)))


def _noticed(perturbations: tuple[Perturbation, ...]) -> Iterator[str]:
    for perturbation in perturbations:
        match perturbation:
            case UnitGone(unit, _, _, cause):
                yield f"{unit} is gone: {cause}"
            case SubscriptionLost(unit, port):
                yield f"{unit or 'a topic'} has lost its input {port}"
            case WorldChanged(_, difference):
                count = len(difference.added_transformations)
                if count:
                    yield f"{count} transformation{'s' if count > 1 else ''} more"
                for name in difference.added_individuals:
                    yield f"{name} is there"
                for label in difference.changed_transformations:
                    yield f"{label} has changed"
            case _:
                yield "the manager has started"


def decided(played: Played) -> str:
    """Return the decision, in a sentence."""
    review = played.review
    if review.unmet:
        return next(iter(review.unmet.values()))
    changes = played.changes
    if changes:
        kept = len(played.left.units) - len(changes.rewired) - len(changes.stopped)
        counts = (
            ("started", len(changes.started)),
            ("rewired", len(changes.rewired)),
            ("stopped", len(changes.stopped)),
            ("kept as they are", kept),
        )
        return f"Units: {', '.join(f'{count} {what}' for what, count in counts if count)}."
    if review.decision is Decision.KEPT:
        cheapest = "the cheapest there is, and that is proven" if review.is_proven else "the cheapest that was found"
        return f"Nothing changes: what runs is {cheapest}."
    return f"{str(review.decision).capitalize()}. {review.cause}".strip()


def cost(played: Played) -> str | None:
    """Return the cost of the plan and its parts, in words; None if a target is not met or the cost is unknown."""
    review = played.review
    if review.cost_us is None or not review.met:
        return None
    labor_us = labor(played)
    parts = f"{cpu(review.cost_us)} of CPU over {review.horizon_s} s"
    if labor_us:
        parts += f": {cpu(labor_us)} to start, {cpu(review.cost_us - labor_us)} to run"
    return parts


def labor(played: Played) -> int:
    """Return the labor in the cost of the plan, in microseconds."""
    library = played.after.transformation
    upkeep_us = sum(keep_cost_us(library[u.transformation], played.review.horizon_s) for u in played.after.units)
    return max(0, (played.review.cost_us or 0) - upkeep_us)


def others(played: Played) -> list[str]:
    """Return the alternatives, each with its cost and the difference to the chosen plan."""
    chosen_us = played.review.cost_us or 0
    return [f"{other.what}: {cpu(other.cost_us)}, {cpu(other.cost_us - chosen_us)} more" for other in played.others]


def times(played: Played) -> list[tuple[str, float]]:
    """Return the phases of the review and their durations in seconds; phases of no duration are left out."""
    seconds = played.review.seconds
    return [(_PHASE_WORDS[phase], seconds[phase]) for phase in PHASES if seconds.get(phase, 0.0) >= 0.0005]


def seen(played: Played) -> str | None:
    """Return a sentence about the positions on the topic; None if none came."""
    if played.first is None or played.rms_error_m is None:
        return None
    if not played.before.units:
        flow = f"Positions come, the first after {span((played.first.came_ns - played.began_ns) / 1e9)}"
    elif not lost_frames(played):
        flow = "Positions go on, no frame is missing"
    else:
        lost = lost_frames(played)
        flow = f"{lost} frame{'s are' if lost > 1 else ' is'} missing, then positions go on"
    return f"{flow}. They are off by {100 * played.rms_error_m:.1f} cm (RMS of {len(played.settled)} positions)."


def lost_frames(played: Played) -> int:
    """Return the number of consecutive pictures around the step that gave no position."""
    return 0 if played.silence is None or not played.before.units else played.silence.lost_frames
