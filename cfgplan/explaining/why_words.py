"""Why a plan uses something, in words: for the terminal, the page and other programs."""

from __future__ import annotations

from collections.abc import Iterator

from cfgplan.explaining.why_this import Choice, Why
from cfgplan.figures import amount
from cfgplan.summary import some
from cfgplan.unmet import Reason, shared_reasons


def why_lines(why: Why) -> Iterator[str]:
    """The purpose of a transformation, the planner's choice, and the alternative."""
    if why.units:
        named = [] if why.units == (why.subject,) else [f"runs as {some(why.units)}"]
        idle = "is a spare for when something fails" if why.is_spare else "serves no target"
        served = f"serves {named_labels('target', why.targets)}" if why.targets else idle
        through = [f"feeds {some(why.consumers)}"] if why.consumers else []
        yield f"{why.subject} {', '.join([*named, served, *through])}."
    yield choice_line(why)
    for sign, labels in (("+", why.more), ("-", why.less)):
        if labels:
            yield f"  {sign} {some(labels)}"
    if why.units and why.difference_us is not None and not why.more and not why.less:
        yield f"  {instead(why)}"
    if why.choice is Choice.FORCED:
        yield f"  {forced_by(why)}"


def forced_by(why: Why, *, is_brief: bool = False) -> str:
    """Return, in words, the demands that can't be met without the subject. If this is the only target that the subject
    serves, and an input of another transformation lacks its feeder, a brief answer names that input alone.
    """
    reasons = why.otherwise.reasons
    if is_brief and len(reasons) == 1 and tuple(reasons) == why.targets:
        reason = Reason.of(reasons[why.targets[0]])
        if reason.lack.needed_by is not None:
            return f"without it, {reason.fault}"
    if reasons:
        return "; ".join(f"without it, {one.text}" for one in shared_reasons(reasons))
    demands = f"{named_labels('target', why.targets)} with the others" if why.targets else "all demands"
    return f"no valid configuration without it meets {demands}"


def instead(why: Why) -> str:
    """Return, in words, what the next best plan runs instead of the subject."""
    less = f"without {some(why.less)}" if why.less else ""
    if why.more:
        return f"{some(why.more)} would run instead{', ' if less else ''}{less}"
    return f"the plan {less} is as good" if less else "another unit of its transformation would be started in its place"


def choice_line(why: Why) -> str:
    """Return a sentence on the planner's choice: it was needed, cheaper, or a tie."""
    how = "without it" if why.units else "that uses it"
    more = why.difference or 0
    match why.choice:
        case Choice.FORCED:
            return "Needed: there is no plan without it."
        case Choice.CHEAPER:
            used = "Used" if why.units else "Not used"
            return f"{used}: the best plan {how} costs {amount(why.decides, more)} more."
        case Choice.LESS_CHANGE:
            return f"A tie in cost: the best plan {how} costs the same, but rewires or starts more units."
        case Choice.TIE:
            return f"A tie: there is a plan {how} that is as good."
        case Choice.DEMANDED if more < 0:
            less = f"would cost {amount(why.decides, -more)} less"
            return f"Used because something is required or pinned: a plan {how} {less}."
        case Choice.DEMANDED:
            return f"Used because something is required or pinned: a plan {how} would be as cheap."
        case Choice.IMPOSSIBLE:
            return "Not used: no plan for these targets can use it."
        case Choice.UNREAD:
            return f"{why.subject} is used by no unit or target of the plan."
        case Choice.UNDECIDED:
            return "Not decided: the plans with it and without it are not both proven optimal."


def named_labels(what: str, labels: frozenset[str] | tuple[str, ...]) -> str:
    """Return labels after their kind `what`: `targets a, b`."""
    plural = "s" if what == "target" and len(labels) > 1 else ""
    return f"{what}{plural} {some(sorted(labels))}"
