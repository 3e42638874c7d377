"""Answers about which tags match, apart from the reasoners, and the folder in which they are kept between runs.

Reading a kept answer imports no reasoner. A hash of the axioms and of the tags is its key.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from cfgplan.cache_folder import CachePart
from cfgplan.domain import Similarity
from cfgplan.matching.ontology import Ontology

_ANSWERS: Final = CachePart("matching", "cfgplan-matching/5")
"""Its number is raised whenever tags or ontologies are read differently."""


def impossible(tag: str) -> str:
    """The warning about an offered tag that nothing can have."""
    return f"the offered tag {tag!r} contradicts the ontology: nothing can have it, and it never matches"


@dataclass(frozen=True)
class Matching:
    """The similarity of tags, warnings, and how many pairs of distinct tags each reasoner decided.

    `asked` is the number of pairs that the reference was asked about by now, whether it answered or not.
    """

    similarity: Similarity
    warnings: tuple[str, ...] = ()
    answered_by: Mapping[str, int] = field(default_factory=dict, hash=False)
    asked: int = 0
    impossible: frozenset[str] = frozenset()
    """The offered tags that nothing can have, each with a warning."""

    @property
    def other_warnings(self) -> tuple[str, ...]:
        """The warnings but those of impossible tags."""
        return tuple(told for told in self.warnings if not any(told == impossible(tag) for tag in self.impossible))

    @property
    def counts(self) -> dict[str, int]:
        """Figures for `Plan.counts`, see `planning.Decider`: pairs asked about, and pairs decided by each reasoner."""
        decided = {f"pairs decided by {name}": pairs for name, pairs in self.answered_by.items()}
        return {**decided, "pairs asked": self.asked} if self.asked else decided


def key_of(ontology: Ontology, reasoner: str, offered: Collection[str], demanded: Collection[str]) -> str:
    """The name under which the answer for these tags is kept."""
    texts = [
        _ANSWERS.form,
        ontology.digest,
        json.dumps([*sorted(ontology.prefixes.items()), *ontology.preferred]),
        reasoner,
    ]
    texts += [json.dumps(sorted(set(tags))) for tags in (offered, demanded)]
    return hashlib.sha256("\n".join(texts).encode()).hexdigest()


def load(folder: Path, key: str, offered: Collection[str], demanded: Collection[str]) -> Matching | None:
    """The answer kept under a key; None if there is none or it is damaged.

    A file's `rows` have for each demanded tag the numbers of the offered ones, both in order.
    """
    offers, demands = sorted(set(offered)), sorted(set(demanded))
    known = _ANSWERS.find(folder, key)
    if known is None:
        return None
    try:
        numbers = known["rows"]
        if len(numbers) != len(demands) or any(number < 0 for row in numbers for number in row):
            return None
        rows = (frozenset(offers[number] for number in row) for row in numbers)
        similarity = Similarity(dict(zip(demands, rows, strict=True)))
        warnings, impossible = tuple(known["warnings"]), frozenset(known["impossible"])
        return Matching(similarity, warnings, known["answered_by"], impossible=impossible)
    except (LookupError, TypeError):
        return None


def store(folder: Path, key: str, offered: Collection[str], demanded: Collection[str], matching: Matching) -> None:
    """Keep an answer, unless something in it is unknown: the next run may have more time."""
    if matching.similarity.open:
        return
    number = {tag: index for index, tag in enumerate(sorted(set(offered)))}
    rows = [sorted(number[tag] for tag in matching.similarity.offers[wanted]) for wanted in sorted(set(demanded))]
    content = {
        "rows": rows,
        "warnings": matching.warnings,
        "answered_by": dict(matching.answered_by),
        "impossible": sorted(matching.impossible),
    }
    _ANSWERS.keep(folder, key, content)
