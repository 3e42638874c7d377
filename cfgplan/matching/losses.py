"""Pairs of tags that may depend on a loss: an axiom of the ontology's files that reasoners do not get.

A loss concerns a pair only if it is in the pair's module, and is joined to the pair there. An ontology is *open to
newcomers* if things without class and link break none of its axioms. Its models then have any size, and parts of it
without a common name are independent: a model of one can be laid over one of the other. A loss whose names are unknown
concerns all pairs. The ontology with all losses is assumed to be consistent.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import cached_property

from cfgplan.matching.concepts import NOTHING_IRI, THING_IRI, Concept, in_functional_syntax
from cfgplan.matching.expressions import BUILT_IN_ROLE
from cfgplan.matching.functional import Tree, leaves, parse
from cfgplan.matching.literals import LOST_LITERALS, XSD
from cfgplan.matching.modules import SWRL_BUILT_IN, Module, Modules, names_in
from cfgplan.matching.ontology import BRACKETED, Ontology
from cfgplan.matching.structures import Interpretation, checks_of


class Losses:
    """The losses of one ontology. `modules` is called once a module is needed."""

    def __init__(self, ontology: Ontology, modules: Callable[[], Modules]) -> None:
        self._ontology = ontology
        self._modules = modules
        self._concern: dict[tuple[Concept, Concept], bool] = {}

    def of(self, module: Module) -> Mapping[str, str]:
        """Return the losses that may affect the names of a module, with the reason of each."""
        dropped = self._ontology.dropped
        if not dropped:
            return {}
        rules = {text: dropped[text] for text, rule in self._ontology.lost_rules if rule in module.rules}
        return {**self._nameless, **rules, **module.ontology.dropped}

    def concerned(self, offered: frozenset[Concept], demanded: Concept) -> frozenset[Concept]:
        """Return the offered concepts that a loss may make fall below a demanded one."""
        if not self._ontology.dropped:
            return frozenset()
        new = [each for each in offered if (each, demanded) not in self._concern]
        self._look_at(sorted(new, key=in_functional_syntax), demanded)
        return frozenset(each for each in offered if self._concern[each, demanded])

    def _look_at(self, offered: list[Concept], demanded: Concept) -> None:
        """Find out which of some offers are concerned: none if the module of all of them is not, else half by half."""
        if not offered:
            return
        is_concerned = bool(self.about((*offered, demanded)))
        if len(offered) == 1 or not is_concerned:
            self._concern |= dict.fromkeys(((each, demanded) for each in offered), is_concerned)
        elif self.about((demanded,)):
            self._concern |= dict.fromkeys(((each, demanded) for each in offered), True)
        else:
            half = len(offered) // 2
            self._look_at(offered[:half], demanded)
            self._look_at(offered[half:], demanded)

    def about(self, concepts: Iterable[Concept]) -> Mapping[str, str]:
        """Return the losses that may affect some concepts together, with the reason of each."""
        concepts = [*concepts]
        if self._nameless:
            return self._nameless
        module = self._modules().of(names_in(concepts))
        lost = self.of(module)
        names = {name for concept in concepts for name in _names(parse(in_functional_syntax(concept)))}
        return lost if lost and self._is_joined(module, lost, names) else {}

    @cached_property
    def _nameless(self) -> Mapping[str, str]:
        """The losses that could be about any name."""
        ontology, rules = self._ontology, {text for text, _ in self._ontology.lost_rules}
        return {
            text: why
            for text, why in ontology.dropped.items()
            if text not in ontology.axioms and text not in rules and not text.startswith(LOST_LITERALS)
        }

    def _is_joined(self, module: Module, lost: Iterable[str], names: set[str]) -> bool:
        """Whether axioms with common names join some names to a loss in a module."""
        trees = [*module.ontology.trees.values(), *module.rules.values()]
        if not _is_open_to_newcomers(trees):
            return True
        reached = {name for text in lost for name in BRACKETED.findall(text)}
        reached.update(name for rule in module.rules.values() for name in _names(rule))
        groups = [frozenset(_names(tree)) for tree in trees]
        while True:
            more = set().union(*(group for group in groups if not group.isdisjoint(reached))) - reached
            if not more:
                return not names.isdisjoint(reached)
            reached |= more


def _is_open_to_newcomers(trees: Iterable[Tree]) -> bool:
    """Whether things without class and link break none of some axioms."""
    trees = [*trees]
    rules = [tree for tree in trees if tree[0] == "DLSafeRule"]
    others = [tree for tree in trees if tree[0] != "DLSafeRule"]
    structure = Interpretation()
    newcomer, everybody = structure.add_thing(), structure.add_thing()
    structure.individuals = {name: everybody for tree in others for name in _names(tree)}
    checks = (check for tree in others for check in checks_of(tree))
    return all(map(_binds, rules)) and not any(newcomer in structure.broken(check) for check in checks)


def _binds(rule: Tree) -> bool:
    """Whether each variable of a rule stands for something that has a class or a link."""
    body, head = rule[1][1:], rule[2][1:]
    bound: set[Tree] = set()
    for atom in body:
        if str(atom[0]) in ("ClassAtom", "ObjectPropertyAtom", "DataPropertyAtom") and _is_own_name(atom[1]):
            bound.update(atom[2:])
    return all(part in bound for atom in (*body, *head) for part in atom[1:] if part[0] == "Variable")


def _is_own_name(tree: Tree) -> bool:
    return isinstance(tree, str) and not tree.startswith((BUILT_IN_ROLE, SWRL_BUILT_IN))


def _names(tree: Tree) -> Iterator[str]:
    """The names in an axiom or expression, but those of OWL and XML Schema."""
    for name in leaves(tree):
        if not name.startswith(('"', XSD)) and not name.isdigit() and name not in (THING_IRI, NOTHING_IRI):
            yield name
