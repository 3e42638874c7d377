"""Pairs of tags that certainly do not match, by finite models of the ontology.

One model in which a thing has the offered tag and not the demanded one shows that the offered tag is not below the
demanded one. To build models, the ontology is read as a program that gives things what its axioms say they have: a
union gives one of its parts (another in the next model), restrictions share the things that they need, at most n things
are made by merging. The resulting structure may say more than the ontology or break it, so it is checked: things that
break an axiom are removed with all things that need them, until no axiom is broken. The rest is a model of every axiom,
however it was built, as long as it has a thing for each individual. The answers rest on this check alone.

Reference for reading non-entailments from an upper bound of the ontology: Y. Zhou, B. Cuenca Grau, Y. Nenov, M.
Kaminski, I. Horrocks, "PAGOdA: Pay-as-you-go ontology query answering using a datalog reasoner", JAIR 54 (2015).
"""

from __future__ import annotations

import time
from collections.abc import Collection, Iterable, Iterator, Mapping, Set
from dataclasses import dataclass, field
from functools import cached_property
from typing import Final

from cfgplan.matching.axioms import LITERAL, Statement, Subclass, Subrole, Subvalue, inverse
from cfgplan.matching.concepts import (
    NOTHING_IRI,
    THING_IRI,
    AtMost,
    Complement,
    Concept,
    Intersection,
    Nominal,
    Only,
    in_functional_syntax,
    walk,
)
from cfgplan.matching.functional import Tree, leaves, parse, signature_of
from cfgplan.matching.literals import XSD
from cfgplan.matching.ontology import Ontology
from cfgplan.matching.structures import Interpretation, checks_of, linked_by, symbols_of

MOST_MODELS: Final = 8
"""The number of models built for the same tags; each prefers other parts of unions."""
MOST_BUILDS: Final = 40
"""The number of models begun for the tags of one call, failed ones included."""
LEVELS: Final = 3
"""A thing that a restriction created, and that falls under the same restriction, gets a thing of the next level;
after this many levels the first one is used again, so that models stay finite.
"""


class _OutOfTimeError(Exception):
    """Building took too much CPU time."""


@dataclass
class _Rule:
    """Members of a statement's left side become members of its right side. `seen` is the clock at its last
    application.
    """

    statement: Subclass | Subrole | Subvalue
    seen: int = -1


class _Program:
    """The axioms as rules, which say what the members of a class expression get."""

    def __init__(self, trees: Iterable[Tree], individuals: Set[str]) -> None:
        trees = [tree for tree in trees if tree[0] != "Declaration"]
        self.checks = [check for tree in trees for check in checks_of(tree)]
        anonymous = {leaf for tree in trees for leaf in leaves(tree) if leaf.startswith("_:")}
        self.individuals = sorted(signature_of(trees).individuals | anonymous | individuals)
        self.rules = [rule for check in self.checks for rule in _rules_of(check)]


def _rules_of(statement: Statement) -> Iterator[Subclass | Subrole | Subvalue]:
    """The parts of a statement that a model under construction can be made to satisfy."""
    match statement:
        case Subrole() | Subvalue():
            yield statement
        case Subclass(sub, ("ObjectIntersectionOf", *parts)):
            for part in parts:
                yield from _rules_of(Subclass(sub, part))
        case Subclass(sub, ("ObjectAllValuesFrom", role, filler)):
            yield from _rules_of(Subclass(("ObjectSomeValuesFrom", inverse(role), sub), filler))
        case Subclass(sub, ("ObjectComplementOf", part)):
            given = complement(part)
            if given[0] != "ObjectComplementOf":
                yield from _rules_of(Subclass(sub, given))
        case Subclass(sub, sup) if sup not in (THING_IRI, NOTHING_IRI) and sup[0] not in _ONLY_CHECKED:
            yield statement


def _some(changes: Iterable[bool]) -> bool:
    """Carry out all changes. Returns whether any did something."""
    return sum(changes) > 0


