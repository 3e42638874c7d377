"""The relation ~ between tags (Definition 5, section IV-B): an offered tag feeds a demanded one that subsumes it.

It also answers the formats' questions to an ontology: whether a tag can be read, and which individuals a class has.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from cfgplan.arguments import Seconds, checked
from cfgplan.canonical import normal
from cfgplan.domain import Similarity
from cfgplan.errors import UnknownNameError
from cfgplan.matching.answer import Matching, key_of, load, store
from cfgplan.matching.faults import ReasonerTimeoutError
from cfgplan.matching.ontology import Ontology
from cfgplan.matching.syntax import parse_tag
from cfgplan.planning import Pair

if TYPE_CHECKING:
    from cfgplan.matching.session import Matcher

T = TypeVar("T")


@checked
def match(
    offered: Collection[str],
    demanded: Collection[str],
    ontology: Ontology,
    *,
    reasoner: str = "auto",
    time_limit_s: Seconds | None = None,
    cache: Path | None = None,
) -> Matching:
    """Decide which offered tags may feed which demanded ones; tags are texts exactly as given.

    `reasoner` is one of REASONERS; `cache` is a folder for answers that are kept between runs. An unsatisfiable offered
    tag would match everything: it is reported and matches nothing. Raises InputError for tags that can't be read and
    for an ontology that can't be reasoned with.
    """
    return Matches(offered, demanded, ontology, reasoner=reasoner, time_limit_s=time_limit_s, cache=cache).matching


class Matches:
    """The similarity of some tags as far as it is known; open pairs can be asked about (`planning.Decider`)."""

    def __init__(
        self,
        offered: Collection[str],
        demanded: Collection[str],
        ontology: Ontology,
        *,
        reasoner: str = "auto",
        time_limit_s: float | None = None,
        cache: Path | None = None,
        most: int | None = None,
    ) -> None:
        """Ask about all open pairs unless they are more than `most`. All questions share the time limit."""
        self._tags = offered, demanded
        self._cache = cache
        self._left_s = time_limit_s
        self._key = key_of(ontology, reasoner, offered, demanded) if cache is not None else ""
        known = load(cache, self._key, offered, demanded) if cache is not None else None
        self._matcher: Matcher | None = None
        if known is not None:
            self.matching = known
            return
        from cfgplan.matching.session import Matcher

        self._matcher = matcher = Matcher(ontology, reasoner=reasoner)
        matcher.add(offered=sorted({*offered}), demanded=sorted({*demanded}))
        found = None if most is None else self._undecided(matcher)
        if found is None or most is None or len([*islice(found.similarity.open_pairs(), most + 1)]) <= most:
            found = self._within_limit(lambda left_s: matcher.matching(time_limit_s=left_s))
        self.matching = found
        self._store()

    @property
    def similarity(self) -> Similarity:
        """The similarity as far as it is known."""
        return self.matching.similarity

    @property
    def counts(self) -> dict[str, int]:
        """How many pairs were asked about by now, and how many each reasoner has decided."""
        return self.matching.counts

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings from matching the tags."""
        return self.matching.warnings

    def decide(self, pairs: Sequence[Pair]) -> int:
        """Ask about open pairs within the remaining time limit; returns how many were asked."""
        matcher = self._matcher
        if matcher is None or (self._left_s is not None and self._left_s <= 0):
            return 0
        asked = self._within_limit(lambda left_s: matcher.decide(pairs, time_limit_s=left_s))
        found = self._undecided(matcher)
        if found.similarity == self.matching.similarity:
            self.matching = replace(found, similarity=self.matching.similarity)
        else:
            self.matching = found
            self._store()
        return asked

    def _undecided(self, matcher: Matcher) -> Matching:
        """Return the known part of the matching, without asking the reference."""
        return self._within_limit(lambda left_s: matcher.matching(time_limit_s=left_s, decide=False))

    def _within_limit(self, question: Callable[[float | None], T]) -> T:
        start = time.monotonic()
        try:
            return question(None if self._left_s is None else max(0.0, self._left_s))
        finally:
            if self._left_s is not None:
                self._left_s -= time.monotonic() - start

    def _store(self) -> None:
        if self._cache is not None:
            store(self._cache, self._key, *self._tags, self.matching)


def check_tag(text: str, ontology: Ontology) -> None:
    """Raise TagError if a tag can't be read with the names of this ontology."""
    parse_tag(text, ontology)


@checked
def instances(
    ontology: Ontology, class_or_tag: str, *, time_limit_s: Seconds | None = None, cache: Path | None = None
) -> tuple[str, ...]:
    """Return the sorted names of the individuals that belong to a class or tag, asserted or inferred.

    `cache` is a folder for answers that are kept between runs. Raises UnknownNameError for a name that
    is no class, TagError for a tag that can't be read, InputError for an ontology that can't be reasoned with,
    ReasonerTimeoutError if the time limit is too short.
    """
    name = normal(class_or_tag.strip())
    if name in ontology.individuals and name not in ontology.classes:
        raise UnknownNameError(f"{name!r} is an individual, but a class is expected here")
    parse_tag(name, ontology)
    tags = {f"{{{ontology.in_tag(iri)}}}": individual for individual, iri in ontology.individuals.items()}
    found = match([*tags], [name], ontology, time_limit_s=time_limit_s, cache=cache)
    if found.similarity.open:
        message = f"it could not be decided in {time_limit_s} s which individuals belong to {name!r}"
        raise ReasonerTimeoutError(message, "simplify the ontology, or name the individuals")
    return tuple(sorted(tags[tag] for tag in found.similarity.offers[name]))
