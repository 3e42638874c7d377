"""Derivations: from which axioms it follows, step by step, that one tag is subsumed by another."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from cfgplan.matching.concepts import Concept, Named, Nominal
from cfgplan.matching.engine import FastEngine, disjuncts, roles_in
from cfgplan.matching.expressions import is_left_hand
from cfgplan.matching.functional import Tree, leaves
from cfgplan.matching.ontology import Ontology
from cfgplan.matching.rules import BOTTOM_ATOM, TOP_ATOM, Rules
from cfgplan.matching.saturation import DerivedFact, Reason, Saturation
from cfgplan.matching.translation import Inclusion, translate

_OFFERED: Final = Named("tag:offered")
_OFFER: Final = "the offer"


@dataclass(frozen=True, slots=True)
class Derivation:
    """The steps that show something, each with its axiom, and all axioms that they take."""

    steps: tuple[str, ...]
    axioms: tuple[str, ...]


def derivation(offered: Concept, demanded: Concept, ontology: Ontology) -> Derivation | None:
    """Return the derivation of offered ⊑ demanded; None if the fast engine doesn't find one.

    Its axioms are minimal: the engine does not find it without any one of them.
    """
    found = _derived(offered, demanded, ontology, ontology.trees)
    if found is None:
        return None

    def follows(some: Sequence[str]) -> bool:
        return _derived(offered, demanded, ontology, {axiom: ontology.trees[axiom] for axiom in some}) is not None

    def first(parts: Iterable[Sequence[str]]) -> int | None:
        return next((place for place, part in enumerate(parts) if follows(part)), None)

    axioms = [*found.axioms, *_beside(found.axioms, ontology)]
    axioms = fewest(axioms if follows(axioms) else [*ontology.trees], first)
    shown = _derived(offered, demanded, ontology, {axiom: ontology.trees[axiom] for axiom in sorted(axioms)})
    assert shown is not None
    unnamed = [axiom for axiom in sorted(axioms) if axiom not in shown.axioms]
    return Derivation((*map(ontology.shortened, unnamed), *shown.steps), tuple(sorted(axioms)))


def is_minimal(derived: Derivation, offered: Concept, demanded: Concept, ontology: Ontology) -> bool:
    """Whether the fast engine certifies that offered ⊑ demanded does not follow from fewer of the axioms."""
    for left_out in derived.axioms:
        trees = {axiom: ontology.trees[axiom] for axiom in derived.axioms if axiom != left_out}
        rows = FastEngine(trees, roles_in(offered) | roles_in(demanded)).rows([offered], [demanded])
        if rows.uncertified or rows.beyond_words:
            return False
    return True


def fewest(axioms: Sequence[str], first: Callable[[Iterable[Sequence[str]]], int | None]) -> list[str]:
    """Return a minimal subset of the axioms from which something follows. It must follow from all of them.

    `first` returns the index of the first of several subsets from which it follows; None if there is none.
    """
    left = [*axioms]
    start, size = 0, max(1, len(left) // 2)
    while True:
        cuts = [*_cuts(len(left), start, size)]
        place = first(left[:start] + left[start + size :] for start, size in cuts)
        if place is None:
            return left
        start, size = cuts[place]
        del left[start : start + size]


def _cuts(length: int, start: int, size: int) -> Iterator[tuple[int, int]]:
    """Yield start and size of the slices of a list: of this size from `start` on, then of half the size, down to 1."""
    while True:
        yield from ((at, size) for at in range(start, length, size))
        if size == 1:
            return
        start, size = 0, size // 2


_UNNAMED: Final = (
    *("SubObjectPropertyOf", "EquivalentObjectProperties", "InverseObjectProperties", "SymmetricObjectProperty"),
    *("SubDataPropertyOf", "EquivalentDataProperties"),
)
"""Axioms that the engine's rules hold without a step of their own."""


def _beside(axioms: Collection[str], ontology: Ontology) -> Iterator[str]:
    """Yield the axioms that may be needed beside those of the steps, about properties and the literals of
    individuals.
    """
    has_domain = any(axiom.startswith("DataPropertyDomain(") for axiom in axioms)
    named = {name for axiom in axioms for name in leaves(ontology.trees[axiom])} if has_domain else set()
    for axiom, tree in ontology.trees.items():
        is_value = tree[0] == "DataPropertyAssertion" and has_domain
        if axiom not in axioms and (tree[0] in _UNNAMED or (is_value and not named.isdisjoint(leaves(tree)))):
            yield axiom