def complement(tree: Tree) -> Tree:
    """The complement of an expression in negation normal form."""
    if isinstance(tree, str):
        return {THING_IRI: NOTHING_IRI, NOTHING_IRI: THING_IRI}.get(tree) or ("ObjectComplementOf", tree)
    keyword, *parts = tree
    match keyword:
        case "ObjectComplementOf":
            return parts[0]
        case "ObjectIntersectionOf":
            return ("ObjectUnionOf", *map(complement, parts))
        case "ObjectUnionOf":
            return ("ObjectIntersectionOf", *map(complement, parts))
        case "ObjectSomeValuesFrom":
            return ("ObjectAllValuesFrom", parts[0], complement(parts[1]))
        case "ObjectAllValuesFrom":
            return ("ObjectSomeValuesFrom", parts[0], complement(parts[1]))
        case "ObjectMinCardinality" if int(str(parts[0])) > 0:
            return ("ObjectMaxCardinality", str(int(str(parts[0])) - 1), *parts[1:])
        case "ObjectMaxCardinality":
            return ("ObjectMinCardinality", str(int(str(parts[0])) + 1), *parts[1:])
    return ("ObjectComplementOf", tree)


_ONLY_CHECKED: Final = frozenset(("DataAllValuesFrom", "DataMaxCardinality"))
"""The kinds of expression for which nothing is built: a model either keeps to them or does not."""


