"""The fast engine: decides which offered concepts meet which demanded ones, and certifies results that miss no match.

One calculus does all of it (`saturation`). An offered concept is a context: the things that have it. A demanded concept
is an atom that rules give to each thing that has the concept. An offer meets a demand if its context has the atom.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Set
from dataclasses import dataclass
from typing import Final

from cfgplan.matching.concepts import (
    TOP,
    AtLeast,
    AtMost,
    Concept,
    Intersection,
    Named,
    Nominal,
    Only,
    Some,
    Union,
    conjunction,
    some,
    walk,
)
from cfgplan.matching.expressions import is_left_hand
from cfgplan.matching.functional import Tree
from cfgplan.matching.rules import Rules
from cfgplan.matching.saturation import Context, Edge, Saturation
from cfgplan.matching.translation import translate

MOST_DISJUNCTS: Final = 64
"""The most disjuncts of an offered concept that the engine takes; the reference decides those with more."""
_FEW_CONCEPTS: Final = 64
"""An engine is replaced once it knows this many more withdrawn concepts than there are present ones."""


@dataclass(frozen=True, slots=True)
class MatchedRows:
    """The engine's result for offered and demanded concepts.

    `met`: the offers that meet each demand; every match in it holds. For offers in `uncertified` and demands in
    `beyond_words`, further matches may hold; for all others, no further match holds. `impossible`: the unsatisfiable
    offers.
    """

    met: Mapping[Concept, Set[Concept]]
    impossible: frozenset[Concept]
    uncertified: frozenset[Concept]
    beyond_words: frozenset[Concept]


@dataclass(frozen=True, slots=True)
class _OfferContexts:
    """The contexts of the disjuncts of an offered concept that something can have, and whether they tell everything."""

    contexts: tuple[Context, ...]
    certified: bool


class FastEngine:
    """Matches concepts under one ontology.

    `outside` maps every axiom that is outside the fragment or was dropped to the reason. If there is one, nothing is
    certified.
    """

    def __init__(
        self, trees: Mapping[str, Tree], roles_of_tags: Collection[str] = (), dropped: Mapping[str, str] | None = None
    ) -> None:
        translation = translate(trees, roles_of_tags)
        self._rules = Rules(translation)
        self.outside = {**translation.outside, **(dropped or {})}
        if self._rules.outside_chain is not None:
            self.outside[self._rules.outside_chain] = "its last property lacks the range of the whole chain"
        self._replaced_roles = translation.replaced_roles
        self._saturation = Saturation(self._rules)
        self._offers: dict[Concept, _OfferContexts] = {}
        self._demands: dict[Concept, int | None] = {}

    @property
    def is_inconsistent(self) -> bool:
        """Whether the ontology is found to contradict itself."""
        return self._saturation.is_inconsistent

    def take_in(self, added: Mapping[str, Tree], removed: Mapping[str, Tree], left: Collection[str]) -> bool:
        """Take in a change of the ontology. Returns whether it could; if not, the engine must not be used any more.

        `left` are the individuals of the ontology after the change. The engine can take in whole individuals that come
        and go and say nothing new of others.
        """
        gone, come = _subjects(removed), _subjects(added)
        if gone is None or come is None or self._replaced_roles or not gone.isdisjoint(left):
            return False
        known = self._rules.atoms
        if any(Nominal(name) in known for name in come) or not all(Nominal(name) in known for name in gone):
            return False
        translation = translate(added)
        if translation.outside or not self._saturation.let_individuals_go(known[Nominal(name)] for name in gone):
            return False
        self._rules.say(translation.inclusions)
        newcomers = [self._rules.atom(Nominal(name)) for name in sorted(come)]
        return self._saturation.let_individuals_come(newcomers) and not self.is_inconsistent

    def is_too_large(self, concepts: int) -> bool:
        """Whether a new engine should take the place of this one, which knows many more concepts than are left."""
        return len(self._offers) + len(self._demands) > 2 * concepts + _FEW_CONCEPTS

    def rows(self, offered: Iterable[Concept], demanded: Iterable[Concept]) -> MatchedRows:
        """Match offered concepts with demanded ones. Earlier derivations are reused."""
        demands = {concept: self._demand(concept) for concept in demanded}
        concept_of = {atom: concept for concept, atom in demands.items() if atom is not None}
        self._saturation.learn()
        offers = {concept: self._offer(concept) for concept in offered}
        met: dict[Concept, set[Concept]] = {concept: set() for concept in demands}
        wanted = frozenset(concept_of)
        for concept, offer in offers.items():
            for atom in _shared(wanted, offer.contexts):
                met[concept_of[atom]].add(concept)
        return MatchedRows(
            met,
            frozenset(concept for concept, offer in offers.items() if not offer.contexts),
            frozenset(concept for concept, offer in offers.items() if not offer.certified),
            frozenset(concept for concept, atom in demands.items() if atom is None),
        )

    def _demand(self, concept: Concept) -> int | None:
        """The atom that says that something has a demanded concept; None if the engine has no words for it."""
        if concept not in self._demands:
            has_words = is_left_hand(concept) and not self._is_about_replaced_role(concept)
            self._demands[concept] = self._rules.recognise(concept) if has_words else None
        return self._demands[concept]

    def _offer(self, concept: Concept) -> _OfferContexts:
        known = self._offers.get(concept)
        if known is None:
            parts, is_exact = disjuncts(concept)
            contexts = [self._context(part) for part in parts]
            possible = tuple(context for context in contexts if not context.is_unsatisfiable)
            is_told = is_exact and not self.outside and not self._is_about_replaced_role(concept)
            certified = not possible or (is_told and not any(context.conditional for context in contexts))
            known = self._offers[concept] = _OfferContexts(possible, certified)
        return known

    def _context(self, concept: Concept, ranges: frozenset[int] = frozenset()) -> Context:
        """The context of a conjunction of names, nominals and ∃, whose members also have the atoms `ranges`."""
        atoms: set[int] = set()
        links: set[Edge] = set()
        for part in concept.parts if isinstance(concept, Intersection) else (concept,):
            if isinstance(part, Some):
                role = self._rules.role(part.role)
                links.add((role, self._context(part.filler, self._rules.ranges[role])))
            else:
                atoms.add(self._rules.atom(part))
        if isinstance(concept, Nominal):
            ranges = frozenset()  # a link to an individual says that it is in the range: see `Context.conditional`
        return self._saturation.context(atoms | ranges, links)

    def _is_about_replaced_role(self, concept: Concept) -> bool:
        return bool(self._replaced_roles) and not self._replaced_roles.isdisjoint(roles_in(concept))


def _shared(wanted: frozenset[int], contexts: Collection[Context]) -> Iterable[int]:
    """The wanted atoms that all contexts have; none without a context."""
    shared: Iterable[int] = ()
    for number, context in enumerate(contexts):
        shared = context.atoms.intersection(shared) if number else wanted & context.atoms
    return shared


def disjuncts(concept: Concept) -> tuple[tuple[Concept, ...], bool]:
    """Return conjunctions without ⊔: their union is the concept (True) or more general (False).

    Parts that the engine can't express are left out of conjunctions, which makes them more general. Too many disjuncts
    give (⊤,), False.
    """
    if _is_conjunctive(concept):
        return (concept,), True
    match concept:
        case Intersection(parts):
            found: list[Concept] = [TOP]
            exact = True
            for part in parts:
                options, is_exact = disjuncts(part)
                exact = exact and is_exact
                found = [conjunction((one, option)) for one in found for option in options]
                if len(found) > MOST_DISJUNCTS:
                    return (TOP,), False
            return tuple(dict.fromkeys(found)), exact
        case Union(parts):
            options_of_parts = [disjuncts(part) for part in parts]
            union = tuple(dict.fromkeys(option for options, _ in options_of_parts for option in options))
            if len(union) > MOST_DISJUNCTS:
                return (TOP,), False
            return union, all(is_exact for _, is_exact in options_of_parts)
        case Some(role, filler):
            options, exact = disjuncts(filler)
            return tuple(some(role, option) for option in options), exact
        case AtLeast(_, role, filler):
            options, _ = disjuncts(filler)
            return tuple(some(role, option) for option in options), False
        case _:
            return (TOP,), False


def _is_conjunctive(concept: Concept) -> bool:
    return all(isinstance(part, Named | Nominal | Some | Intersection) for part in walk(concept))


def _subjects(axioms: Mapping[str, Tree]) -> set[str] | None:
    """The individuals that simple assertions are about; None if some axiom is no simple assertion."""
    subjects: set[str] = set()
    for tree in axioms.values():
        if tree[0] in ("ClassAssertion", "ObjectPropertyAssertion") and isinstance(tree[1], str):
            subjects.add(str(tree[2]))
        elif tree[0] != "Declaration" or tree[1][0] != "NamedIndividual":
            return None
    return subjects


def roles_in(concept: Concept) -> set[str]:
    """The roles that a concept mentions."""
    return {part.role for part in walk(concept) if isinstance(part, Some | Only | AtLeast | AtMost)}
