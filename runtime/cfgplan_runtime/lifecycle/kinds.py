"""The table of what happens: a row for each kind of event, perturbation and report.

The manager, the terminal, the log, recordings, the page, the metrics and the manual read these rows. Nothing else has a
sentence, a level, a counter, an urgency or a blame for a kind.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Flag, IntEnum, auto
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, Generic, Literal, TypeAlias, TypeVar

from cfgplan.amounts import mbit, span
from cfgplan.onward import grouped
from cfgplan.summary import counted, some
from cfgplan_runtime.lifecycle import perturbations, reports
from cfgplan_runtime.lifecycle.review_sentences import TRACEBACK, decision, named, short, unmet_sentences
from cfgplan_runtime.supervision import events

_FRAME = re.compile(r'^  File "[^\n]*\n(?:    [^\n]*\n)*', re.MULTILINE)
_OUR_CODE = str(Path(__file__).parents[1])

T = TypeVar("T", bound=events.Event | perturbations.Perturbation | reports.Report)


class Level(IntEnum):
    """The severity of something; the numbers are those of `foxglove.Log`."""

    INFORMATION = 2
    WARNING = 3
    ERROR = 4


class Urgency(IntEnum):
    """The steps that the manager takes at once when an event comes."""

    SIGN = auto()
    """Nothing: the next round of its loop takes it. Signs of life are not logged."""
    NEWS = auto()
    """It begins a round of its loop."""
    REPLAN = auto()
    """A plan that is being made is made again."""
    ABANDON = auto()
    """An update that waits for new units is given up too, unless the event is about one of these."""


class Shown(Flag):
    """Where something is shown, besides the terminal and the log."""

    LATER = auto()
    """`cfgplan ctl events` has it among past events."""
    ON_PAGE = auto()
    """The page has it in its timeline."""
    AS_LINE = auto()
    """`cfgplan ctl logs` has it among the lines of its unit."""


_USUALLY = Shown.LATER | Shown.ON_PAGE
Growth: TypeAlias = tuple[str, tuple[str, ...], float]
"""A metric, the values of its labels, and by how much it grows; a histogram gets the amount as a sample."""


def _nothing(_: object) -> None:
    """Say nothing."""


def always(_: object) -> bool:
    """Return True, for kinds whose things all have the severity of the kind's level."""
    return True


def _no_more(_: object) -> Iterable[Growth]:
    return ()


@dataclass(frozen=True, slots=True)
class Kind(Generic[T]):
    """A row of the table.

    `says` gives a sentence; None if another row tells of it, or if it does not concern people. Things that are not
    `is_grave` have the level of information. `because` has the words with which a review names a perturbation as its
    cause, which are left out beside a perturbation of the kind `implied_by`. A review looks for the cheapest plan if
    one `optimises`; otherwise it repairs. A unit's death after an event with a `blame` counts as this. `counts` gives
    the metrics that grow besides the number of its kind.
    """

    of: type[T]
    says: Callable[[T], str | None] = _nothing
    level: Level = Level.INFORMATION
    is_grave: Callable[[T], bool] = always
    because: Callable[[T], str] | None = None
    implied_by: type[perturbations.Perturbation] | None = None
    optimises: bool = False
    urgency: Urgency = Urgency.NEWS
    blame: Literal["hung", "too large"] | None = None
    counts: Callable[[T], Iterable[Growth]] = _no_more
    shown: Shown = _USUALLY


def _failed(event: events.UnitFailed) -> str:
    if event.suppressed:
        more = f"{_times(event.suppressed)} more in the same way, up to step {event.step}"
        return f"{event.unit} failed {more} ({event.what}): {short(event.text)}"
    where = f" in step {event.step}" if event.step else ""
    return f"{event.unit} failed{where} ({event.what}): {short(event.text)}"


def _cut_short(event: events.UnitCutShort) -> str:
    lost = f"; {counted(event.waiting, 'element')} that waited are lost" if event.waiting else ""
    return (
        f"{event.unit} was told to end, did not within {event.after_s:g} s, and is killed (`run: {{stop: ...}}`){lost}"
    )


def _certificate_ends(event: events.CertificateEnds) -> str:
    from cfgplan_runtime.fleet.certificates import ending  # this takes long

    return ending(event)


