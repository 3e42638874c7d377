"""Modules: axioms of an ontology that entail all its consequences about some names.

Classes and properties beside these names may be read as empty, or as full. An axiom that then holds in every model is
*local* and can be left out: each model of the other axioms becomes one of all of them, without a change of the names.
Both readings are tried in turns until no axiom can be left out.

Individuals count as known: every model of a module has a thing for each of them.

References: B. Cuenca Grau, I. Horrocks, Y. Kazakov, U. Sattler, "Modular Reuse of Ontologies: Theory and Practice",
J. Artificial Intelligence Research 31 (2008), section 5.2 (syntactic locality); U. Sattler, T. Schneider,
M. Zakharyaschev, "Which Kind of Module Should I Extract?", Description Logics 2009 (both readings in turns: ⊤⊥*). By
the same argument a rule is local if an atom of its body is empty, or if all atoms of its head are full.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping, Set
from dataclasses import dataclass, field
from functools import cached_property
from typing import Final

from cfgplan.matching import axioms
from cfgplan.matching.concepts import (
    NOTHING_IRI,
    THING_IRI,
    AtLeast,
    AtMost,
    Concept,
    Named,
    Nominal,
    Only,
    Some,
    walk,
)
from cfgplan.matching.expressions import BUILT_IN_ROLE
from cfgplan.matching.functional import Tree, parse, symbols
from cfgplan.matching.ontology import Ontology

_EMPTY: Final = False
_FULL: Final = True
_FIXED_VALUES: Final = {
    THING_IRI: _FULL,
    NOTHING_IRI: _EMPTY,
    **{f"{BUILT_IN_ROLE}top{kind}Property": _FULL for kind in ("Object", "Data")},
    **{f"{BUILT_IN_ROLE}bottom{kind}Property": _EMPTY for kind in ("Object", "Data")},
}
_RULE_KEYWORD: Final = "DLSafeRule"
_ATOMS: Final = ("ClassAtom", "ObjectPropertyAtom", "DataPropertyAtom")
SWRL_BUILT_IN: Final = "http://www.w3.org/2003/11/swrlb#"
_ALWAYS: Final = ("HasKey", "DatatypeDefinition")
"""The axioms that are never left out: keys are rare, and what uses a datatype needs its definition."""


def names_in(concepts: Iterable[Concept]) -> set[str]:
    """The classes and properties in concepts."""
    names: set[str] = set()
    for part in (part for concept in concepts for part in walk(concept)):
        if isinstance(part, Named):
            names.add(part.iri)
        elif isinstance(part, Some | Only | AtLeast | AtMost):
            names.add(part.role)
    return names


def individuals_in(concepts: Iterable[Concept]) -> set[str]:
    """The individuals in concepts."""
    return {part.iri for concept in concepts for part in walk(concept) if isinstance(part, Nominal)}


@dataclass(frozen=True)
class Module:
    """A module. `names` are the classes and properties that it was made for, and those in it.

    `ontology` has the axioms that reasoners are told. `rules` are the dropped rules that are in the module.
    """

    names: Set[str]
    ontology: Ontology
    rules: Mapping[str, Tree] = field(default_factory=dict)

    def after(self, added: Collection[str], removed: Collection[str], whole: Ontology) -> Module | None:
        """The module after a change of the whole ontology, for the same names; None if it has to be made again."""
        if self.rules or whole.dropped:
            return None
        parsed = {axiom: parse(axiom) for axiom in added}
        if not all(self.names >= symbols(tree) for tree in parsed.values()):
            return None
        kept = {axiom: tree for axiom, tree in self.ontology.trees.items() if axiom not in removed}
        return Module(self.names, Ontology(kept | parsed, trees=kept | parsed))


class Modules:
    """The modules of one ontology."""

    def __init__(self, ontology: Ontology) -> None:
        self._rules = {rule: parse(rule) for _, rule in ontology.lost_rules}
        trees = {**ontology.trees, **self._rules}
        self._axioms = _Axioms({axiom: tree for axiom, tree in trees.items() if tree[0] != "Declaration"})
        self._told = ontology.axioms

    def of(self, names: Iterable[str]) -> Module:
        """Return the module of some classes and properties."""
        wanted = frozenset(names)
        part, size = self._axioms, -1
        while len(part) != size:
            size = len(part)
            for outside in (_FULL, _EMPTY):
                part = part.not_local(wanted, outside)
        trees = {axiom: tree for axiom, tree in part.trees.items() if axiom in self._told}
        rules = {rule: tree for rule, tree in self._rules.items() if rule in part.trees}
        return Module(wanted | part.symbols.keys(), Ontology(trees, trees=trees), rules)


class _Axioms:
    """Axioms, with an index of their names, and those that are never local."""

    def __init__(self, trees: Mapping[str, Tree], symbols_of: Mapping[str, frozenset[str]] | None = None) -> None:
        self.trees = trees
        self.symbols_of = {axiom: symbols(tree) for axiom, tree in trees.items()} if symbols_of is None else symbols_of

    def __len__(self) -> int:
        return len(self.trees)

    @cached_property
    def symbols(self) -> Mapping[str, Collection[str]]:
        """The axioms in which each class or property occurs."""
        found: defaultdict[str, list[str]] = defaultdict(list)
        for axiom in self.trees:
            for name in self.symbols_of[axiom]:
                found[name].append(axiom)
        return found

    @cached_property
    def _never_local(self) -> Mapping[bool, Collection[str]]:
        """The axioms that are not local whatever is asked about, by the reading of other names."""
        return {
            outside: [axiom for axiom, tree in self.trees.items() if not _Reading(frozenset(), outside).is_local(tree)]
            for outside in (_EMPTY, _FULL)
        }

    def not_local(self, names: Set[str], outside: bool) -> _Axioms:
        """The axioms that are not local for some names and for the names in such axioms, in their order."""
        known: set[str] = set()
        reading = _Reading(known, outside)
        found: set[str] = set()
        waiting = [*self._never_local[outside]]
        news = set(names)
        while waiting or news:
            for name in news:
                waiting += self.symbols.get(name, ())
            known |= news
            news = set()
            while waiting:
                axiom = waiting.pop()
                if axiom not in found and not reading.is_local(self.trees[axiom]):
                    found.add(axiom)
                    news |= self.symbols_of[axiom] - known
        return _Axioms({axiom: tree for axiom, tree in self.trees.items() if axiom in found}, self.symbols_of)


class _Reading:
    """A reading of axioms: names that are not `known` are empty, or full.

    The value of a class or property is _EMPTY, _FULL, or None where it hangs on known names.
    """

    def __init__(self, known: Set[str], outside: bool) -> None:
        self._known = known
        self._outside = outside

    def is_local(self, tree: Tree) -> bool:
        """Whether an axiom is true whatever the known names mean."""
        keyword = tree[0]
        if keyword == _RULE_KEYWORD:
            body, head = ([*map(self._atom, part[1:])] for part in tree[1:])
            return _EMPTY in body or (bool(head) and all(value is _FULL for value in head))
        statements = axioms.statements_of(tree)
        return statements is not None and keyword not in _ALWAYS and all(map(self._holds, statements))

    def _atom(self, atom: Tree) -> bool | None:
        """The value of an atom of a rule."""
        is_known = atom[0] not in _ATOMS or str(atom[1]).startswith(SWRL_BUILT_IN)
        return None if is_known else self._value(atom[1])

    def _holds(self, statement: axioms.Statement) -> bool:
        match statement:
            case axioms.Subclass(sub, sup) | axioms.Subrole(sub, sup) | axioms.Subvalue(sub, sup):
                return self._value(sup) is _FULL or self._value(sub) is _EMPTY
            case axioms.DisjointExpressions(parts) | axioms.DisjointRoles(parts):
                return sum(self._value(part) is not _EMPTY for part in parts) < 2

    def _value(self, tree: Tree) -> bool | None:
        """The value of a class, a property or a chain of properties."""
        if isinstance(tree, str):
            built_in = _FIXED_VALUES.get(tree)
            return built_in if built_in is not None or tree in self._known else self._outside
        keyword, *parts = tree
        match keyword:
            case "ObjectInverseOf":
                return self._value(parts[0])
            case "ObjectIntersectionOf" | "ObjectPropertyChain":
                return _all(map(self._value, parts))
            case "ObjectUnionOf":
                return _not(_all(_not(self._value(part)) for part in parts))
            case "ObjectComplementOf":
                return _not(self._value(parts[0]))
            case "ObjectHasSelf" | "ObjectHasValue" | "DataHasValue":
                return self._value(parts[0])
            case "ObjectSomeValuesFrom":
                return _all(map(self._value, parts))
            case "ObjectAllValuesFrom":
                return _not(_all((self._value(parts[0]), _not(self._value(parts[1])))))
            case "ObjectMinCardinality" | "ObjectMaxCardinality" | "ObjectExactCardinality":
                counted = _all(map(self._value, parts[1:]))
                return _number_of(keyword[6:9], int(str(parts[0])), counted)
            case "DataMinCardinality" | "DataMaxCardinality" | "DataExactCardinality":
                return _number_of(keyword[4:7], int(str(parts[0])), self._with_literals(parts[1:]))
            case "DataSomeValuesFrom":
                return self._with_literals(parts)
            case "DataAllValuesFrom":
                is_idle = _EMPTY in map(self._value, parts[:-1]) or parts[-1] == axioms.LITERAL
                return _FULL if is_idle else None
        return None

    def _with_literals(self, parts: Iterable[Tree]) -> bool | None:
        """The value of having some literal for a property, and of a data range if one is given."""
        name, *ranges = parts
        value = self._value(name)
        return value if value is _EMPTY or ranges in ([], [axioms.LITERAL]) else None


def _not(value: bool | None) -> bool | None:
    return None if value is None else not value


def _all(values: Iterable[bool | None]) -> bool | None:
    """Empty if one of the values is, full if all are."""
    found = {*values}
    return _EMPTY if _EMPTY in found else (_FULL if found <= {_FULL} else None)


def _number_of(kind: str, number: int, counted: bool | None) -> bool | None:
    """The value of a number restriction ("Min", "Max" or "Exa"), given the value of having one such successor."""
    if number == 0 and kind == "Min":
        return _FULL
    if number == 0:
        return _not(counted)
    if counted is _EMPTY:
        return _FULL if kind == "Max" else _EMPTY
    return counted if kind == "Min" and number == 1 else None
