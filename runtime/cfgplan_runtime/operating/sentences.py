"""Sentences for people about events: one line each."""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from cfgplan.amounts import mbit, span
from cfgplan.domain import ChangeSet
from cfgplan.summary import counted, some
from cfgplan_runtime.errors import RuntimeFaultError
from cfgplan_runtime.lifecycle import perturbations as kinds
from cfgplan_runtime.lifecycle.reports import (
    BackedOff,
    Decision,
    Ended,
    FactSilent,
    Perturbed,
    Report,
    Review,
    Reviewed,
    Snapshot,
    UnitEvent,
    WorldRefused,
)
from cfgplan_runtime.supervision import events

if TYPE_CHECKING:
    from cfgplan_runtime.lifecycle.deliberation import Thought

INFORMATION, WARNING, ERROR = 2, 3, 4
named = partial(some, most=4)
"""Some names, and how many more there are."""
_TRACEBACK = "Traceback (most recent call last)"
_FRAME = re.compile(r'^  File "[^\n]*\n(?:    [^\n]*\n)*', re.MULTILINE)
_OUR_ERRORS = f"{RuntimeFaultError.__module__}."
_OUR_CODE = str(Path(__file__).parents[1])
_LONGEST_CAUSE = 300


def sentence(report: Report) -> str | None:
    """A report as a sentence; None if it does not concern people."""
    match report:
        case Perturbed(perturbation):
            return _perturbation(perturbation)
        case Reviewed(review):
            return review_sentence(review)
        case UnitEvent(event, host):
            said = _event(event)
            return said if said is None or host is None else f"{host}: {said}"
        case BackedOff(backing_off):
            label, cause = backing_off.transformation, short(backing_off.cause)
            if backing_off.left_s == float("inf"):
                return f"{label} is not started until it changes: {cause}"
            # The cause was reported when it happened.
            times = _times(backing_off.failures)
            where, there = ("", "") if backing_off.host is None else (f" on {backing_off.host}", " there")
            return f"{label} has failed {times}{where} and is not started{there} for {span(backing_off.left_s)}"
        case WorldRefused(_, faults) if faults:
            return f"the environment file has an error; the run keeps the last valid version: {faults[0]}"
        case WorldRefused():
            return "the environment file is valid again"
        case FactSilent(fact, silent_s, declared):
            return f"nothing has observed {fact} for {span(silent_s)}: it counts as {declared}, as declared"
        case Ended(cause) if cause:
            return f"the manager has ended: {cause}"
    return None


def details(report: Report) -> str | None:
    """The traceback's frames in the user's own files, for failed unit code; None if there are none."""
    match report:
        case UnitEvent(events.UnitFailed(text=text) | events.UnitDied(cause=text) | events.SpareLost(cause=text)) if (
            _TRACEBACK in text
        ):
            frames = _FRAME.findall(text)
            own = [frame for frame in frames if _OUR_CODE not in frame.partition("\n")[0]]
            return "".join(own).rstrip("\n") or None
    return None


def level(report: Report) -> int:
    """A report's severity: INFORMATION, WARNING or ERROR."""
    match report:
        case UnitEvent(
            events.UnitDied()
            | events.UnitHung()
            | events.UnitTooLarge()
            | events.OutletsLost()
            | events.HelperHung()
            | events.OutOfDescriptors()
        ):
            return ERROR
        case UnitEvent(
            events.UnitFailed()
            | events.UnitCutShort()
            | events.SpareLost()
            | events.InputLost()
            | events.RolledBack()
            | events.CertificateEnds()
        ):
            return WARNING
        case BackedOff() | FactSilent():
            return WARNING
        case WorldRefused(_, faults) if faults:
            return WARNING
        case Ended(cause) if cause:
            return ERROR
        case Reviewed(review) if review.unmet or review.decision in (Decision.FAILED, Decision.UNDECIDED):
            return WARNING
    return INFORMATION


def review_sentence(review: Review) -> str:
    """The decision of a review, with its causes and times."""
    parts = [f"Review {review.number}: {decision(review)}"]
    if review.unmet:
        parts += [f"{label} is not met: {reason}" for label, reason in sorted(review.unmet.items())]
    elif review.avoided:
        parts.append(f"without {some(f'{label} ({why})' for label, why in review.avoided.items())}")
    if review.undecided:
        (offered, demanded), more = review.undecided[0], len(review.undecided) - 1
        others = f" (and {more} more such pairs)" if more else ""
        parts.append(f"it is undecided whether {offered} is {demanded}{others}: if so, a better update may exist")
    parts.append(f"cause: {_because(review)}")
    took = {phase: seconds for phase, seconds in review.seconds.items() if seconds >= 0.0005}
    if took:
        total = sum(took.values())
        parts.append(f"{span(total)} ({', '.join(f'{phase} {span(s)}' for phase, s in took.items())})")
    return "; ".join(parts)


