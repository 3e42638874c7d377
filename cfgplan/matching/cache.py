"""Answers kept on disk between runs, keyed by a hash of the axioms and of what the tags mean.

Files are written whole or not at all; one that is damaged, or was written by something else, is ignored and
written anew. A cache that can't be written is no error: the answers are just not kept.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Collection, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

from cfgplan.domain import Similarity
from cfgplan.matching.ontology import Ontology
from cfgplan.matching.session import Matching

_FOLDER: Final = "matching"
_FORMAT: Final = "cfgplan-matching/3"
"""Raise this number whenever tags or ontologies are read differently: kept answers would be wrong."""
MOST_FILES: Final = 64
"""The number of answers that are kept; the oldest are dropped first."""


def key_of(ontology: Ontology, reasoner: str, offered: Collection[str], demanded: Collection[str]) -> str:
    """The name under which the answer for these tags is kept."""
    texts = [_FORMAT, ontology.digest, json.dumps(sorted(ontology.prefixes.items())), reasoner]
    texts += [json.dumps(sorted(set(tags))) for tags in (offered, demanded)]
    return hashlib.sha256("\n".join(texts).encode()).hexdigest()


def load(folder: Path, key: str, offered: Collection[str], demanded: Collection[str]) -> Matching | None:
    """The answer kept under a key; None if there is none or it is damaged."""
    try:
        kept = json.loads((folder / _FOLDER / f"{key}.json").read_text("utf-8"))
        return _matching_of(kept, key, sorted(set(offered)), sorted(set(demanded)))
    except (OSError, ValueError, TypeError, KeyError, IndexError, AttributeError):
        return None


def store(folder: Path, key: str, offered: Collection[str], demanded: Collection[str], matching: Matching) -> None:
    """Keep an answer, unless something in it is unknown: the next run may have more time."""
    if matching.similarity.open:
        return
    number = {tag: index for index, tag in enumerate(sorted(set(offered)))}
    rows = [sorted(number[tag] for tag in matching.similarity.offers[wanted]) for wanted in sorted(set(demanded))]
    kept = {
        "format": _FORMAT,
        "key": key,
        "rows": rows,
        "warnings": matching.warnings,
        "answered_by": dict(matching.answered_by),
    }
    own = folder / _FOLDER
    temporary = own / f"{key}.{os.getpid()}.tmp"
    try:
        own.mkdir(parents=True, exist_ok=True)
        temporary.write_text(json.dumps(kept, separators=(",", ":")), "utf-8")
        temporary.replace(own / f"{key}.json")
        _drop_oldest(own)
    except OSError:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def _matching_of(kept: Mapping[str, Any], key: str, offered: list[str], demanded: list[str]) -> Matching:
    if kept["format"] != _FORMAT or kept["key"] != key:
        raise ValueError("the file holds another answer")
    rows = kept["rows"]
    if len(rows) != len(demanded) or any(not 0 <= number < len(offered) for row in rows for number in row):
        raise ValueError("the rows don't fit the tags")
    offers = {wanted: frozenset(offered[number] for number in row) for wanted, row in zip(demanded, rows, strict=True)}
    if not all(isinstance(warning, str) for warning in kept["warnings"]):
        raise ValueError("warnings are texts")
    answered_by = {str(name): int(pairs) for name, pairs in kept["answered_by"].items()}
    return Matching(Similarity(offers), tuple(kept["warnings"]), answered_by)


def _drop_oldest(folder: Path) -> None:
    files = sorted(folder.glob("*.json"), key=lambda path: path.stat().st_mtime, reverse=True)
    for path in files[MOST_FILES:]:
        path.unlink(missing_ok=True)