def _input_lost(event: events.InputLost) -> str:
    return f"{event.unit} lost its input {event.port}" if event.unit else f"topic {event.port} lost its source"


def _silent(silent: perturbations.TargetSilent) -> str:
    units = silent.units
    reasons = f"; {named(units)} {'gives' if len(units) == 1 else 'give'} nothing" if units else ""
    lead = f"{silent.target} counts as unmet: nothing has come on {silent.topic} for {span(silent.silent_s)}"
    return f"{lead}{reasons}"


def _facts_changed(changed: perturbations.FactsChanged) -> str:
    how = "gives another quality" if len(changed.requalified) == 1 else "give another quality"
    parts = (changed.left_out, "may not run any more"), (changed.back, "may run again"), (changed.requalified, how)
    return f"facts have changed: {_each_said(*parts)}"


def _code_changed(changed: perturbations.CodeChanged, *, with_causes: bool = False) -> str:
    causes = f" ({short('; '.join(changed.causes))})" if with_causes else ""
    return _each_said((changed.left_out, f"can't be started{causes}"), (changed.back, "may be started again"))


def _world_changed(changed: perturbations.WorldChanged) -> str:
    who = "a request" if _is_request(changed.by) else changed.by
    return f"{who} changed the environment: {_difference(changed.difference)}"


def _backed_off(report: reports.BackedOff) -> str:
    one = report.backing_off
    if one.left_s == float("inf"):
        return f"{one.transformation} is not started until it changes: {short(one.cause)}"
    # The cause was reported when it happened.
    where, there = ("", "") if one.host is None else (f" on {one.host}", " there")
    lead = f"{one.transformation} has failed {_times(one.failures)}{where}"
    return f"{lead} and is not started{there} for {span(one.left_s)}"


def _world_refused(report: reports.WorldRefused) -> str:
    if not report.faults:
        return "the environment file is valid again"
    return f"the environment file has an error; the run keeps the last valid version: {report.faults[0]}"


def _fact_silent(report: reports.FactSilent) -> str:
    lead = f"nothing has observed {report.fact} for {span(report.silent_s)}"
    return f"{lead}: it counts as {report.declared}, as declared"


def _old_code(report: reports.OldCodeRuns) -> str:
    if not report.units:
        return f"{report.file}: no unit runs with the code from before any more"
    again = f"`cfgplan ctl restart {shlex.quote(report.units[0])}` replaces it by a new one"
    return f"{report.file} has changed, and these units run with the code from before: {named(report.units)}; {again}"


def review_sentence(review: reports.Review) -> str:
    """The decision of a review, with its causes and times."""
    parts = [f"Review {review.number}: {decision(review)}"]
    if review.unmet:
        parts += unmet_sentences(review.unmet)
    elif review.avoided:
        labels_of = grouped((why, label) for label, why in review.avoided.items())
        parts.append(f"without {some(f'{named(labels)} ({why})' for why, labels in labels_of.items())}")
    if review.undecided:
        (offered, demanded), more = review.undecided[0], len(review.undecided) - 1
        others = f" (and {more} more such pairs)" if more else ""
        parts.append(f"it is undecided whether {offered} is {demanded}{others}: if so, a better update may exist")
    parts.append(f"cause: {_causes(review)}")
    took = {phase: seconds for phase, seconds in review.seconds.items() if seconds >= 0.0005}
    if took:
        total = sum(took.values())
        parts.append(f"{span(total)} ({', '.join(f'{phase} {span(s)}' for phase, s in took.items())})")
    return "; ".join(parts)


def _causes(review: reports.Review) -> str:
    """Why a review was made, in a few words, without the causes that others imply."""
    there = {type(perturbation) for perturbation in review.perturbations}
    rows = [(kind_of(one), one) for one in review.perturbations]
    told = [row.because(one) for row, one in rows if row.because is not None and row.implied_by not in there]
    return named(dict.fromkeys(told))


def _is_bad(report: reports.Reviewed) -> bool:
    return bool(report.review.unmet) or report.review.decision in (reports.Decision.FAILED, reports.Decision.UNDECIDED)


