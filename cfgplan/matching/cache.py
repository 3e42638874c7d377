"""Answers kept on disk between runs, keyed by a hash of the axioms and of the tags' concepts.

Files are written whole or not at all; a damaged or foreign file is ignored and overwritten. A cache that can't be
written is no error: the answers are just not kept.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Collection
from contextlib import suppress
from pathlib import Path
from typing import Final

from cfgplan.domain import Similarity
from cfgplan.matching.answer import Matching
from cfgplan.matching.ontology import Ontology

_FOLDER: Final = "matching"
_KEPT_FORMAT: Final = "cfgplan-matching/5"
"""Raise this number whenever tags or ontologies are read differently: kept answers would be wrong."""
MOST_FILES: Final = 64
"""The number of answers that are kept; the oldest are dropped first."""


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
