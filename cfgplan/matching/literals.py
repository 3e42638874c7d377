"""What literals say about the individuals that have them."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping

from cfgplan.matching.concepts import Nominal
from cfgplan.matching.expressions import OutsideError, concept_of
from cfgplan.matching.functional import Tree
from cfgplan.matching.statements import Translation, include


def translate_data_properties(trees: Mapping[str, Tree], result: Translation) -> None:
    """What literals say about their individuals: the domains; what could contradict them is outside."""
    above: defaultdict[Tree, set[Tree]] = defaultdict(set)
    for tree in trees.values():
        if tree[0] == "SubDataPropertyOf":
            above[tree[1]].add(tree[2])
        elif tree[0] == "EquivalentDataProperties":
            for one in tree[1:]:
                above[one].update(tree[1:])
    individuals: defaultdict[Tree, set[str]] = defaultdict(set)
    for tree in trees.values():
        if tree[0] == "DataPropertyAssertion":
            reached, waiting = {tree[1]}, [tree[1]]
            while waiting:
                news = above[waiting.pop()] - reached
                reached |= news
                waiting += news
            for name in reached:
                individuals[name].add(str(tree[2]))
    for axiom, tree in trees.items():
        if tree[0] == "DataPropertyDomain":
            try:
                for individual in sorted(individuals[tree[1]]):
                    include(Nominal(individual), concept_of(tree[2]), axiom, result)
            except OutsideError as reason:
                result.outside[axiom] = str(reason)
        elif tree[0] in ("DataPropertyRange", "FunctionalDataProperty") and individuals[tree[1]]:
            result.outside[axiom] = "a restriction of literals that are in use is outside the fast fragment"
