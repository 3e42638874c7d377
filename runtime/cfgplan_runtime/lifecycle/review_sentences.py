"""Sentences for people about reviews: their decisions, previews, and plans for supposed changes."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from cfgplan.amounts import span
from cfgplan.domain import ChangeSet
from cfgplan.onward import grouped
from cfgplan.summary import some
from cfgplan.unmet import Reason, SharedReason, read_reason, shared_reasons
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
            return f"{UNDONE if review.is_undone else 'the update failed'}: {short(review.cause)}"
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


def unmet_says(unmet: Mapping[str, str]) -> list[str]:
    """Return why targets are not met, each reason once, for records; a sentence names all targets that have it."""
    shared = shared_reasons(dict(sorted(unmet.items())))
    return [each.text if each.names_them else f"{', '.join(each.labels)}: {each.text}" for each in shared]


def target_reason(target: Mapping[str, Any]) -> Reason:
    """Return the reason in the record of a target, with its data if the record has it (`manual/control.md`)."""
    return read_reason(target["why"]) if target.get("why") else Reason.of(target["reason"])


def in_display_order(targets: Iterable[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Return records of targets as lists show them: unmet ones first, then by priority and label."""
    return sorted(targets, key=lambda target: (target["met"], -target["priority"], target["label"]))


def reasons_by_target(targets: Iterable[Mapping[str, Any]], most: int = sys.maxsize) -> dict[str, SharedReason]:
    """Return the reason of each unmet target, by label, from records of targets in their order of display.

    Lists show its text for the first target that has it, and refer to that one (`as LABEL`) for the others.
    """
    shared = shared_reasons({each["label"]: target_reason(each) for each in targets if not each["met"]}, most)
    return {label: each for each in shared for label in each.labels}


@dataclass(frozen=True)
class Waiting:
    """Transformations that are not started for now since they have failed with the same cause."""

    names: tuple[str, ...]
    cause: str
    says: str


def waiting(backing_off: Iterable[Mapping[str, Any]]) -> list[Waiting]:
    """Return the transformations that wait, grouped by cause, from records of a state (`manual/control.md`)."""
    alike = grouped(((one["left_s"] is None, short(one["cause"])), one) for one in backing_off)
    return [_waiting(these, cause, until_changed=until_changed) for (until_changed, cause), these in alike.items()]


def _waiting(these: Sequence[Mapping[str, Any]], cause: str, *, until_changed: bool) -> Waiting:
    is_one = len(these) == 1
    hosts = grouped((one["transformation"], one.get("host")) for one in these)
    names = [f"{label} on {named(filter(None, where))}" if any(where) else label for label, where in hosts.items()]
    fewest, most = (pick(one["failures"] for one in these) for pick in (min, max))
    often = "once" if most == 1 else f"{most} times" if fewest == most else f"{fewest} to {most} times"
    if until_changed:
        again = "until it changes" if len(names) == 1 else "until they change"
    else:
        again = f"for {'' if is_one else 'up to '}{span(max(one['left_s'] for one in these))}"
    return Waiting(tuple(names), cause, f"not started {again}, failed {often}: {cause}")


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
