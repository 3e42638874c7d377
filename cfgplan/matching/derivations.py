"""Derivations: from which axioms it follows, step by step, that one tag is subsumed by another."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Final

from cfgplan.matching.concepts import Concept, Named, Nominal
from cfgplan.matching.engine import disjuncts
from cfgplan.matching.expressions import is_left_hand
from cfgplan.matching.ontology import Ontology
from cfgplan.matching.rules import BOTTOM_ATOM, TOP_ATOM, Rules
from cfgplan.matching.saturation import DerivedFact, Reason, Saturation
from cfgplan.matching.translation import Inclusion, translate

_OFFERED: Final = Named("tag:offered")
_OFFER: Final = "the offer"


def derivation(offered: Concept, demanded: Concept, ontology: Ontology) -> tuple[str, ...] | None:
    """The steps that show offered ⊑ demanded, each with its axiom; None if the fast engine doesn't find any."""
    if not is_left_hand(demanded):
        return None
    steps: dict[str, None] = {}
    for part in disjuncts(offered)[0]:
        translation = translate(ontology.trees)
        if not isinstance(part, Nominal):
            translation.inclusions.append(Inclusion(_OFFERED, part, ""))
        trace = _Trace(Rules(translation), ontology)
        shown = trace.steps(part if isinstance(part, Nominal) else _OFFERED, demanded)
        if shown is None:
            return None
        steps.update(dict.fromkeys(shown))
    return tuple(steps)


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
