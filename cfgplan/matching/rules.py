"""Statements in the normal form of the fast engine: rules over numbered atoms and roles.

An atom is a concept that the engine tracks: a name, a nominal, or a part of an axiom that got a number of its own.
Reference: F. Baader, S. Brandt, C. Lutz, "Pushing the EL Envelope", IJCAI 2005, section 4.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from typing import Final

from cfgplan.matching.concepts import BOTTOM, TOP, Concept, Intersection, Nominal, Some, Union
from cfgplan.matching.translation import Inclusion, Translation
from cfgplan.onward import reached

TOP_ATOM: Final = 0
BOTTOM_ATOM: Final = 1


class Rules:
    """Indexed rules; each also remembers the axiom that it comes from, for explanations.

    `sub[A]` holds the B of A ⊑ B; `joint[A][B]` the C of A ⊓ B ⊑ C, both ways round; `right[A]` the (r, atoms) of
    A ⊑ ∃r.⊓atoms; `left[r][B]` the C of ∃r.B ⊑ C; `supers[r]` all roles above r and r; `chains[r]` the (s, t) and
    `chained[s]` the (r, t) of r ∘ s ⊑ t; `ranges[r]` the atoms that everything r points to has.
    """

    def __init__(self, translation: Translation) -> None:
        self.atoms: dict[Concept, int] = {TOP: TOP_ATOM, BOTTOM: BOTTOM_ATOM}
        self.concepts: list[Concept] = [TOP, BOTTOM]
        self.individuals: dict[int, str] = {}
        self.roles: dict[str, int] = {}
        self.role_names: list[str] = []
        self.sub: defaultdict[int, set[int]] = defaultdict(set)
        self.joint: defaultdict[int, dict[int, set[int]]] = defaultdict(dict)
        self.right: defaultdict[int, set[tuple[int, frozenset[int]]]] = defaultdict(set)
        self.left: defaultdict[int, dict[int, set[int]]] = defaultdict(dict)
        self.supers: list[frozenset[int]] = []
        self.chains: defaultdict[int, set[tuple[int, int]]] = defaultdict(set)
        self.chained: defaultdict[int, set[tuple[int, int]]] = defaultdict(set)
        self.ranges: list[frozenset[int]] = []
        self.origin: dict[tuple[object, ...], str] = {}
        self.new_premises: set[int] = set()
        """The atoms from which more follows since this set was cleared."""
        self._recognised: set[Concept] = set()
        self._implied: set[Concept] = set()
        self._direct_supers: defaultdict[int, set[int]] = defaultdict(set)
        self._direct_ranges: defaultdict[int, set[int]] = defaultdict(set)
        self.say(translation.inclusions)
        for inclusion in translation.role_inclusions:
            self._add_role_inclusion([self.role(role) for role in inclusion.chain], inclusion.role, inclusion.axiom)
        for declared in translation.ranges:
            role, atom = self.role(declared.role), self.atom(declared.concept)
            self._expand(atom, declared.axiom)
            self._direct_ranges[role].add(atom)
            self.origin[("range", role, atom)] = declared.axiom
        self._close_roles()
        self.outside_chain = self._chain_that_breaks_a_range()

    def say(self, inclusions: Iterable[Inclusion]) -> None:
        """Add the rules of inclusions; after the construction only of those about new individuals."""
        for inclusion in inclusions:
            self._imply(self.recognise(inclusion.sub), inclusion.sup, inclusion.axiom)

    def atom(self, concept: Concept) -> int:
        """The number of a concept, a new one if it has none."""
        number = self.atoms.get(concept)
        if number is None:
            number = self.atoms[concept] = len(self.concepts)
            self.concepts.append(concept)
            if isinstance(concept, Nominal):
                self.individuals[number] = concept.iri
        return number

    def role(self, name: str) -> int:
        """The number of a role, a new one if it has none."""
        number = self.roles.get(name)
        if number is None:
            number = self.roles[name] = len(self.role_names)
            self.role_names.append(name)
            self.supers.append(frozenset((number,)))
            self.ranges.append(frozenset())
        return number

    def recognise(self, concept: Concept) -> int:
        """Add rules that give every member of a concept of names, ⊓, ⊔ and ∃ its atom. Returns the atom."""
        atom = self.atom(concept)
        if concept in self._recognised:
            return atom
        self._recognised.add(concept)
        if isinstance(concept, Intersection):
            first, *others = sorted(map(self.recognise, concept.parts))
            for index, other in enumerate(others):
                last = index == len(others) - 1
                joined = atom if last else self._recognise_pair(first, other)
                if last:
                    self._join(first, other, joined)
                first = joined
        elif isinstance(concept, Union):
            for part in map(self.recognise, concept.parts):
                self.sub[part].add(atom)
                self.new_premises.add(part)
        elif isinstance(concept, Some):
            filler = self.recognise(concept.filler)
            self.left[self.role(concept.role)].setdefault(filler, set()).add(atom)
            self.new_premises.add(filler)
        return atom

    def _recognise_pair(self, one: int, other: int) -> int:
        parts = frozenset((self.concepts[one], self.concepts[other]))
        pair = self.atom(Intersection(parts))
        self._join(one, other, pair)
        return pair

    def _join(self, one: int, other: int, result: int) -> None:
        self.joint[one].setdefault(other, set()).add(result)
        self.joint[other].setdefault(one, set()).add(result)
        self.new_premises.add(one)

    def _imply(self, atom: int, concept: Concept, axiom: str) -> None:
        """Add rules that make everything with this atom a `concept`, which is a name, ⊓ or ∃."""
        if isinstance(concept, Intersection):
            for part in concept.parts:
                self._imply(atom, part, axiom)
            return
        if isinstance(concept, Some):
            parts = concept.filler.parts if isinstance(concept.filler, Intersection) else (concept.filler,)
            atoms = frozenset(map(self.atom, parts)) - {TOP_ATOM}
            for filler in atoms:
                self._expand(filler, axiom)
            role = self.role(concept.role)
            self.right[atom].add((role, atoms))
            self.origin.setdefault(("right", atom, role, atoms), axiom)
            return
        implied = self.atom(concept)
        if implied != atom:
            self.sub[atom].add(implied)
            self.origin.setdefault(("sub", atom, implied), axiom)

    def _expand(self, atom: int, axiom: str) -> None:
        """Add rules that make an atom of a complex concept imply that concept."""
        concept = self.concepts[atom]
        if isinstance(concept, Intersection | Some) and concept not in self._implied:
            self._implied.add(concept)
            self._imply(atom, concept, axiom)

    def _add_role_inclusion(self, chain: list[int], name: str, axiom: str) -> None:
        role = self.role(name)
        if len(chain) == 1:
            self._direct_supers[chain[0]].add(role)
            self.origin.setdefault(("role", chain[0], role), axiom)
            return
        first, *others = chain
        for index, other in enumerate(others):
            last = index == len(others) - 1
            target = role if last else self.role(f"{self.role_names[first]} ∘ {self.role_names[other]}")
            self.chains[first].add((other, target))
            self.chained[other].add((first, target))
            self.origin.setdefault(("chain", first, other, target), axiom)
            first = target

    def _close_roles(self) -> None:
        for role in range(len(self.role_names)):
            supers = reached((role,), self._direct_supers.__getitem__)
            for below in supers:
                for upper in self._direct_supers[below]:
                    self.origin.setdefault(("role", role, upper), self.origin["role", below, upper])
                for atom in self._direct_ranges[below]:
                    self.origin.setdefault(("range", role, atom), self.origin["range", below, atom])
            self.supers[role] = frozenset(supers)
            self.ranges[role] = frozenset(atom for upper in supers for atom in self._direct_ranges[upper])

    def _chain_that_breaks_a_range(self) -> str | None:
        """The axiom of a chain whose last role lacks the chain's range, which OWL EL forbids; None if there is none."""
        for first, pairs in self.chains.items():
            for second, target in pairs:
                if not self.ranges[target] <= self.ranges[second]:
                    return self.origin["chain", first, second, target]
        return None
