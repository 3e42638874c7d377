"""The relation ~ between tags (Definition 5, section IV-B): an offered tag feeds a demanded one that subsumes it."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

from cfgplan.matching.cache import key_of, load, store
from cfgplan.matching.ontology import Ontology
from cfgplan.matching.session import Matcher, Matching


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
    if cache is not None:
        key = key_of(ontology, reasoner, offered, demanded)
        known = load(cache, key, offered, demanded)
        if known is not None:
            return known
    matcher = Matcher(ontology, reasoner=reasoner)
    matcher.add(offered=dict.fromkeys(offered), demanded=dict.fromkeys(demanded))
    matching = matcher.matching(time_limit_s=time_limit_s)
    if cache is not None:
        store(cache, key, offered, demanded, matching)
    return matching