class _Model:
    """A structure that is being built: `turn` says which parts of unions are preferred."""

    def __init__(self, program: _Program, turn: int, deadline: float | None) -> None:
        self.structure = Interpretation()
        self.chose = False
        self._program = program
        self._turn = turn
        self._deadline = deadline
        self._levels: dict[int, int] = {}
        self._needed: dict[tuple[object, ...], int] = {}
        self._markers: dict[Tree, str] = {}
        self._replaced: dict[int, int] = {}
        self._rules = [*map(_Rule, program.rules)]
        for name in program.individuals:
            self.individual(name)

    def individual(self, name: str) -> int:
        """The thing that an individual's name stands for."""
        known = self.structure.individuals
        if name not in known:
            known[name] = self._thing(0)
        return known[name]

    def find(self, thing: int) -> int:
        """The thing that a thing was merged into, or itself."""
        while thing in self._replaced:
            thing = self._replaced[thing]
        return thing

    def _thing(self, level: int) -> int:
        thing = self.structure.add_thing()
        self._levels[thing] = level
        return thing

    def new(self, tree: Tree) -> int:
        """Create a thing and require that it is in a class expression; if the expression names an individual, take
        that one.
        """
        for name in sorted(signature_of([("SubClassOf", tree)]).individuals):
            self.individual(name)
        thing = self._called(tree, 0)
        self.require({thing}, tree)
        return thing

    def _called(self, tree: Tree, level: int) -> int:
        """The individual that an expression names, if it does, else a new thing of a level."""
        names = [str(part[1]) for part in _conjuncts(tree) if _names_one(part)]
        return self.individual(names[0]) if names else self._thing(level)

    def saturate(self) -> None:
        """Apply all rules until nothing changes. Raises _OutOfTimeError."""
        changed = True
        while changed:
            if self._deadline is not None and time.thread_time() > self._deadline:
                raise _OutOfTimeError
            changed = _some(self._apply(rule) for rule in self._rules)

    def _apply(self, rule: _Rule) -> bool:
        """Apply a rule to all things. Returns whether something changed."""
        structure, sub, sup = self.structure, rule.statement.sub, rule.statement.sup
        if not structure.has_changed(symbols_of(sub) | symbols_of(sup), rule.seen):
            return False
        rule.seen = structure.clock
        match rule.statement:
            case Subclass():
                missing = structure.members(sub, True) - structure.members(sup, True)
                return bool(missing) and self.require(missing, sup)
            case Subrole():
                above = structure.successors(sup)
                links = [(x, y) for x, targets in linked_by(structure, sub) for y in targets - above.get(x, set())]
                return _some(structure.link(sup, source, target) for source, target in links)
            case Subvalue():
                given = [(x, value) for x, own in structure.valued(sub).items() for value in own]
                return _some(structure.give(str(sup), thing, value) for thing, value in given)

    def require(self, things: Set[int], tree: Tree) -> bool:
        """Make things members of a class expression, if possible. Returns whether something changed."""
        if isinstance(tree, str):
            return tree not in (THING_IRI, NOTHING_IRI) and self.structure.put(tree, things)
        keyword, *parts = tree
        match keyword:
            case "ObjectIntersectionOf":
                return _some(self.require(things, part) for part in parts)
            case "ObjectHasValue":
                target = self.individual(str(parts[1]))
                return _some(self.structure.link(parts[0], thing, target) for thing in sorted(things))
            case "ObjectHasSelf":
                return _some(self.structure.link(parts[0], thing, thing) for thing in sorted(things))
            case "ObjectSomeValuesFrom":
                return _some(self._link(thing, parts[0], parts[1], 0) for thing in sorted(things))
            case "ObjectMinCardinality":
                filler = parts[2] if len(parts) > 2 else THING_IRI
                numbers = range(int(str(parts[0])))
                return _some(self._link(x, parts[1], filler, number) for x in sorted(things) for number in numbers)
            case "ObjectExactCardinality":
                least, most = ("ObjectMinCardinality", *parts), ("ObjectMaxCardinality", *parts)
                return _some((self.require(things, least), self._mark(things, most)))
            case "ObjectComplementOf":
                given = complement(parts[0])
                return given[0] != "ObjectComplementOf" and self.require(things, given)
            case "DataHasValue":
                return _some(self.structure.give(str(parts[0]), thing, parts[1]) for thing in things)
            case "DataSomeValuesFrom" if str(parts[1]).startswith(XSD) or parts[1] == LITERAL:
                return _some(self.structure.give(str(parts[0]), thing, ("value", parts[1])) for thing in things)
            case "DataExactCardinality" | "DataMinCardinality" if parts[0] == "1" and len(parts) == 3:
                return self.require(things, ("DataSomeValuesFrom", *parts[1:]))
        return self._require_by_rule(things, tree)

    def _require_by_rule(self, things: Set[int], tree: tuple[Tree, ...]) -> bool:
        missing = things - self.structure.members(tree, True)
        match tree[0]:
            case "ObjectUnionOf":
                return _some(self._choose(thing, tree[1:]) for thing in sorted(missing))
            case "ObjectOneOf":
                return _some(self._merge(self.individual(str(tree[1])), thing) for thing in sorted(missing))
            case "ObjectMaxCardinality":
                return _some(self._merge_targets(thing, tree) for thing in sorted(missing))
            case "ObjectAllValuesFrom":
                return self._mark(things, tree)
        return False

    def _mark(self, things: Set[int], tree: Tree) -> bool:
        """Postpone a requirement: things are put into a marker class, whose rule applies once more is known of them."""
        marker = self._markers.get(tree)
        if marker is None:
            marker = self._markers[tree] = f"\0marker {len(self._markers)}"
            if tree[0] == "ObjectAllValuesFrom":
                self._rules.append(_Rule(Subclass(("ObjectSomeValuesFrom", inverse(tree[1]), marker), tree[2])))
            else:
                self._rules.append(_Rule(Subclass(marker, tree)))
        return self.structure.put(marker, things)

    def _link(self, thing: int, role: Tree, filler: Tree, number: int) -> bool:
        return self.structure.link(role, thing, self._target(thing, role, filler, number))

    def _target(self, thing: int, role: Tree, filler: Tree, number: int) -> int:
        """The thing that a restriction links a thing to. Things of one level share it."""
        level = self._levels[thing] % LEVELS + 1
        key = (role, filler, number, level)
        known = self._needed.get(key)
        if known is None:
            known = self._needed[key] = self._called(filler, level)
            for part in _conjuncts(filler):
                if isinstance(part, str) or part[0] not in ("ObjectUnionOf", "ObjectOneOf", "ObjectMaxCardinality"):
                    self.require({known}, part)
                elif not _names_one(part):
                    self._mark({known}, part)
        return self.find(known)

    def _choose(self, thing: int, parts: tuple[Tree, ...]) -> bool:
        self.chose = True
        return self.require({thing}, parts[self._turn % len(parts)])

    def _merge_targets(self, thing: int, tree: tuple[Tree, ...]) -> bool:
        number, fillers = int(str(tree[1])), self.structure.members(tree[3], False) if len(tree) > 3 else None
        targets = self.structure.successors(tree[2]).get(thing, set())
        found = sorted(targets if fillers is None else targets & fillers)
        if not number or len(found) <= number:
            return False
        return _some(self._merge(found[number - 1], other) for other in found[number:])

    def _merge(self, kept: int, gone: int) -> bool:
        kept, gone = sorted((self.find(kept), self.find(gone)))
        if kept == gone:
            return False
        self.structure.merge(kept, gone)
        self._replaced[gone] = kept
        return True

    def prune(self) -> bool:
        """Remove things that break axioms until none does. Returns whether every individual still has its thing."""
        structure = self.structure
        named = {self.find(thing) for thing in structure.individuals.values()}
        broken = True
        while broken:
            broken = False
            for check in self._program.checks:
                found = structure.broken(check)
                if found:
                    structure.remove(set(found))
                    broken = True
                    if not named <= structure.things:
                        return False
        return True


