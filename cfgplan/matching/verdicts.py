"""What a reference reasoner said about pairs of tags, so that it is asked about each pair once."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping
from typing import Final

from cfgplan.matching.concepts import TOP, Concept, conjunction, in_functional_syntax, negation
from cfgplan.matching.faults import ReasonerTimeoutError
from cfgplan.matching.ontology import Ontology
from cfgplan.matching.reference import Reference, classify, satisfiable

PAIRS_OF_A_TAG: Final = 4
"""With more open pairs than this for each of their tags, to classify the tags costs less than to ask for the pairs."""
CLASSIFYING: Final = 0.5
"""The share of a time limit that classifying may take before pairs are asked for one by one."""
CLASSIFYING_S: Final = 60.0
"""How long classifying may take where there is no time limit, seconds."""


class Verdicts:
    """The answers to questions about one ontology: for each demanded concept, about which offered ones.

    Answers stay right as long as the ontology does, whether the tags are still registered or not.
    """

    def __init__(self, ontology: Ontology, reference: Reference | None) -> None:
        self._ontology = ontology
        self._reference = reference
        self._answered: defaultdict[Concept, frozenset[Concept]] = defaultdict(frozenset)
        self._accepted: defaultdict[Concept, frozenset[Concept]] = defaultdict(frozenset)
        self.possible: set[Concept] = set()
        """Concepts that something can have; with any, the ontology does not contradict itself."""
        self.unsatisfiable: set[Concept] = set()
        """The offered concepts that nothing can have."""

    def accepted(self, demanded: Concept) -> frozenset[Concept]:
        """The offered concepts that were found to be below a demanded one."""
        return self._accepted.get(demanded, frozenset())

    def decided(self, demanded: Concept) -> frozenset[Concept]:
        """The offered concepts for which it is known whether they are below a demanded one, or that nothing can have.

        Where the reasoner was not told all that the ontology says, what it denied is not known.
        """
        known = self._accepted if self._ontology.dropped else self._answered
        return known.get(demanded, frozenset()).union(self.unsatisfiable)

    def check_consistency(self, time_limit_s: float | None) -> None:
        """Have the reasoner look for a contradiction in the ontology, unless it is known that there is none.

        Raises what the reasoner raises, such as InconsistentOntologyError.
        """
        if self._reference is not None and not self.possible:
            told = satisfiable(self._reference, self._ontology, [TOP], time_limit_s)
            self.possible |= told.keys()

    def ask(self, wanted: Mapping[Concept, Collection[Concept]], time_limit_s: float | None) -> int:
        """Ask which offered concepts are below the demanded ones that they are wanted for; how many pairs were asked.

        What time does not suffice for stays open. Raises what the reasoner raises, except ReasonerTimeoutError.
        """
        deadline = None if time_limit_s is None else time.monotonic() + time_limit_s
        missing = self._missing(wanted)
        asked = sum(map(len, missing.values()))
        if self._reference is None or not asked:
            return 0
        offered = frozenset().union(*missing.values())
        if asked > PAIRS_OF_A_TAG * (len(offered) + len(missing)):
            self._classify(offered, missing, CLASSIFYING_S if time_limit_s is None else CLASSIFYING * time_limit_s)
            missing = self._missing(missing)
        if missing:
            self._ask_one_by_one(missing, None if deadline is None else deadline - time.monotonic())
        return asked

    def _missing(self, wanted: Mapping[Concept, Collection[Concept]]) -> dict[Concept, frozenset[Concept]]:
        rows = {
            demanded: frozenset(offered) - self._answered[demanded] - self.unsatisfiable
            for demanded, offered in wanted.items()
        }
        return {demanded: offered for demanded, offered in rows.items() if offered}

    def _classify(self, offered: frozenset[Concept], demanded: Collection[Concept], time_limit_s: float) -> None:
        assert self._reference is not None
        try:
            answer = classify(self._reference, self._ontology, [*offered, *demanded], time_limit_s)
        except ReasonerTimeoutError:
            return
        impossible = {concept for concept in offered if answer.is_unsatisfiable(concept)}
        self.unsatisfiable |= impossible
        self.possible |= offered - impossible
        for wanted in demanded:
            told = {concept for concept in offered - impossible if answer.below(concept, (wanted,))}
            self._tell(wanted, offered, frozenset(told))

    def _ask_one_by_one(self, wanted: Mapping[Concept, frozenset[Concept]], time_limit_s: float | None) -> None:
        """Offered ⊑ demanded if nothing is offered and not demanded, but something is offered."""
        assert self._reference is not None
        pairs = {
            (concept, demanded): conjunction((concept, negation(demanded)))
            for demanded, offered in wanted.items()
            for concept in sorted(offered, key=in_functional_syntax)
        }
        questions: dict[Concept, None] = {}
        for (concept, _), both in pairs.items():
            if concept not in self.possible:
                questions[concept] = None
            questions[both] = None
        told = satisfiable(self._reference, self._ontology, questions, time_limit_s)
        for concept in {concept for concept, _ in pairs} & told.keys():
            (self.possible if told[concept] else self.unsatisfiable).add(concept)
        rows: defaultdict[Concept, list[tuple[Concept, bool]]] = defaultdict(list)
        for (concept, demanded), both in pairs.items():
            if both in told and concept in self.possible:
                rows[demanded].append((concept, not told[both]))
        for demanded, row in rows.items():
            self._tell(demanded, (concept for concept, _ in row), (concept for concept, holds in row if holds))

    def _tell(self, demanded: Concept, answered: Iterable[Concept], accepted: Iterable[Concept]) -> None:
        """Note for a demanded concept which offered ones were asked about, and which of them are below it."""
        known = self._answered[demanded]
        self._answered[demanded] = known.union(answered) if known else frozenset(answered)
        self._accepted[demanded] |= frozenset(accepted)