def _review_counts(report: reports.Reviewed) -> Iterator[Growth]:
    review = report.review
    yield "reviews", (review.decision.value,), 1
    for phase, seconds in review.seconds.items():
        yield "review_phase_seconds", (phase,), seconds
    if review.decision is reports.Decision.APPLIED and review.change_set is not None:
        for change in ("started", "rewired", "stopped"):
            yield "unit_changes", (change,), len(getattr(review.change_set, change))


_EVENTS = (
    Kind(events.UnitReady),
    Kind(
        events.UnitDied,
        says=lambda it: f"{it.unit} {it.how}: {short(it.cause)}",
        level=Level.ERROR,
        urgency=Urgency.ABANDON,
        shown=_USUALLY | Shown.AS_LINE,
    ),
    Kind(events.UnitStopped),
    Kind(events.SparePrepared),
    Kind(events.SpareUsed, says=lambda it: f"{it.unit} starts in the prepared spare {it.spare}"),
    Kind(
        events.SpareLost,
        says=lambda it: f"the cold spare {it.unit} was lost and is prepared again: {short(it.cause)}",
        level=Level.WARNING,
    ),
    Kind(events.UnitFailed, says=_failed, level=Level.WARNING),
    Kind(
        events.UnitHung,
        says=lambda it: f"{it.unit} gave no sign of life for {span(it.silent_s)} and is killed",
        level=Level.ERROR,
        blame="hung",
    ),
    Kind(
        events.UnitTooLarge,
        says=lambda it: f"{it.unit} takes {it.memory_bytes >> 20} MB and is killed",
        level=Level.ERROR,
        blame="too large",
    ),
    Kind(events.UnitCutShort, says=_cut_short, level=Level.WARNING),
    Kind(
        events.StateNotExact,
        says=lambda it: (
            f"{it.unit} has not got the state of {it.before} exactly, and may miss steps or repeat some: {it.cause}"
        ),
        level=Level.WARNING,
    ),
    Kind(events.UnitPrinted, says=lambda it: f"{it.unit} | {it.line}", shown=Shown.AS_LINE),
    Kind(events.SourceExhausted, says=lambda it: f"{it.unit} has given its last element"),
    Kind(events.InputLost, says=_input_lost, level=Level.WARNING, urgency=Urgency.ABANDON),
    Kind(events.WireSwitched),
    Kind(
        events.OutletsLost,
        says=lambda it: f"the topics' addresses were lost and are created again: {it.cause}",
        level=Level.ERROR,
    ),
    Kind(events.OutletsOpened),
    Kind(
        events.HelperHung,
        says=lambda it: (
            f"the helper process `{it.helper}` gave no sign of life for {span(it.silent_s)} and is restarted"
        ),
        level=Level.ERROR,
    ),
    Kind(events.CertificateEnds, says=_certificate_ends, level=Level.WARNING),
    Kind(events.OutOfDescriptors, says=lambda it: it.cause, level=Level.ERROR),
    # The perturbation tells of these two.
    Kind(events.HostLost, level=Level.WARNING, urgency=Urgency.ABANDON),
    Kind(events.HostJoined, urgency=Urgency.REPLAN),
    Kind(
        events.ClockMoved,
        says=lambda it: (
            f"the clock of {it.host} is off by {span(it.ahead_us / 1e6)}; times of its elements are not corrected"
        ),
    ),
    Kind(
        events.ElementsLost,
        says=lambda it: f"{it.host} is back; {it.elements} of its elements for other hosts were lost on the way",
        level=Level.WARNING,
    ),
    Kind(
        events.UnitFound,
        says=lambda it: f"{it.unit} was left running by an earlier run, which started it {span(it.age_s)} ago",
    ),
    Kind(events.FailuresKept),  # the back-off tells of it
    Kind(events.Applied),
    Kind(events.RolledBack, level=Level.WARNING),  # the review tells of it
)