def _because(review: Review) -> str:
    """Why a review was made, in a few words. If a unit died, the inputs that were lost with it are left out."""
    gone = any(isinstance(perturbation, kinds.UnitGone) for perturbation in review.perturbations)
    told = [p for p in review.perturbations if not (gone and isinstance(p, kinds.SubscriptionLost))]
    return named(dict.fromkeys(map(_cause, told)))


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
            return f"the update failed: {short(review.cause)}"
    return f"no decision: {short(review.cause)}"


def _cause(perturbation: kinds.Perturbation) -> str:
    match perturbation:
        case kinds.Started():
            return "start"
        case kinds.UnitGone(unit, _, how):
            return f"{unit} {how}"
        case kinds.UnitKeepsFailing(unit):
            return f"{unit} keeps failing"
        case kinds.SubscriptionLost(unit, port):
            return f"{unit} lost {port}" if unit else f"topic {port} lost its source"
        case kinds.TargetSilent(target):
            return f"{target} is silent"
        case kinds.WorldChanged(by):
            return f"{'a request' if _is_request(by) else 'the file'} changed the world"
        case kinds.HostGone(host):
            return f"host {host} is gone"
        case kinds.HostBack(host):
            return f"host {host} is there"
        case kinds.CodeChanged():
            return "code has changed"
        case kinds.FactsChanged():
            return "facts have changed"
        case kinds.LinkMeasured(between, rate):
            return f"the link between {_ends(between)} carries {'as declared' if rate is None else mbit(rate)}"
        case kinds.QualitiesObserved():
            return "observed qualities have changed"
        case kinds.LookDue(transformation):
            return f"a look at {transformation}"
        case kinds.LookOver(units):
            return f"{named(units)} {'was' if len(units) == 1 else 'were'} looked at"
        case kinds.HorizonReached():
            return "horizon reached"
        case kinds.UpdateFailed():
            return "the last update failed"
        case kinds.MayStartAgain(transformations):
            return f"{named(transformations)} may start again"
        case kinds.RestartAsked(units):
            return f"restart of {named(units)}"
        case kinds.PlanGiven(by):
            return f"{by} was given to apply"
    return "asked for"


def _ends(between: tuple[str, str]) -> str:
    """The two selectors of a link, without the quotes of plain names."""
    return " and ".join(each.strip("'") for each in between)


def preview_sentence(thought: Thought) -> str:
    """The change that a review would make now, and its cost."""
    from cfgplan_runtime.lifecycle.configuration import external_units  # clients that only show need none of it

    changes = thought.change_set
    if changes is None:
        return f"A review would now decide nothing: {thought.cause}"
    external = external_units(changes, thought.planned)
    is_kept = thought.decision is Decision.KEPT or not changes
    parts = [f"A review would now {'change nothing' if is_kept else _changes(changes, external, _INFINITIVES)}"]
    if thought.cost_us is not None:
        before_us = thought.cost_before_us
        parts.append(f"{thought.cost_us / 1e6:.4g} s of CPU over the horizon, now {before_us / 1e6:.4g} s")
    parts += [f"{label} is not met: {reason}" for label, reason in sorted(thought.unmet.items())]
    return "; ".join(parts)


def supposed_sentence(thought: Thought, now: Snapshot) -> str:
    """The plan for a supposed change: the units it changes, its cost and the present one, and unmet targets."""
    if thought.change_set is None:
        return f"No plan was found: {thought.cause}"
    is_kept = thought.decision is Decision.KEPT or not thought.change_set
    parts = ["No other unit would change" if is_kept else f"It would {_changes(thought.change_set, (), _INFINITIVES)}"]
    if thought.cost_us is not None:
        more_us = thought.cost_us - now.cost_us
        more = f"{abs(more_us) / 1e6:.3g} s {'more' if more_us > 0 else 'less'} than now" if more_us else "as now"
        parts.append(f"{thought.cost_us / 1e6:.4g} s of CPU over the horizon, {more}")
    parts.append("proven: no plan is cheaper" if thought.is_proven else "not proven to be the cheapest")
    parts += [f"{label} would not be met: {reason}" for label, reason in sorted(thought.unmet.items())]
    return "; ".join(parts)


_PAST, _INFINITIVES = ("adopted", "started", "rewired", "stopped"), ("adopt", "start", "rewire", "stop")


def _changes(changes: ChangeSet, external: tuple[str, ...], verbs: tuple[str, ...] = _PAST) -> str:
    """The units that a change set takes in, starts, rewires and stops; `external` ones run already."""
    new = [unit.id for unit in changes.started if unit.id not in external]
    groups = external, new, [unit.id for unit in changes.rewired], changes.stopped
    parts = [f"{verb} {named(names)}" for verb, names in zip(verbs, groups, strict=True) if names]
    return ", ".join(parts) or "nothing to change"


