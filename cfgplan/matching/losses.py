"""Which pairs of tags may depend on what an ontology says and no reasoner is told.

An ontology is *open to newcomers* if things that have no class and no link break none of its axioms: then its models
have any size. Two parts of it without a common name do not bear on each other, as a model of one can be laid over a
model of the other. So what was dropped concerns only the names that axioms with common names join to it. It concerns
all names if its own are not known, or if the ontology is not open to newcomers. The ontology with all that was dropped
is taken to be free of contradictions.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property

from cfgplan.matching.concepts import NOTHING_IRI, THING_IRI, Concept, in_functional_syntax
from cfgplan.matching.functional import Tree, leaves, parse
from cfgplan.matching.literals import LOST_LITERALS, XSD
from cfgplan.matching.ontology import BRACKETED, Ontology
from cfgplan.matching.structures import Interpretation, checks_of


class Losses:
    """What was dropped from one ontology."""

    def __init__(self, ontology: Ontology) -> None:
        self._ontology = ontology

    def concern(self, offered: Concept, demanded: Concept) -> bool:
        """Whether what was dropped may make an offered concept fall below a demanded one."""
        if not self._ontology.dropped:
            return False
        concerned = self._names
        if concerned is None:
            return True
        return any(not concerned.isdisjoint(_names(parse(in_functional_syntax(each)))) for each in (offered, demanded))

    @cached_property
    def _names(self) -> set[str] | None:
        """The names that may be concerned; None for all."""
        axioms = self._ontology.axioms
        named = [
            set(BRACKETED.findall(text)) if text in axioms or text.startswith(LOST_LITERALS) else set()
            for text in self._ontology.dropped
        ]
        trees = [tree for tree in self._ontology.trees.values() if isinstance(tree, tuple) and tree[0] != "Declaration"]
        if not all(named) or not _is_open_to_newcomers(trees):
            return None
        reached: set[str] = set().union(*named)
        groups = [frozenset(_names(tree)) for tree in trees]
        while True:
            more = set().union(*(group for group in groups if not group.isdisjoint(reached))) - reached
            if not more:
                return reached
            reached |= more


def _is_open_to_newcomers(trees: list[tuple[Tree, ...]]) -> bool:
    structure = Interpretation()
    newcomer, everybody = structure.add_thing(), structure.add_thing()
    structure.individuals = {name: everybody for tree in trees for name in _names(tree)}
    return not any(newcomer in structure.broken(check) for tree in trees for check in checks_of(tree))


def _names(tree: Tree) -> Iterator[str]:
    """The names in an axiom or expression, but those of OWL and XML Schema."""
    for name in leaves(tree):
        if not name.startswith(('"', XSD)) and not name.isdigit() and name not in (THING_IRI, NOTHING_IRI):
            yield name
