"""What follows for the things that a tag describes, combined from what follows for its parts.

The atoms of a conjunction are those of its conjuncts and what rules with two premises add; its links are theirs. So a
tag costs a few set unions once the names and restrictions in it are known.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from cfgplan.matching.concepts import (
    TOP,
    AtLeast,
    Concept,
    Intersection,
    Named,
    Nominal,
    Some,
    Union,
    conjunction,
    some,
)
from cfgplan.matching.rules import BOTTOM_ATOM, Rules
from cfgplan.matching.saturation import Context, Edge, Saturation

MOST_DISJUNCTS: Final = 64
"""The largest number of disjuncts of a tag that the fast engine takes; the reference decides tags with more."""


class Description:
    """What follows for the things of one kind: atoms, links (`edges`), and whether something may be missing."""

    __slots__ = ("atoms", "conditional", "edges")

    def __init__(self, atoms: frozenset[int], edges: frozenset[Edge], conditional: bool) -> None:
        self.atoms = atoms
        self.edges = edges
        self.conditional = conditional


class Descriptions:
    """The descriptions of tags under one ontology; parts that tags share are worked out once."""

    def __init__(self, saturation: Saturation) -> None:
        self._saturation = saturation
        self._rules: Rules = saturation.rules
        self._of_atom: dict[int, Description] = {}
        self._of_link: dict[Edge, Description] = {}
        self._of_concept: dict[Concept, Description] = {}
        self._fillers: dict[tuple[Concept, frozenset[int]], Context] = {}
        self._top = self._of_context(saturation.top)

    def of(self, concept: Concept) -> Description:
        """What follows for a conjunction of names, nominals and existential restrictions, without ⊔."""
        known = self._of_concept.get(concept)
        if known is None:
            known = self._of_concept[concept] = self._describe(concept, frozenset())
        return known

    def forget(self, concept: Concept) -> None:
        """Drop what is known of a tag that is no longer used."""
        self._of_concept.pop(concept, None)

    def _describe(self, concept: Concept, extra: frozenset[int]) -> Description:
        parts = concept.parts if isinstance(concept, Intersection) else (concept,)
        described: list[Description] = []
        nominals: list[int] = []
        for part in parts:
            if isinstance(part, Some):
                described.append(self._link(part))
            else:
                atom = self._rules.atom(part)
                if isinstance(part, Nominal):
                    nominals.append(atom)
                described.append(self._atom(atom))
        described.extend(map(self._atom, extra))
        if len(described) == 1:
            return described[0]
        joined = self._join(described)
        if nominals and not joined.conditional:
            # {a} ⊓ C is {a} where a is a C anyhow; else it says something of a that holds only if it has members.
            individual = self._atom(nominals[0])
            if len(nominals) == 1 and joined.atoms == individual.atoms and joined.edges <= individual.edges:
                return individual
            return Description(joined.atoms, joined.edges, True)
        return joined

    def _atom(self, atom: int) -> Description:
        known = self._of_atom.get(atom)
        if known is None:
            known = self._of_atom[atom] = self._of_context(self._saturation.context((atom,)))
        return known

    def _link(self, restriction: Some) -> Description:
        role = self._rules.role(restriction.role)
        target = self._filler(restriction.filler, self._rules.ranges[role])
        edge = (role, target)
        known = self._of_link.get(edge)
        if known is None:
            known = self._of_link[edge] = self._follow(edge)
        return known

    def _follow(self, edge: Edge) -> Description:
        """What follows from having one link: the roles above, chains through the target, and restrictions met."""
        rules = self._rules
        role, target = edge
        conditional = self._saturation.is_conditional_link(role, target)
        edges: set[Edge] = set()
        waiting = [edge]
        while waiting:
            first, end = waiting.pop()
            for upper in rules.supers[first]:
                if (upper, end) in edges:
                    continue
                edges.add((upper, end))
                for second, composed in rules.chains.get(upper, ()):
                    waiting.extend((composed, further) for linked, further in end.edges if linked == second)
        heads: set[int] = set()
        for upper, end in edges:
            restrictions = rules.left.get(upper)
            if restrictions:
                for atom in restrictions.keys() & end.atoms:
                    heads |= restrictions[atom]
        if target.is_unsatisfiable:
            heads.add(BOTTOM_ATOM)
        own = Description(frozenset(), frozenset(edges), conditional)
        return self._join([self._top, own, *map(self._atom, heads)])

    def _filler(self, filler: Concept, ranges: frozenset[int]) -> Context:
        known = self._fillers.get((filler, ranges))
        if known is not None:
            return known
        parts = filler.parts if isinstance(filler, Intersection) else (filler,)
        context: Context
        if isinstance(filler, Nominal):
            context = self._saturation.context((self._rules.atom(filler),))
        elif all(isinstance(part, Named) for part in parts):
            atoms = frozenset(map(self._rules.atom, parts)) | ranges
            context = self._saturation.context(atoms)
        else:
            context = self._anonymous(filler, ranges)
        self._fillers[filler, ranges] = context
        return context

    def _anonymous(self, filler: Concept, ranges: frozenset[int]) -> Context:
        """The context of a nested restriction, or of an individual that a tag says more about."""
        described = self._describe(filler, ranges)
        parts = filler.parts if isinstance(filler, Intersection) else (filler,)
        for part in parts:
            if isinstance(part, Nominal) and described is self._of_atom[self._rules.atom(part)]:
                return self._saturation.context((self._rules.atom(part),))
        context = Context(frozenset())
        context.atoms = set(described.atoms)
        context.edges = described.edges
        context.conditional = described.conditional
        return context

    def _join(self, parts: Iterable[Description]) -> Description:
        parts = list(parts)
        atoms = set().union(*(part.atoms for part in parts))
        joint = self._rules.joint
        waiting = list(joint.keys() & atoms)
        while waiting:
            one = waiting.pop()
            for other in joint[one].keys() & atoms:
                for head in joint[one][other] - atoms:
                    further = self._atom(head)
                    parts.append(further)
                    waiting.extend(joint.keys() & (further.atoms - atoms))
                    atoms |= further.atoms
        edges = frozenset().union(*(part.edges for part in parts))
        return Description(frozenset(atoms), edges, any(part.conditional for part in parts))

    @staticmethod
    def _of_context(context: Context) -> Description:
        return Description(frozenset(context.atoms), context.edges, context.conditional)


def disjuncts(concept: Concept) -> tuple[tuple[Concept, ...], bool]:
    """Conjunctions without ⊔ whose union is the tag, and True; or whose union is more general, and False.

    What the engine has no words for is left out of conjunctions, which makes them more general. Too many disjuncts
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
    if isinstance(concept, Named | Nominal):
        return True
    if isinstance(concept, Some):
        return _is_conjunctive(concept.filler)
    return isinstance(concept, Intersection) and all(map(_is_conjunctive, concept.parts))
