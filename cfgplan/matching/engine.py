"""The fast engine: what tags mean under one ontology, with a certificate where nothing can be missing."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

from cfgplan.matching.concepts import AtLeast, AtMost, Complement, Concept, Intersection, Nominal, Only, Some, Union
from cfgplan.matching.descriptions import Description, Descriptions, disjuncts
from cfgplan.matching.functional import Tree
from cfgplan.matching.queries import Demand, Demands
from cfgplan.matching.rules import BOTTOM_ATOM, Rules
from cfgplan.matching.saturation import Saturation
from cfgplan.matching.translation import translate


@dataclass(frozen=True, slots=True)
class Offer:
    """What follows for an offered tag: one description for each of its satisfiable disjuncts.

    If `certified`, it meets exactly the demands that all its disjuncts are found to meet; otherwise perhaps more.
    """

    disjuncts: tuple[Description, ...]
    certified: bool


class FastEngine:
    """Offers and demands of tags. Every match that it finds holds; `Offer` says when no others do.

    `outside` maps every axiom that is outside the fragment or was dropped to the reason. If there is one, nothing is
    certified.
    """

    def __init__(
        self, trees: Mapping[str, Tree], roles_of_tags: Collection[str] = (), dropped: Mapping[str, str] | None = None
    ) -> None:
        translation = translate(trees, roles_of_tags)
        self.rules = Rules(translation)
        self.outside = {**translation.outside, **(dropped or {})}
        if self.rules.outside_chain is not None:
            self.outside[self.rules.outside_chain] = "its last property lacks the range of the whole chain"
        self._replaced_roles = translation.replaced_roles
        self.saturation = Saturation(self.rules)
        self._descriptions = Descriptions(self.saturation)
        self._demands = Demands(self.rules)

    @property
    def is_inconsistent(self) -> bool:
        """Whether the ontology is found to contradict itself."""
        return self.saturation.is_inconsistent

    def take_in(self, added: Mapping[str, Tree], removed: Mapping[str, Tree], left: Collection[str]) -> bool:
        """Take in a change of the ontology. Returns whether it could; if not, the engine must not be used any more.

        `left` are the individuals of the ontology after the change. The engine can take in whole individuals that come
        and go and say nothing new of others.
        """
        gone, come = _subjects(removed), _subjects(added)
        if gone is None or come is None or self._replaced_roles or not gone.isdisjoint(left):
            return False
        known = self.rules.atoms
        if any(Nominal(name) in known for name in come) or not all(Nominal(name) in known for name in gone):
            return False
        translation = translate(added)
        if translation.outside or not self.saturation.let_individuals_go(known[Nominal(name)] for name in gone):
            return False
        self.rules.say(translation.inclusions)
        newcomers = [self.rules.atom(Nominal(name)) for name in sorted(come)]
        return self.saturation.let_individuals_come(newcomers) and not self.is_inconsistent

    def offer(self, concept: Concept) -> Offer:
        """What follows for an offered tag."""
        parts, exact = disjuncts(concept)
        described = [self._descriptions.of(part) for part in parts]
        possible = tuple(description for description in described if BOTTOM_ATOM not in description.atoms)
        certified = not possible or (
            exact
            and not self.outside
            and not any(description.conditional for description in described)
            and not self._is_about_replaced_role(concept)
        )
        return Offer(possible, certified)

    def demands(self, concept: Concept) -> tuple[Demand, ...] | None:
        """The alternatives of a demanded tag: meeting any one of them meets the tag. None if the engine can't
        express it.
        """
        parts, exact = disjuncts(concept)
        if not exact or self._is_about_replaced_role(concept):
            return None
        return tuple(map(self._demands.of, parts))

    def forget(self, concept: Concept) -> None:
        """Drop what is known of an offered tag that is no longer used."""
        for part in disjuncts(concept)[0]:
            self._descriptions.forget(part)

    def _is_about_replaced_role(self, concept: Concept) -> bool:
        return bool(self._replaced_roles) and not self._replaced_roles.isdisjoint(roles_in(concept))


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
    match concept:
        case Some(role, filler) | Only(role, filler) | AtLeast(_, role, filler) | AtMost(_, role, filler):
            return {role} | roles_in(filler)
        case Intersection(parts) | Union(parts):
            return set().union(*map(roles_in, parts))
        case Complement(part):
            return roles_in(part)
    return set()
