"""Answers about which tags match, apart from the reasoners, and the folder in which they are kept between runs.

Reading a kept answer imports no reasoner. A hash of the axioms and of the tags' concepts is its key. Files are written
whole or not at all; a damaged or foreign file is ignored and overwritten. If the folder can't be written, nothing is
kept.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Collection, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from cfgplan.domain import Similarity
from cfgplan.matching.ontology import Ontology

_FOLDER: Final = "matching"
_KEPT_FORMAT: Final = "cfgplan-matching/5"
"""Raise this number whenever tags or ontologies are read differently: kept answers would be wrong."""
MOST_FILES: Final = 64
"""The number of answers that are kept; the oldest are dropped first."""


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
        _KEPT_FORMAT,
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
    try:
        kept = json.loads((folder / _FOLDER / f"{key}.json").read_bytes())
        numbers = kept["rows"]
        is_ours = (kept["format"], kept["key"], len(numbers)) == (_KEPT_FORMAT, key, len(demands))
        if not is_ours or any(number < 0 for row in numbers for number in row):
            return None
        rows = (frozenset(offers[number] for number in row) for row in numbers)
        similarity = Similarity(dict(zip(demands, rows, strict=True)))
        return Matching(
            similarity, tuple(kept["warnings"]), kept["answered_by"], impossible=frozenset(kept["impossible"])
        )
    except (OSError, ValueError, LookupError, TypeError):
        return None


def store(folder: Path, key: str, offered: Collection[str], demanded: Collection[str], matching: Matching) -> None:
    """Keep an answer, unless something in it is unknown: the next run may have more time."""
    if matching.similarity.open:
        return
    number = {tag: index for index, tag in enumerate(sorted(set(offered)))}
    rows = [sorted(number[tag] for tag in matching.similarity.offers[wanted]) for wanted in sorted(set(demanded))]
    kept = {
        "format": _KEPT_FORMAT,
        "key": key,
        "rows": rows,
        "warnings": matching.warnings,
        "answered_by": dict(matching.answered_by),
        "impossible": sorted(matching.impossible),
    }
    own = folder / _FOLDER
    temporary = own / f"{key}.{os.getpid()}.tmp"
    try:
        own.mkdir(parents=True, exist_ok=True)
        temporary.write_text(json.dumps(kept))
        temporary.replace(own / f"{key}.json")
        for path in sorted(own.glob("*.json"), key=lambda path: path.stat().st_mtime, reverse=True)[MOST_FILES:]:
            path.unlink(missing_ok=True)
    except OSError:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)
