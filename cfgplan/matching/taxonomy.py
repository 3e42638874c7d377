"""A reasoner's answer: which class is below which."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable, Mapping
from typing import Final

from cfgplan.matching.concepts import NOTHING_IRI, THING_IRI

_INCLUSION: Final = re.compile(r"^\s*(SubClassOf|EquivalentClasses)\((.*)\)\s*$", re.MULTILINE)
_IRI: Final = re.compile(r"<([^<>]*)>")


class Taxonomy:
    """Subsumption between named classes, from the direct links and equivalences that a reasoner prints."""

    def __init__(self, equivalents: Iterable[Iterable[str]], links: Iterable[tuple[str, str]]) -> None:
        self._representative: dict[str, str] = {}
        for group in equivalents:
            first, *others = group
            for other in others:
                joined, into = self._of(other), self._of(first)
                if joined != into:
                    self._representative[joined] = into
        above: defaultdict[str, set[str]] = defaultdict(set)
        for lower, upper in links:
            above[self._of(lower)].add(self._of(upper))
        self._above: Mapping[str, set[str]] = above
        self._closed: dict[str, frozenset[str]] = {}

    def is_unsatisfiable(self, iri: str) -> bool:
        """Whether the class can have no members."""
        return self._of(iri) == self._of(NOTHING_IRI)

    def subsumes(self, upper: str, lower: str) -> bool:
        """Whether every member of `lower` is one of `upper`."""
        top = self._of(THING_IRI)
        wanted = self._of(upper)
        return wanted == top or self.is_unsatisfiable(lower) or wanted in self._ancestors(self._of(lower))

    def _of(self, iri: str) -> str:
        while iri in self._representative:
            iri = self._representative[iri]
        return iri

    def _ancestors(self, start: str) -> frozenset[str]:
        known = self._closed.get(start)
        if known is None:
            seen = {start}
            waiting = [start]
            while waiting:
                for upper in self._above.get(waiting.pop(), ()):
                    if upper not in seen:
                        seen.add(upper)
                        waiting.append(upper)
            known = self._closed[start] = frozenset(seen)
        return known


def read_taxonomy(text: str) -> Taxonomy:
    """Read the SubClassOf and EquivalentClasses axioms between named classes in functional syntax."""
    equivalents: list[list[str]] = []
    links: list[tuple[str, str]] = []
    for keyword, arguments in _INCLUSION.findall(text):
        names = _IRI.findall(arguments)
        if keyword == "EquivalentClasses":
            equivalents.append(names)
        elif len(names) == 2:
            links.append((names[0], names[1]))
    return Taxonomy(equivalents, links)