def _derived(offered: Concept, demanded: Concept, ontology: Ontology, trees: Mapping[str, Tree]) -> Derivation | None:
    """The engine's first derivation of offered ⊑ demanded from some axioms of an ontology; None if it finds none."""
    if not is_left_hand(demanded):
        return None
    steps: dict[str, None] = {}
    axioms: dict[str, None] = {}
    for part in disjuncts(offered)[0]:
        translation = translate(trees)
        if not isinstance(part, Nominal):
            translation.inclusions.append(Inclusion(_OFFERED, part, ""))
        trace = _Trace(Rules(translation), ontology)
        shown = trace.steps(part if isinstance(part, Nominal) else _OFFERED, demanded)
        if shown is None:
            return None
        steps.update(dict.fromkeys(shown))
        axioms.update(trace.axioms)
    return Derivation(tuple(steps), tuple(axioms))


def contradiction(ontology: Ontology) -> tuple[str, ...]:
    """The steps that show that the ontology contradicts itself; none if the fast engine doesn't find any."""
    trace = _Trace(Rules(translate(ontology.trees)), ontology)
    return trace.clash()


class _Trace:
    def __init__(self, rules: Rules, ontology: Ontology) -> None:
        self._rules = rules
        self._ontology = ontology
        self._reasons: dict[DerivedFact, Reason] = {}
        self._saturation = Saturation(rules, reasons=self._reasons)
        self.axioms: dict[str, None] = {}
        """The axioms of the steps that were told."""

    def steps(self, start: Concept, goal: Concept) -> tuple[str, ...] | None:
        """The steps from a concept to one that subsumes it; None if none are found."""
        context = self._saturation.context((self._rules.atom(start),))
        wanted = self._rules.recognise(goal)
        self._saturation.learn()
        for atom in (wanted, BOTTOM_ATOM):
            if atom in context.atoms:
                return self._told((context, atom))
        return None

    def clash(self) -> tuple[str, ...]:
        """The steps to ⊥ in a context that every model has; () if there are none."""
        for fact in list(self._reasons):
            if fact[0].exists and fact[1:] == (BOTTOM_ATOM,):
                return self._told(fact)
        return ()

    def _told(self, goal: DerivedFact) -> tuple[str, ...]:
        steps: dict[str, None] = {}
        for fact in self._in_order(goal):
            rule, premises = self._reasons.get(fact, ((), ()))
            axiom = self._rules.origin.get(rule)
            told = self._said(fact)
            if axiom:
                self.axioms[axiom] = None
                steps[f"{told}, by {self._ontology.shortened(axiom)}"] = None
            elif any(len(premise) == 3 for premise in premises):
                because = [self._said(premise) for premise in premises if premise[1:] != (TOP_ATOM,)]
                if told not in because:
                    steps[f"{told}, as {' and '.join(because)}"] = None
        return tuple(steps)

    def _in_order(self, goal: DerivedFact) -> Iterator[DerivedFact]:
        """The facts from which a fact follows, itself included, each after its premises."""
        done: set[DerivedFact] = set()
        waiting: list[tuple[DerivedFact, bool]] = [(goal, False)]
        while waiting:
            fact, ready = waiting.pop()
            if ready:
                yield fact
            elif fact not in done:
                done.add(fact)
                waiting.append((fact, True))
                premises = self._reasons.get(fact, ((), ()))[1]
                waiting.extend((premise, False) for premise in reversed(premises))

    def _said(self, fact: DerivedFact) -> str:
        if len(fact) == 3:
            source, role, target = fact
            role_name = " ∘ ".join(map(self._ontology.written, self._rules.role_names[role].split(" ∘ ")))
            return f"{self._name(source.seeds)} ⊑ ∃{role_name}.{_bracketed(self._name(target.seeds))}"
        context, atom = fact
        return f"{self._name(context.seeds)} ⊑ {self._name((atom,))}"

    def _name(self, atoms: Iterable[int]) -> str:
        concepts = (self._rules.concepts[atom] for atom in atoms)
        return " ⊓ ".join(sorted(_OFFER if c == _OFFERED else self._ontology.render(c) for c in concepts))


def _bracketed(text: str) -> str:
    return f"({text})" if " " in text else text
