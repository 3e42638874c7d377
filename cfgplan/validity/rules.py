"""The names of the judge's rules, and a violation."""

from __future__ import annotations

from enum import StrEnum

from cfgplan.arguments import checked
from cfgplan.frozen import dataclass
from cfgplan.summary import Summary, summary, tabled


class Rule(StrEnum):
    """The rules of valid environments and truthful plans."""

    KNOWN = "every unit instantiates a transformation of the library (Definition 9.1)"
    FED = "every input of a unit is fed by a stream of a running unit (Definition 9.2)"
    MET = "every target has its unit, or exactly one stream, published on its topic (Definition 9.3)"
    SERVES = "no stream is taken by more inputs and topics than its output serves"
    MATCHING = "every stream's tag is subsumed by the tag of what it feeds (Definition 9.4)"
    GROUNDED = "every unit's data comes from sources: no cycle without a feedback input"
    DISTINCT = "inputs of one distinct group are fed by different transformations"
    LEAN = "no unit runs that no target needs, unless it is pinned, a needed spare or asked for by number"
    PUBLISHED = "a topic carries only what a target asks for"
    QUALITY = "every target's stream is as good as the target asks"
    PLACED = "every unit runs on a host that its transformation allows"
    CAPACITY = "the units on a host take no more of any resource than it has, and streams no more of a link"
    APART = "units of transformations that conflict are not there together, or not on one host"
    BESIDE = "on the host of a running unit there runs one of each transformation that it runs with"
    INSTANCES = "of each transformation as many units run as it asks for and allows, in all and on each host"
    SURVIVES = "no single failure leaves a target without a stream"
    PINNED = "a running unit of a pinned transformation is kept where it can be fed, and not stopped without a reason"
    REQUIRED = "a plan says which required transformations it leaves unused; an optimal one proves that none uses more"
    CONSISTENT = "a change set can be applied and says exactly what changes"
    COST = (
        "cost is labor of what starts plus upkeep of what runs over the horizon (Definition 8), and what else is priced"
    )
    BOUND = "the bound is at most the cost, and equal to it where the plan is optimal; a bound of 0 claims nothing"


def _violation_summary(violation: Violation) -> Summary:
    places = ((kind, getattr(violation, kind)) for kind in ("unit", "port", "target"))
    return summary(violation.text, ("", "name"), [("rule", violation.rule), *(each for each in places if each[1])])


@tabled(_violation_summary)
@dataclass(frozen=True, slots=True)
@checked
class Violation:
    """One broken `rule`, with the `unit` or `target` (and `port`) where it is broken, and a `text` for people.

    It `is_open` if a pair of tags has to be decided to know whether it is broken.
    """

    rule: Rule
    text: str
    unit: str | None = None
    port: str | None = None
    target: str | None = None
    is_open: bool = False

    def __str__(self) -> str:
        return self.text