_PERTURBATIONS = (
    Kind(perturbations.Started, because=lambda _: "start", optimises=True),
    Kind(
        perturbations.UnitGone,
        because=lambda it: f"{it.unit} {it.how}",
        level=Level.ERROR,
        is_grave=lambda it: it.how != "killed",
        counts=lambda it: [("unit_failures", (it.transformation, it.how), 1)],
    ),
    Kind(
        perturbations.UnitKeepsFailing,
        says=lambda it: f"{it.unit} failed {_times(it.failures)} in a row and is given up: {short(it.text)}",
        because=lambda it: f"{it.unit} keeps failing",
        level=Level.WARNING,
    ),
    Kind(
        perturbations.SubscriptionLost,
        because=lambda it: f"{it.unit} lost {it.port}" if it.unit else f"topic {it.port} lost its source",
        implied_by=perturbations.UnitGone,
        level=Level.WARNING,
    ),
    Kind(perturbations.TargetSilent, says=_silent, because=lambda it: f"{it.target} is silent", level=Level.WARNING),
    Kind(
        perturbations.WorldChanged,
        says=_world_changed,
        because=lambda it: f"{'a request' if _is_request(it.by) else 'the file'} changed the environment",
    ),
    Kind(
        perturbations.HostGone,
        says=lambda it: f"host {it.host} is gone{f': {it.cause}' if it.cause else ''}",
        because=lambda it: f"host {it.host} is gone",
        level=Level.WARNING,
    ),
    Kind(
        perturbations.HostBack,
        says=lambda it: f"host {it.host} is there",
        because=lambda it: f"host {it.host} is there",
    ),
    Kind(
        perturbations.QualitiesObserved,
        says=lambda it: f"observed qualities: {'; '.join(it.outputs)}",
        because=lambda _: "observed qualities have changed",
        optimises=True,
    ),
    Kind(
        perturbations.LinkMeasured,
        says=lambda it: (
            f"the link between {_ends(it.between)} carries "
            f"{'as much as declared' if it.rate is None else f'about {mbit(it.rate)}'}: plans go by that"
        ),
        because=lambda it: (
            f"the link between {_ends(it.between)} carries {'as declared' if it.rate is None else mbit(it.rate)}"
        ),
        optimises=True,
    ),
    Kind(
        perturbations.LookDue,
        because=lambda it: f"a look at {it.transformation}{'' if it.host is None else f' on {it.host}'}",
    ),
    Kind(
        perturbations.LookOver,
        because=lambda it: f"{named(it.units)} {'was' if len(it.units) == 1 else 'were'} looked at",
        optimises=True,
    ),
    Kind(perturbations.FactsChanged, says=_facts_changed, because=lambda _: "facts have changed", optimises=True),
    Kind(
        perturbations.CodeChanged,
        says=lambda it: f"code: {_code_changed(it, with_causes=True)}",
        because=_code_changed,
        level=Level.WARNING,
        is_grave=lambda it: bool(it.left_out),
        optimises=True,
    ),
    Kind(
        perturbations.HorizonReached,
        says=lambda it: f"the horizon of {it.horizon_s} s is reached",
        because=lambda _: "horizon reached",
        optimises=True,
    ),
    Kind(perturbations.UpdateFailed, because=lambda _: "the last update failed", level=Level.WARNING),
    Kind(
        perturbations.MayStartAgain,
        says=lambda it: f"{named(it.transformations)} may start again",
        because=lambda it: f"{named(it.transformations)} may start again",
        optimises=True,
    ),
    Kind(perturbations.RestartAsked, because=lambda it: f"restart of {named(it.units)}"),
    Kind(
        perturbations.ReviewRequested,
        says=lambda it: f"{it.by} asked for a review",
        because=lambda _: "asked for",
        optimises=True,
    ),
    Kind(perturbations.PlanGiven, because=lambda it: f"{it.by} was given to apply"),
)

_REPORTS = (
    Kind(reports.ReviewBegan),
    Kind(
        reports.Reviewed,
        says=lambda it: review_sentence(it.review),
        level=Level.WARNING,
        is_grave=_is_bad,
        counts=_review_counts,
        shown=Shown.LATER,  # the page has reviews of its own
    ),
    Kind(reports.BackedOff, says=_backed_off, level=Level.WARNING),
    Kind(reports.WorldRefused, says=_world_refused, level=Level.WARNING, is_grave=lambda it: bool(it.faults)),
    Kind(reports.OldCodeRuns, says=_old_code, level=Level.WARNING, is_grave=lambda it: bool(it.units)),
    Kind(reports.FactSilent, says=_fact_silent, level=Level.WARNING),
    Kind(
        reports.Ended,
        says=lambda it: f"the run has ended: {it.cause}" if it.cause else None,
        level=Level.ERROR,
        is_grave=lambda it: bool(it.cause),
    ),
)