@dataclass
class _Batch:
    """A model, and the things in it that have offered tags."""

    structure: Interpretation
    things: Mapping[Concept, int]
    rows: dict[Concept, frozenset[Concept]] = field(default_factory=dict)

    def refuted(self, demanded: Concept) -> frozenset[Concept]:
        """The offered concepts whose things are no members of the demanded concept: so they don't match it."""
        known = self.rows.get(demanded)
        if known is None:
            try:
                members = self.structure.members(tree_of(demanded), False)
                known = frozenset(concept for concept, thing in self.things.items() if thing not in members)
            except KeyError:  # an individual that the ontology doesn't know
                known = frozenset()
            self.rows[demanded] = known
        return known


class Countermodels:
    """Models of one ontology in which offered tags have members, and the matches that they refute.

    The models have a thing for each individual of the ontology and of `individuals`.
    """

    def __init__(self, ontology: Ontology, individuals: Set[str] = frozenset()) -> None:
        self._program = _Program(ontology.trees.values(), individuals)
        self._batches: list[_Batch] = []
        self._tried: set[Concept] = set()
        self._excluded: set[Concept] = set()
        self._none = False
        self._some = False
        self._builds_left = 0

    @cached_property
    def individuals(self) -> Set[str]:
        """The individuals that all models have."""
        return frozenset(self._program.individuals)

    @property
    def possible(self) -> Set[Concept]:
        """The offered concepts that have a member in some model."""
        return {concept for batch in self._batches for concept in batch.things}

    def refuted(self, demanded: Concept) -> frozenset[Concept]:
        """The offered concepts that, by some model of the axioms that reasoners get, are not below a demanded one."""
        return frozenset().union(*(batch.refuted(demanded) for batch in self._batches))

    def build(self, offered: Iterable[Concept], demanded: Collection[Concept], time_limit_s: float | None) -> None:
        """Search for models that have the new offered concepts, until they refute no further pairs or time is over.

        `time_limit_s` is CPU time of this thread, so that other load does not change the result.
        """
        offered = list(offered)
        new = [concept for concept in offered if concept not in self._tried]
        negative = sorted(filter(_says_not, demanded), key=in_functional_syntax)
        if self._none or not (new or self._excluded.issuperset(negative)):
            return
        self._tried.update(new)
        deadline = None if time_limit_s is None else time.thread_time() + time_limit_s
        self._builds_left = MOST_BUILDS
        plain = [concept for concept in new if not _says_more_of_individuals(concept)]
        special = [concept for concept in new if _says_more_of_individuals(concept)]
        try:
            for group in filter(None, (plain, special)):
                self._build_all(sorted(group, key=in_functional_syntax), demanded, deadline)
            self._exclude(new, [concept for concept in negative if concept in self._excluded], deadline)
            self._exclude(offered, [concept for concept in negative if concept not in self._excluded], deadline)
            self._excluded.update(negative)
        except _OutOfTimeError:
            return

    def _build_all(self, group: list[Concept], demanded: Collection[Concept], deadline: float | None) -> None:
        for turn in range(MOST_MODELS):
            before = sum(len(self.refuted(each)) for each in demanded)
            chose = self._build(group, turn, deadline)
            if not chose or (turn and sum(len(self.refuted(each)) for each in demanded) == before):
                return

    def _exclude(self, offered: Iterable[Concept], demanded: list[Concept], deadline: float | None) -> None:
        """Build models in which things have offered concepts and none of the demanded ones.

        If offered concepts remain that are not refuted for all demands, each half of the demands is tried.
        """
        waiting = [demanded] if demanded else []
        while waiting:
            some = waiting.pop(0)
            left = [concept for concept in offered if not all(concept in self.refuted(each) for each in some)]
            if not left:
                continue
            self._build(sorted(left, key=in_functional_syntax), 0, deadline, [complement(tree_of(c)) for c in some])
            if len(some) > 1:
                waiting += [some[: len(some) // 2], some[len(some) // 2 :]]

    def _build(self, group: list[Concept], turn: int, deadline: float | None, besides: Collection[Tree] = ()) -> bool:
        """Build a model with a thing for each concept of a group, or one for each half if there is none. Returns
        whether a union gave a choice.

        Each of these things is in all expressions of `besides`, too. For an empty group the model is one of the
        ontology alone. Raises _OutOfTimeError.
        """
        if not self._builds_left:
            raise _OutOfTimeError
        self._builds_left -= 1
        model = _Model(self._program, turn, deadline)
        things = {
            concept: model.new(("ObjectIntersectionOf", *_conjuncts(tree_of(concept)), *besides)) for concept in group
        }
        model.saturate()
        if model.prune():
            structure = model.structure
            found = {
                concept: model.find(thing)
                for concept, thing in things.items()
                if model.find(thing) in structure.members(tree_of(concept), True)
            }
            self._batches.append(_Batch(structure, found))
            self._some = True
        elif not group:
            self._none = True
        elif len(group) > 1:
            if not self._some:
                self._build([], turn, deadline)
            half = len(group) // 2
            if not self._none:
                return _some(self._build(part, turn, deadline, besides) for part in (group[:half], group[half:]))
        return model.chose


def tree_of(concept: Concept) -> Tree:
    """The class expression of a concept."""
    return parse(in_functional_syntax(concept))


def _conjuncts(tree: Tree) -> tuple[Tree, ...]:
    """Return the parts of a conjunction; any other expression is its only part."""
    return tree[1:] if isinstance(tree, tuple) and tree[0] == "ObjectIntersectionOf" else (tree,)


def _names_one(tree: Tree) -> bool:
    """Whether an expression is a single individual."""
    return isinstance(tree, tuple) and tree[0] == "ObjectOneOf" and len(tree) == 2


def _says_not(concept: Concept) -> bool:
    """Return whether a concept contains ¬, ∀ or ≤. A minimal model does not refute such a concept."""
    return any(isinstance(part, Complement | Only | AtMost) for part in walk(concept))


def _says_more_of_individuals(concept: Concept) -> bool:
    """Whether a concept joins an individual with something else."""
    joined = (part.parts for part in walk(concept) if isinstance(part, Intersection))
    return any(isinstance(part, Nominal) for parts in joined for part in parts)
