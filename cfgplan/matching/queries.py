"""Which descriptions satisfy a demanded concept: the demand is looked up, not derived.

A demand is a set of wants, all of which must be met: an atom, or a restriction (a role and a demand on its filler).
Families index their members by atoms and links, so that a demand costs a few set intersections.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Hashable, Iterable, Iterator
from typing import Any, Final, Generic, Protocol, TypeAlias, TypeVar

from cfgplan.matching.concepts import TOP, Concept, Intersection, Some
from cfgplan.matching.rules import TOP_ATOM, Rules
from cfgplan.matching.saturation import Context, Edge

_FEW_MEMBERS: Final = 64
"""Up to this many new members are checked one by one; with more, a row is found anew."""


class Want:
    """A restriction that a demand asks for: a link by `role` to something that meets `filler`."""

    __slots__ = ("filler", "role")

    def __init__(self, role: int, filler: Demand) -> None:
        self.role = role
        self.filler = filler


class Demand:
    """Requirements that must all be met: `atoms` to have, `wants` to have links for."""

    __slots__ = ("atoms", "wants")

    def __init__(self, atoms: frozenset[int], wants: frozenset[Want]) -> None:
        self.atoms = atoms
        self.wants = wants


class Demands:
    """Turns concepts into demands. Equal concepts give the same object, so that rows can be remembered by it."""

    def __init__(self, rules: Rules) -> None:
        self._rules = rules
        self._demands: dict[tuple[frozenset[int], frozenset[Want]], Demand] = {}
        self._wants: dict[Some, Want] = {}

    def of(self, concept: Concept) -> Demand:
        """The demand of a conjunction of names, nominals and restrictions, without ⊔."""
        atoms: list[int] = []
        wants: list[Want] = []
        for part in concept.parts if isinstance(concept, Intersection) else (concept,):
            if isinstance(part, Some):
                want = self._wants.get(part)
                if want is None:
                    want = self._wants[part] = Want(self._rules.role(part.role), self.of(part.filler))
                wants.append(want)
            elif part != TOP:
                atoms.append(self._rules.atom(part))
        key = frozenset(atoms), frozenset(wants)
        known = self._demands.get(key)
        if known is None:
            known = self._demands[key] = Demand(*key)
        return known


class Described(Protocol):
    """A context or a description: atoms and links."""

    @property
    def atoms(self) -> set[int] | frozenset[int]: ...

    @property
    def edges(self) -> frozenset[Edge]: ...


class Fillers:
    """The contexts that links lead to, and which of them meet a demand."""

    def __init__(self) -> None:
        self._family: Family[Context] = Family(self)
        self._met: dict[tuple[Context, Demand], bool] = {}

    def add(self, edges: Iterable[Edge]) -> None:
        """Take in what these links lead to, and further."""
        waiting = [target for _, target in edges]
        while waiting:
            context = waiting.pop()
            if context not in self._family:
                self._family.add(context, context)
                waiting += [target for _, target in context.edges]

    def meeting(self, demand: Demand) -> Iterable[Context]:
        """The contexts that meet a demand."""
        return self._family.row(demand)

    def meets(self, described: Described, demand: Demand) -> bool:
        """Whether something has all that is demanded."""
        return demand.atoms <= described.atoms and all(self.has_link(described, want) for want in demand.wants)

    def has_link(self, described: Described, want: Want) -> bool:
        """Whether something has a link that is wanted."""
        return any(role == want.role and self._target_meets(target, want.filler) for role, target in described.edges)

    def _target_meets(self, target: Context, demand: Demand) -> bool:
        known = self._met.get((target, demand))
        if known is None:
            known = self._met[target, demand] = self.meets(target, demand)
        return known


_Member = TypeVar("_Member", bound=Hashable)
_Row: TypeAlias = "set[_Member] | frozenset[_Member]"


class Family(Generic[_Member]):
    """Members with their descriptions, indexed by atoms and links, and the rows of demands."""

    def __init__(self, fillers: Fillers) -> None:
        self._fillers = fillers
        self._described: dict[_Member, Described] = {}
        self._order: list[_Member] = []
        self._with_atom: defaultdict[int, set[_Member]] = defaultdict(set)
        self._with_link: defaultdict[Edge, set[_Member]] = defaultdict(set)
        self._rows: dict[Want, tuple[int, set[_Member]]] = {}

    def __contains__(self, member: object) -> bool:
        return member in self._described

    def __len__(self) -> int:
        return len(self._described)

    def __getitem__(self, member: _Member) -> Described:
        return self._described[member]

    def add(self, member: _Member, described: Described) -> None:
        """Take in a member."""
        self._described[member] = described
        self._order.append(member)
        for atom in described.atoms:
            self._with_atom[atom].add(member)
        for edge in described.edges:
            self._with_link[edge].add(member)

    def remove(self, member: _Member) -> None:
        """Forget a member."""
        described = self._described.pop(member)
        for atom in described.atoms:
            self._with_atom[atom].discard(member)
        for edge in described.edges:
            self._with_link[edge].discard(member)
        for _, row in self._rows.values():
            row.discard(member)
        if len(self._order) > 2 * len(self._described) + _FEW_MEMBERS:
            self._order = list(self._described)
            self._rows.clear()

    def count(self, atom: int) -> int:
        """How many members have an atom."""
        return len(self._with_atom.get(atom, ()))

    def row(self, demand: Demand) -> _Row[_Member]:
        """The members that meet a demand; not to be changed."""
        sets: list[_Row[_Member]] = [self._with_atom.get(atom, frozenset()) for atom in demand.atoms]
        sets.extend(map(self._linked, demand.wants))
        if not sets:
            return self._with_atom.get(TOP_ATOM, frozenset())
        if len(sets) == 1:
            return sets[0]
        sets.sort(key=len)
        return sets[0].intersection(*sets[1:])

    def _linked(self, want: Want) -> set[_Member]:
        seen, row = self._rows.get(want, (0, set()))
        order = self._order
        if seen == len(order) and want in self._rows:
            return row
        if want in self._rows and len(order) - seen <= _FEW_MEMBERS:
            for member in order[seen:]:
                if member in self._described and self._fillers.has_link(self._described[member], want):
                    row.add(member)
        else:
            row = set()
            for target in list(self._fillers.meeting(want.filler)):
                row |= self._with_link.get((want.role, target), frozenset())
        self._rows[want] = len(order), row
        return row


MemberKey: TypeAlias = "int | tuple[int, int] | None"
"""What everything that meets a demand has: an atom, or a link by a role to something with an atom."""


class DemandIndex:
    """Demands by one thing that each of them needs, so that a new member is checked against few."""

    def __init__(self, fillers: Fillers) -> None:
        self._fillers = fillers
        self._by_key: defaultdict[MemberKey, dict[Demand, None]] = defaultdict(dict)

    def add(self, demand: Demand, family: Family[Any]) -> None:
        """Take in a demand under its atom that the fewest members have."""
        if demand.atoms:
            self._by_key[min(demand.atoms, key=lambda atom: (family.count(atom), atom))][demand] = None
        else:
            self._by_key[_key_of_links(demand)][demand] = None

    def remove(self, demand: Demand) -> None:
        """Forget a demand."""
        for key in (*demand.atoms, _key_of_links(demand)):
            self._by_key[key].pop(demand, None)

    def met_by(self, described: Described) -> Iterator[Demand]:
        """The demands that something meets."""
        keys: set[MemberKey] = {None, *described.atoms}
        for role, target in described.edges:
            keys.update((role, atom) for atom in target.atoms)
        for key in keys & self._by_key.keys():
            for demand in self._by_key[key]:
                if self._fillers.meets(described, demand):
                    yield demand


def _key_of_links(demand: Demand) -> MemberKey:
    keys = [(want.role, max(want.filler.atoms, default=TOP_ATOM)) for want in demand.wants]
    return max(keys, default=None)