def _perturbation(perturbation: kinds.Perturbation) -> str | None:
    match perturbation:
        case kinds.UnitKeepsFailing(unit, _, failures, text):
            return f"{unit} failed {_times(failures)} in a row and is given up: {short(text)}"
        case kinds.TargetSilent(target, topic, silent_s, units):
            reasons = f"; {named(units)} {'gives' if len(units) == 1 else 'give'} nothing" if units else ""
            return f"{target} counts as unmet: nothing has come on {topic} for {span(silent_s)}{reasons}"
        case kinds.WorldChanged(by, difference):
            return f"{'a request' if _is_request(by) else by} changed the world: {_difference(difference)}"
        case kinds.HostGone(host, cause):
            return f"host {host} is gone{f': {cause}' if cause else ''}"
        case kinds.HostBack(host):
            return f"host {host} is there"
        case kinds.CodeChanged(left_out, back):
            return "code: " + _each_said((left_out, "can't be started"), (back, "may be started again"))
        case kinds.LinkMeasured(between, rate):
            how = "as much as declared" if rate is None else f"about {mbit(rate)}"
            return f"the link between {_ends(between)} carries {how}: plans go by that"
        case kinds.QualitiesObserved(outputs):
            return f"observed qualities: {'; '.join(outputs)}"
        case kinds.FactsChanged(left_out, back, requalified):
            how = "gives another quality" if len(requalified) == 1 else "give another quality"
            parts = [(left_out, "may not run any more"), (back, "may run again"), (requalified, how)]
            return "facts have changed: " + _each_said(*parts)
        case kinds.HorizonReached(horizon_s):
            return f"the horizon of {horizon_s} s is reached"
        case kinds.MayStartAgain(transformations):
            return f"{named(transformations)} may start again"
        case kinds.ReviewRequested(by):
            return f"a review was asked for by {by}"
    # All others are told by an event of a unit, or by the review.
    return None


def _is_request(by: str) -> bool:
    """Whether `by` is a kind of request, and not a file."""
    from cfgplan_runtime.lifecycle import changes  # this takes long, and clients that only show sentences don't need it

    return hasattr(changes, by)


def _difference(difference: kinds.Difference) -> str:
    parts = []
    for name in difference.__dataclass_fields__:
        value = getattr(difference, name)
        verb, _, noun = name.partition("_")
        if isinstance(value, tuple) and value:
            parts.append(f"{verb} {noun.replace('_', ' ')} {named(value)}" if noun else f"{verb} {named(value)}")
        elif value:
            parts.append(name)
    return "; ".join(parts)


def _event(event: events.Event) -> str | None:
    match event:
        case events.UnitDied(unit, cause):
            return f"{unit} died: {short(cause)}"
        case events.SpareUsed(unit, spare):
            return f"{unit} starts in the prepared spare {spare}"
        case events.SpareLost(unit, cause):
            return f"the cold spare {unit} was lost and is prepared again: {short(cause)}"
        case events.UnitFailed(unit, kind, step, text, suppressed):
            if suppressed:
                return f"{unit} failed {_times(suppressed)} more, up to step {step}, such as ({kind}): {short(text)}"
            where = f" in step {step}" if step else ""
            return f"{unit} failed{where} ({kind}): {short(text)}"
        case events.UnitHung(unit, silent_s):
            return f"{unit} gave no sign of life for {span(silent_s)} and is killed"
        case events.UnitCutShort(unit, after_s, waiting):
            lost = f"; {counted(waiting, 'element')} that waited are lost" if waiting else ""
            return f"{unit} was told to end, did not within {after_s:g} s, and is killed (`run: {{stop: ...}}`){lost}"
        case events.UnitTooLarge(unit, memory_bytes):
            return f"{unit} takes {memory_bytes >> 20} MB and is killed"
        case events.UnitPrinted(unit, line):
            return f"{unit} | {line}"
        case events.InputLost(None, topic, _):
            return f"topic {topic} lost its source"
        case events.InputLost(unit, port, _):
            return f"{unit} lost its input {port}"
        case events.SourceExhausted(unit):
            return f"{unit} has given its last element"
        case events.HelperHung(helper, silent_s):
            return f"the {helper} gave no sign of life for {span(silent_s)} and is restarted"
        case events.OutOfDescriptors(cause):
            return cause
        case events.CertificateEnds():
            from cfgplan_runtime.fleet.certificates import ending  # this takes long

            return ending(event)
        case events.OutletsLost(cause):
            return f"the topics' addresses were lost and are created again: {cause}"
        case events.ClockMoved(host, ahead_us):
            return f"the clock of {host} is {span(ahead_us / 1e6)} from this one now; times of elements are not moved"
        case events.ElementsLost(host, elements):
            return f"{host} is back; {elements} of its elements for other hosts were lost on the way"
    return None


def _times(number: int) -> str:
    return "once" if number == 1 else f"{number} times"


def short(text: str) -> str:
    """A cause on one line; a traceback becomes the message of its exception."""
    before, mark, trace = text.partition(_TRACEBACK)
    if mark:
        text = before + trace.strip().splitlines()[-1]
    text = " ".join(text.replace(_OUR_ERRORS, "").split())
    return text if len(text) <= _LONGEST_CAUSE else f"{text[: _LONGEST_CAUSE - 3]}..."


def _each_said(*parts: tuple[Sequence[str], str]) -> str:
    """Each list of labels with its predicate, without the empty ones."""
    return ", ".join(f"{named(labels)} {says}" for labels, says in parts if labels)
