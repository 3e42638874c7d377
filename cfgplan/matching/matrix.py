"""The relation ~ between tags (Definition 5, section IV-B): an offered tag feeds a demanded one that subsumes it."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from cfgplan.domain import Similarity
from cfgplan.errors import Fault, InputError
from cfgplan.matching.faults import MatchingError, ReasonerTimeoutError
from cfgplan.matching.ontology import Ontology
from cfgplan.matching.reasoners import REASONERS
from cfgplan.matching.reference import classify
from cfgplan.matching.syntax import parse_tag


@dataclass(frozen=True)
class Matching:
    """The similarity of tags, what is odd about them, and how many pairs each reasoner answered."""

    similarity: Similarity
    warnings: tuple[str, ...] = ()
    answered_by: Mapping[str, int] = field(default_factory=dict, hash=False)


def match(
    offered: Collection[str],
    demanded: Collection[str],
    ontology: Ontology,
    *,
    reasoner: str = "auto",
    time_limit_s: float | None = None,
    cache: Path | None = None,
) -> Matching:
    """Which offered tags may feed which demanded ones, as texts exactly as given.

    `reasoner` is one of REASONERS; `cache` is a folder for answers that are kept between runs. An offered tag that
    nothing can have would match everything: it is reported and matches nothing. Raises InputError for tags that
    can't be read and for an ontology that can't be reasoned with.
    """
    from cfgplan.matching import hermit

    offers = {text: parse_tag(text, ontology) for text in offered}
    demands = {text: parse_tag(text, ontology) for text in demanded}
    try:
        answer = classify(hermit.classify, ontology, [*offers.values(), *demands.values()], time_limit_s)
    except ReasonerTimeoutError as error:
        unknown = frozenset((o, d) for o in offers for d in demands)
        return Matching(Similarity({d: frozenset() for d in demands}, unknown), (str(error),))
    except MatchingError as error:
        file = str(ontology.files[0]) if ontology.files else None
        raise InputError([Fault(error.message, file=file, mend=error.mend)]) from error
    warnings = []
    rows: dict[str, set[str]] = {text: set() for text in demands}
    for text, concept in offers.items():
        if answer.is_unsatisfiable(concept):
            warnings.append(f"nothing can have the offered tag {text!r}: it contradicts the ontology and never matches")
            continue
        above = answer.below(concept, set(demands.values()))
        for wanted, demand in demands.items():
            if demand in above:
                rows[wanted].add(text)
    similarity = Similarity({wanted: frozenset(row) for wanted, row in rows.items()})
    return Matching(similarity, tuple(warnings), {"hermit": len(offers) * len(demands)})
