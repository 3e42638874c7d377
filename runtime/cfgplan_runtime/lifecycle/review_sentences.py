"""Sentences for people about reviews: their decisions, previews, and plans for supposed changes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial
from typing import TYPE_CHECKING

from cfgplan.amounts import span
from cfgplan.domain import ChangeSet
from cfgplan.reasons import shared_reasons
from cfgplan.summary import some
from cfgplan_runtime.errors import UNDONE, RuntimeFaultError
from cfgplan_runtime.lifecycle.reports import Decision, Review, Snapshot

if TYPE_CHECKING:
    from cfgplan_runtime.lifecycle.deliberation import Findings

MOST_NAMED = 4
named = partial(some, most=MOST_NAMED)
"""Some names, and how many more there are."""
TRACEBACK = "Traceback (most recent call last)"
_OUR_ERRORS = f"{RuntimeFaultError.__module__}."
_LONGEST_CAUSE = 300


def decision(review: Review) -> str:
    """The decision of a review, in a few words."""
    match review.decision:
        case Decision.APPLIED:
            return "applied" if review.change_set is None else _changes(review.change_set, review.external)
        case Decision.KEPT:
            return "nothing to change"
        case Decision.DEFERRED:
            saving = span((review.cost_before_us - (review.cost_us or 0)) / 1e6)
            return f"no change needed now; replanning at the horizon would save {saving} of CPU"
        case Decision.FAILED:
            cause = short(review.cause)
            return cause if cause.startswith(UNDONE) else f"the update failed: {cause}"
    return f"no decision: {short(review.cause)}"


def preview_sentence(findings: Findings) -> str:
    """The change that a review would make now, and its cost."""
    from cfgplan_runtime.lifecycle.configuration import external_units  # clients that only show need none of it

    changes = findings.change_set
    if changes is None:
        return f"A review would now decide nothing: {findings.cause}"
    external = external_units(changes, findings.planned)
    is_kept = findings.decision is Decision.KEPT or not changes
    parts = [f"A review would now {'change nothing' if is_kept else _changes(changes, external, _INFINITIVES)}"]
    if findings.cost_us is not None:
        before_us = findings.cost_before_us
        parts.append(f"{findings.cost_us / 1e6:.4g} s of CPU over the horizon, now {before_us / 1e6:.4g} s")
    parts += unmet_sentences(findings.unmet)
    return "; ".join(parts)


def supposed_sentence(findings: Findings, now: Snapshot) -> str:
    """The plan for a supposed change: the units it changes, its cost and the present one, and unmet targets."""
    if findings.change_set is None:
        return f"No plan was found: {findings.cause}"
    is_kept = findings.decision is Decision.KEPT or not findings.change_set
    parts = ["No other unit would change" if is_kept else f"It would {_changes(findings.change_set, (), _INFINITIVES)}"]
    if findings.cost_us is not None:
        more_us = findings.cost_us - now.cost_us
        more = f"{abs(more_us) / 1e6:.3g} s {'more' if more_us > 0 else 'less'} than now" if more_us else "as now"
        parts.append(f"{findings.cost_us / 1e6:.4g} s of CPU over the horizon, {more}")
    parts.append("proven: no plan is cheaper" if findings.is_proven else "not proven to be the cheapest")
    parts += unmet_sentences(findings.unmet, is_supposed=True)
    return "; ".join(parts)


def unmet_sentences(unmet: Mapping[str, str], *, is_supposed: bool = False) -> Iterator[str]:
    """Yield why targets are not met, or would not be, from the reasons by label; each fault is told once."""
    for shared in shared_reasons(dict(sorted(unmet.items())), MOST_NAMED):
        if shared.names_them:
            yield f"{'would not be' if is_supposed else 'not'} met: {shared.text}"
        else:
            verb = "would not be" if is_supposed else "is not" if len(shared.labels) == 1 else "are not"
            yield f"{named(shared.labels)} {verb} met: {shared.text}"


_PAST, _INFINITIVES = ("adopted", "started", "rewired", "stopped"), ("adopt", "start", "rewire", "stop")


def _changes(changes: ChangeSet, external: tuple[str, ...], verbs: tuple[str, ...] = _PAST) -> str:
    """The units that a change set takes in, starts, rewires and stops; `external` ones run already."""
    new = [unit.id for unit in changes.started if unit.id not in external]
    groups = external, new, [unit.id for unit in changes.rewired], changes.stopped
    parts = [f"{verb} {named(names)}" for verb, names in zip(verbs, groups, strict=True) if names]
    return ", ".join(parts) or "nothing to change"


def short(text: str) -> str:
    """A cause on one line; a traceback becomes the message of its exception."""
    before, mark, trace = text.partition(TRACEBACK)
    if mark:
        text = before + trace.strip().splitlines()[-1]
    text = " ".join(text.replace(_OUR_ERRORS, "").split())
    return text if len(text) <= _LONGEST_CAUSE else f"{text[: _LONGEST_CAUSE - 3]}..."
