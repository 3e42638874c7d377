"""The rows of the matrix as far as the fast engine knows them: for each demanded tag the offered tags that meet it."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping
from typing import Final, TypeAlias

from cfgplan.matching.concepts import Concept
from cfgplan.matching.descriptions import Description
from cfgplan.matching.engine import FastEngine, Offer
from cfgplan.matching.queries import Demand, DemandIndex, Family, Fillers

_FEW_CONCEPTS: Final = 64
"""Up to this many new offers are looked up in the demands one by one; with more, all rows are found anew."""

_RowMember: TypeAlias = "str | tuple[str, int]"
"""An offer's name, or its name with the number of a disjunct where it has several."""


class OfferRows:
    """Named offers and demanded concepts that come and go, and which offers meet which demand."""

    def __init__(self, engine: FastEngine) -> None:
        self._engine = engine
        self._fillers = Fillers()
        self._family: Family[_RowMember] = Family(self._fillers)
        self._index = DemandIndex(self._fillers)
        self._offers: dict[str, Offer] = {}
        self._several: set[str] = set()
        self._demands: dict[Concept, tuple[Demand, ...] | None] = {}
        self._asking: defaultdict[Demand, dict[Concept, None]] = defaultdict(dict)
        self._rows: dict[Concept, frozenset[str]] = {}
        self.uncertified: set[str] = set()
        """The names of offers for which something may be missing."""
        self.impossible: set[str] = set()
        """The names of offers that nothing can have."""
        self.beyond_words: set[Concept] = set()
        """The demands that the engine has no words for."""

    def add_offers(self, concepts: Mapping[str, Concept]) -> None:
        """Take in offers under names that are not yet taken."""
        for name, concept in concepts.items():
            offer = self._offers[name] = self._engine.offer(concept)
            if not offer.certified:
                self.uncertified.add(name)
            if not offer.disjuncts:
                self.impossible.add(name)
            elif len(offer.disjuncts) > 1:
                self._several.add(name)
            for member, description in _members(name, offer):
                self._fillers.add(description.edges)
                self._family.add(member, description)
        if len(concepts) > _FEW_CONCEPTS:
            self._rows.clear()
        elif self._rows:
            for name in concepts:
                self._add_to_rows(name)

    def remove_offer(self, name: str, concept: Concept) -> None:
        """Forget an offer."""
        offer = self._offers.pop(name)
        for demand in self._met_by(offer):
            row = self._rows.get(demand)
            if row is not None and name in row:
                self._rows[demand] = row - {name}
        for member, _ in _members(name, offer):
            self._family.remove(member)
        for names in (self._several, self.uncertified, self.impossible):
            names.discard(name)
        self._engine.forget(concept)

    def add_demand(self, concept: Concept) -> None:
        """Take in a demand."""
        demands = self._demands[concept] = self._engine.demands(concept)
        if demands is None:
            self.beyond_words.add(concept)
        for demand in demands or ():
            if not self._asking[demand]:
                self._index.add(demand, self._family)
            self._asking[demand][concept] = None

    def remove_demand(self, concept: Concept) -> None:
        """Forget a demand."""
        self._rows.pop(concept, None)
        self.beyond_words.discard(concept)
        for demand in self._demands.pop(concept) or ():
            self._asking[demand].pop(concept, None)
            if not self._asking[demand]:
                self._index.remove(demand)
                del self._asking[demand]

    def row(self, concept: Concept) -> frozenset[str]:
        """The names of the offers that are found to meet a demand."""
        row = self._rows.get(concept)
        if row is None:
            row = self._rows[concept] = self._find(concept)
        return row

    def _find(self, concept: Concept) -> frozenset[str]:
        demands = self._demands[concept] or ()
        found: frozenset[_RowMember] = frozenset()
        for demand in demands:
            found = found | self._family.row(demand) if found else frozenset(self._family.row(demand))
        if not self._several:
            return found  # type: ignore[return-value]  # every member is then a name
        named = {member for member in found if isinstance(member, str)}
        for name in self._several:
            if all(member in found for member, _ in _members(name, self._offers[name])):
                named.add(name)
        return frozenset(named)

    def _add_to_rows(self, name: str) -> None:
        for demand in self._met_by(self._offers[name]):
            row = self._rows.get(demand)
            if row is not None:
                self._rows[demand] = row | {name}

    def _met_by(self, offer: Offer) -> Iterable[Concept]:
        met: dict[Concept, int] = {}
        for description in offer.disjuncts:
            concepts = {concept for demand in self._index.met_by(description) for concept in self._asking[demand]}
            for concept in concepts:
                met[concept] = met.get(concept, 0) + 1
        return [concept for concept, times in met.items() if times == len(offer.disjuncts)]


def _members(name: str, offer: Offer) -> list[tuple[_RowMember, Description]]:
    if len(offer.disjuncts) == 1:
        return [(name, offer.disjuncts[0])]
    return [((name, number), description) for number, description in enumerate(offer.disjuncts)]
