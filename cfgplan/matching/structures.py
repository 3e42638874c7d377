"""Finite interpretations of an ontology's names, and their things that break an axiom.

A structure in which no thing breaks an axiom is a model: a statement that is false in it does not follow from the
ontology. Class expressions and axioms have the meaning of OWL 2 Direct Semantics (W3C, 2012). Literals are known only
as they are written, so that expressions about them have certain members and possible ones.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence, Set
from functools import cache
from itertools import combinations
from operator import ge, le
from typing import Final, TypeAlias

from cfgplan.matching import axioms
from cfgplan.matching.concepts import NOTHING_IRI, THING_IRI
from cfgplan.matching.expressions import BUILT_IN_ROLE
from cfgplan.matching.functional import Tree, leaves

_STRING: Final = "http://www.w3.org/2001/XMLSchema#string"
_DOMAIN: Final = "\0domain"
_WITH_DOMAIN: Final = frozenset(
    (
        *("ObjectComplementOf", "ObjectAllValuesFrom", "ObjectMinCardinality", "ObjectMaxCardinality"),
        *("ObjectExactCardinality", "DataAllValuesFrom", "DataMinCardinality", "DataMaxCardinality"),
        "DataExactCardinality",
    )
)
_BUILT_IN_PROPERTIES: Final = frozenset(
    f"{BUILT_IN_ROLE}{which}{kind}Property" for which in ("top", "bottom") for kind in ("Object", "Data")
)

RoleLinks: TypeAlias = Mapping[int, Set[int]]


class Interpretation:
    """Things (numbers), the classes that they are in, the links between them, and the literals that they have."""

    def __init__(self) -> None:
        self.things: set[int] = set()
        self.individuals: dict[str, int] = {}
        self.classes: defaultdict[str, set[int]] = defaultdict(set)
        self.values: defaultdict[str, defaultdict[int, set[Tree]]] = defaultdict(lambda: defaultdict(set))
        self._links: defaultdict[str, defaultdict[int, set[int]]] = defaultdict(lambda: defaultdict(set))
        self._back: defaultdict[str, defaultdict[int, set[int]]] = defaultdict(lambda: defaultdict(set))
        self._changed: defaultdict[str, int] = defaultdict(int)
        self._clock = 0
        self._next = 0
        self._known: dict[tuple[Tree, bool], tuple[int, Set[int]]] = {}

    @property
    def clock(self) -> int:
        """The number of changes so far."""
        return self._clock

    def has_changed(self, symbols: Iterable[str], since: int) -> bool:
        """Whether the extension of any of these symbols changed after `since` (a value of `clock`)."""
        return any(self._changed[symbol] > since for symbol in symbols)

    def _touch(self, symbol: str) -> bool:
        self._clock += 1
        self._changed[symbol] = self._clock
        return True

    def add_thing(self) -> int:
        """Add a thing that is in no class and has no links. Returns its number."""
        thing = self._next
        self._next += 1
        self.things.add(thing)
        self._touch(_DOMAIN)
        return thing

    def put(self, name: str, things: Set[int]) -> bool:
        """Make things members of a class. Returns whether some were not."""
        members = self.classes[name]
        if things <= members:
            return False
        members |= things
        return self._touch(name)

    def link(self, role: Tree, source: int, target: int) -> bool:
        """Link one thing to another. Returns whether the link is new."""
        if isinstance(role, tuple):
            return self.link(role[1], target, source)
        targets = self._links[role][source]
        if target in targets:
            return False
        targets.add(target)
        self._back[role][target].add(source)
        return self._touch(role)

    def give(self, name: str, thing: int, value: Tree) -> bool:
        """Give a thing a literal, or something of a datatype. Returns whether it is new."""
        values = self.values[name][thing]
        if value in values:
            return False
        values.add(value)
        return self._touch(name)

    def successors(self, role: Tree) -> RoleLinks:
        if isinstance(role, tuple):
            return self.predecessors(role[1])
        return self._links.get(role, {})

    def predecessors(self, role: Tree) -> RoleLinks:
        if isinstance(role, tuple):
            return self.successors(role[1])
        return self._back.get(role, {})

    def valued(self, name: Tree) -> Mapping[int, Set[Tree]]:
        """The literals that things have for a data property."""
        return self.values.get(str(name), {})

    def merge(self, kept: int, gone: int) -> None:
        """Merge `gone` into `kept`."""
        self.things.discard(gone)
        for name, thing in self.individuals.items():
            if thing == gone:
                self.individuals[name] = kept
        for members in self.classes.values():
            if gone in members:
                members.discard(gone)
                members.add(kept)
        for values in self.values.values():
            if gone in values:
                values[kept] |= values.pop(gone)
        for role in list(self._links):
            links = [(gone, target) for target in self._links[role].get(gone, ())]
            links += [(source, gone) for source in self._back[role].get(gone, ())]
            for source, target in links:
                self._unlink(role, source, target)
            for source, target in links:
                self.link(role, kept if source == gone else source, kept if target == gone else target)
        self._forget_all()

    def remove(self, things: Set[int]) -> None:
        """Remove things with their memberships, links and literals."""
        self.things -= things
        for members in self.classes.values():
            members -= things
        for values in self.values.values():
            for thing in things & values.keys():
                del values[thing]
        for role in list(self._links):
            links, back = self._links[role], self._back[role]
            lost = [(source, target) for source in things & links.keys() for target in links[source]]
            lost += [(source, target) for target in things & back.keys() for source in back[target]]
            for source, target in lost:
                self._unlink(role, source, target)
        self._forget_all()

    def _unlink(self, role: str, source: int, target: int) -> None:
        self._links[role][source].discard(target)
        self._back[role][target].discard(source)

    def _forget_all(self) -> None:
        self._known.clear()
        self._clock += 1
        for symbol in self._changed:
            self._changed[symbol] = self._clock

    def members(self, tree: Tree, certain: bool) -> Set[int]:
        """The members of a class expression: the `certain` ones only, or all that may be. Not to be changed.

        Raises KeyError for an individual that the structure doesn't have.
        """
        if isinstance(tree, str):
            return self.things if tree == THING_IRI else self.classes.get(tree, frozenset())
        known = self._known.get((tree, certain))
        if known is not None and not self.has_changed(symbols_of(tree), known[0]):
            return known[1]
        found = self._find(tree, certain)
        self._known[tree, certain] = self._clock, found
        return found

    def _find(self, tree: tuple[Tree, ...], certain: bool) -> Set[int]:
        keyword, *parts = tree
        match keyword:
            case "ObjectIntersectionOf":
                first, *others = sorted((self.members(part, certain) for part in parts), key=len)
                return set(first).intersection(*others)
            case "ObjectUnionOf":
                return set().union(*(self.members(part, certain) for part in parts))
            case "ObjectComplementOf":
                return self.things - self.members(parts[0], not certain)
            case "ObjectOneOf":
                return {self.individuals[str(name)] for name in parts}
            case "ObjectHasValue":
                return self.predecessors(parts[0]).get(self.individuals[str(parts[1])], set())
            case "ObjectHasSelf":
                return {thing for thing, targets in self.successors(parts[0]).items() if thing in targets}
            case "ObjectSomeValuesFrom":
                return self._linked_to(parts[0], self.members(parts[1], certain))
            case "ObjectAllValuesFrom":
                return self.things - self._linked_to(parts[0], self.things - self.members(parts[1], certain))
            case "ObjectMinCardinality":
                return self._counted(parts, certain, ge)
            case "ObjectMaxCardinality":
                return self._counted(parts, not certain, le)
            case "ObjectExactCardinality":
                least, most = (("ObjectMinCardinality", *parts), ("ObjectMaxCardinality", *parts))
                return self.members(least, certain) & self.members(most, certain)
        return self._with_values(str(keyword), parts, certain)

    def _linked_to(self, role: Tree, targets: Set[int]) -> Set[int]:
        back = self.predecessors(role)
        return set().union(*(back[target] for target in targets & back.keys()))

    def _counted(self, parts: list[Tree], certain: bool, fits: Callable[[int, int], bool]) -> Set[int]:
        number, links = int(str(parts[0])), self.successors(parts[1])
        fillers = self.members(parts[2], certain) if len(parts) > 2 else self.things
        return {thing for thing in self.things if fits(len(links.get(thing, set()) & fillers), number)}

    def _with_values(self, keyword: str, parts: list[Tree], certain: bool) -> Set[int]:
        """The members of an expression about literals; everything may be in one that is not understood."""
        if keyword in ("DataSomeValuesFrom", "DataHasValue", "DataAllValuesFrom") and len(parts) == 2:
            values, wanted = self.valued(parts[0]), parts[1]
            if keyword == "DataAllValuesFrom":
                doubtful = {x for x, own in values.items() if not all(surely_in(value, wanted) for value in own)}
                return self.things - doubtful if certain else self.things
            if not certain:
                return {thing for thing, own in values.items() if own}
            if keyword == "DataHasValue":
                return {thing for thing, own in values.items() if wanted in own}
            return {thing for thing, own in values.items() if any(surely_in(value, wanted) for value in own)}
        if keyword == "DataMinCardinality" and certain and str(parts[0]) == "1" and len(parts) == 3:
            return self.members(("DataSomeValuesFrom", *parts[1:]), True)
        if keyword == "DataMaxCardinality" and certain:
            number = int(str(parts[0]))
            return self.things - {thing for thing, own in self.valued(parts[1]).items() if len(own) > number}
        if keyword == "DataExactCardinality":
            least, most = ("DataMinCardinality", *parts), ("DataMaxCardinality", *parts)
            return self.members(least, certain) & self.members(most, certain)
        return set() if certain else self.things

    def broken(self, statement: axioms.Statement) -> Set[int]:
        """The things that break a statement, or may break it. If there are none, it holds.

        If there are any, it may hold once they are removed.
        """
        match statement:
            case axioms.Subclass(sub, sup):
                return self.members(sub, False) - self.members(sup, True)
            case axioms.DisjointExpressions(parts):
                counts = Counter(thing for part in parts for thing in self.members(part, False))
                return {thing for thing, times in counts.items() if times > 1}
            case axioms.Subrole(sub, sup):
                above = self.successors(sup)
                return {x for x, targets in linked_by(self, sub) if not targets <= above.get(x, set())}
            case axioms.DisjointRoles(roles):
                pairs = combinations(map(self.successors, roles), 2)
                return {x for one, other in pairs for x in one.keys() & other.keys() if one[x] & other[x]}
            case axioms.Subvalue(sub, sup):
                given = self.valued(sup)
                return {x for x, own in self.valued(sub).items() if not own <= given.get(x, set())}


def checks_of(axiom: Tree) -> Sequence[axioms.Statement]:
    """The statements by which an axiom holds in a structure; for one that is not understood, one that nothing keeps."""
    statements = None if not _BUILT_IN_PROPERTIES.isdisjoint(leaves(axiom)) else axioms.statements_of(axiom)
    return (axioms.Subclass(THING_IRI, NOTHING_IRI),) if statements is None else statements


def linked_by(structure: Interpretation, chain: Tree) -> Iterator[tuple[int, Set[int]]]:
    """Yield each thing with the things that a role or a chain of roles links it to."""
    roles = chain[1:] if isinstance(chain, tuple) and chain[0] == "ObjectPropertyChain" else (chain,)
    first, *others = map(structure.successors, roles)
    for thing, targets in first.items():
        reached: Set[int] = targets
        for links in others:
            reached = set().union(*(links[target] for target in reached & links.keys()))
        yield thing, reached


def surely_in(value: Tree, datatype: Tree) -> bool:
    """Whether a literal, or something of a datatype, is in a datatype for certain."""
    if datatype == axioms.LITERAL:
        return True
    if isinstance(value, tuple):
        return value[1] == datatype
    return value.endswith(f'"^^<{datatype}>') or (datatype == _STRING and value.endswith('"'))


@cache
def symbols_of(tree: Tree) -> frozenset[str]:
    """The names on which the members of an expression depend."""
    if isinstance(tree, str):
        return frozenset((_DOMAIN if tree == THING_IRI else tree,))
    return frozenset().union(*map(symbols_of, tree[1:]), {_DOMAIN} if tree[0] in _WITH_DOMAIN else ())