_SIGNS = [Kind(sign, urgency=Urgency.SIGN, shown=Shown(0)) for sign in (*events.SIGNS, reports.Observed)]
_ROWS: tuple[Kind[Any], ...] = (*_EVENTS, *_PERTURBATIONS, *_REPORTS, *_SIGNS)
KINDS: Final[Mapping[type[Any], Kind[Any]]] = MappingProxyType({row.of: row for row in _ROWS})
"""The table, by kind. `Perturbed` and `UnitEvent` have no row: the perturbation or event that they carry has one."""
_NAMED: Final[Mapping[str, Kind[Any]]] = MappingProxyType({of.__name__: row for of, row in KINDS.items()})
_UNKNOWN: Final[Kind[Any]] = Kind(events.Event)
"""An event of a kind that a middleware has made up is news without a sentence."""


def kind_of(what: object) -> Kind[Any]:
    """The row of an event, a perturbation or a report."""
    return KINDS.get(type(what), _UNKNOWN)


def kind_named(name: str) -> Kind[Any]:
    """The row of the kind with a name, as in records."""
    return _NAMED.get(name, _UNKNOWN)


def subject(report: reports.Report) -> object:
    """The event or perturbation that a report carries; itself if it carries none."""
    match report:
        case reports.Perturbed(carried) | reports.UnitEvent(carried):
            return carried
    return report


def sentence(report: reports.Report) -> str | None:
    """A report as a sentence for people, on one line; None if it does not concern them."""
    what = subject(report)
    said = kind_of(what).says(what)
    host = report.host if isinstance(report, reports.UnitEvent) else None
    return said if said is None or host is None else f"{host}: {said}"


def level(report: reports.Report) -> Level:
    """The severity of a report."""
    what = subject(report)
    row = kind_of(what)
    return row.level if row.is_grave(what) else Level.INFORMATION


def growths(report: reports.Report) -> Iterator[Growth]:
    """The metrics that grow with a report."""
    what = subject(report)
    match report:
        case reports.Perturbed():
            yield "perturbations", (type(what).__name__,), 1
        case reports.UnitEvent():
            yield "events", (type(what).__name__,), 1
    yield from kind_of(what).counts(what)


def details(report: reports.Report) -> str | None:
    """The traceback's frames in the user's own files, for failed unit code; None if there are none."""
    event = report.event if isinstance(report, reports.UnitEvent) else None
    texts = (getattr(event, name, None) for name in ("text", "cause"))
    text = next((text for text in texts if isinstance(text, str) and TRACEBACK in text), "")
    own = [frame for frame in _FRAME.findall(text) if _OUR_CODE not in frame.partition("\n")[0]]
    return "".join(own).rstrip("\n") or None


def _ends(between: tuple[str, str]) -> str:
    """The two selectors of a link, without the quotes of plain names."""
    return " and ".join(each.strip("'") for each in between)


def _is_request(by: str) -> bool:
    """Whether `by` is a kind of request, and not a file."""
    from cfgplan_runtime.lifecycle import changes  # this takes long, and clients that only show sentences don't need it

    return hasattr(changes, by)


def _difference(difference: perturbations.Difference) -> str:
    parts = []
    for name in difference.__dataclass_fields__:
        value = getattr(difference, name)
        verb, _, noun = name.partition("_")
        if isinstance(value, tuple) and value:
            parts.append(f"{verb} {noun.replace('_', ' ')} {named(value)}" if noun else f"{verb} {named(value)}")
        elif value:
            parts.append(name)
    return "; ".join(parts)


def _times(number: int) -> str:
    return "once" if number == 1 else f"{number} times"


def _each_said(*parts: tuple[Sequence[str], str]) -> str:
    """Each list of labels with its predicate, without the empty ones."""
    return ", ".join(f"{named(labels)} {says}" for labels, says in parts if labels)
