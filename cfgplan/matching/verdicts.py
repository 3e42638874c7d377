"""The reference reasoner's answers about pairs of tags. It is asked about each pair once."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from typing import Final

from cfgplan.matching.concepts import TOP, Concept, conjunction, in_functional_syntax, negation
from cfgplan.matching.faults import ReasonerTimeoutError
from cfgplan.matching.ontology import Ontology
from cfgplan.matching.reference import Reference, classify, satisfiable

AskedPair = tuple[Concept, Concept]
"""An offered concept and a demanded one."""
PAIRS_OF_A_TAG: Final = 4
"""With more open pairs per tag than this, classifying the tags is cheaper than asking pair by pair."""
CLASSIFYING: Final = 0.75
"""The share of a time limit that classifying may take before pairs are asked for one by one."""
PATIENCE: Final = 0.1
"""The share of a time limit that the answer for one pair may take before others are asked for."""
VERDICT_PATIENCE_S: Final = 30.0
"""The first time limit in seconds for one pair's answer, without a time limit of the caller."""
FIRST_PAIRS: Final = 64
"""The number of pairs asked for in the first call; each later call asks for four times as many as the last."""
MOST_PAIRS: Final = 8192
"""The most pairs asked for in one call: a command line has its limits."""


class Verdicts:
    """The answers for one ontology: by demanded concept, the offered ones asked about and those found to be below it.

    `part` returns the part of the ontology that is relevant to some concepts; the reference gets only that. Answers
    remain valid after their tags are removed.
    """

    def __init__(self, part: Callable[[Iterable[Concept]], Ontology], reference: Reference | None) -> None:
        self._part = part
        self._reference = reference
        self._answered: defaultdict[Concept, frozenset[Concept]] = defaultdict(frozenset)
        self._accepted: defaultdict[Concept, frozenset[Concept]] = defaultdict(frozenset)
        self.possible: set[Concept] = set()
        """Satisfiable concepts. If one is known, the ontology does not contradict itself."""
        self.unsatisfiable: set[Concept] = set()
        """Unsatisfiable offered concepts."""
        self._too_hard: list[tuple[int, float]] = []
        """Attempts to classify that ran out of time: number of tags, seconds."""

    def accepted(self, demanded: Concept) -> frozenset[Concept]:
        """The offered concepts that were found to be below a demanded one."""
        return self._accepted.get(demanded, frozenset())

    def denied(self, demanded: Concept) -> frozenset[Concept]:
        """The offered concepts that were found not to be below a demanded one, by the axioms that the reasoner got."""
        return self._answered.get(demanded, frozenset()) - self.accepted(demanded)

    def check(self, concepts: Collection[Concept], time_limit_s: float | None) -> None:
        """Ask which concepts are satisfiable; about ⊤ only while no satisfiable concept is known.

        Raises what the reasoner raises, such as InconsistentOntologyError.
        """
        questions = self._unknown(concepts)
        if self._reference is not None and questions and (time_limit_s is None or time_limit_s > 0):
            self._note(satisfiable(self._reference, self._part(questions), questions, time_limit_s), concepts)

    def _unknown(self, concepts: Collection[Concept]) -> list[Concept]:
        known = {*self.possible, *self.unsatisfiable, *([TOP] if self.possible else [])}
        return sorted({*concepts} - known, key=in_functional_syntax)

    def _note(self, told: Mapping[Concept, bool], concepts: Collection[Concept]) -> None:
        for concept in told.keys() & concepts:
            (self.possible if told[concept] else self.unsatisfiable).add(concept)

    def ask(
        self, pairs: Iterable[AskedPair], time_limit_s: float | None, doubtful: Collection[Concept] = frozenset()
    ) -> int:
        """Ask, in this order, for which pairs the offered concept is below the demanded one. Returns how many were
        asked.

        The call for the last pairs also asks which of the `doubtful` concepts are satisfiable. Many pairs are decided
        by classifying their tags, or one by one if that takes too long. Pairs not reached in time stay open. Raises
        what the reasoner raises, except ReasonerTimeoutError.
        """
        left_s = countdown(time_limit_s)
        missing = [] if self._reference is None else self._missing(pairs)
        offered, demanded = (dict.fromkeys(pair[place] for pair in missing) for place in (0, 1))
        asked = len(missing)
        if asked > PAIRS_OF_A_TAG * (len(offered) + len(demanded)):
            self._classify(offered, demanded, None if time_limit_s is None else CLASSIFYING * time_limit_s)
            missing = self._missing(missing)
        self._ask_one_by_one(missing, left_s, doubtful)
        return asked

    def _missing(self, pairs: Iterable[AskedPair]) -> list[AskedPair]:
        return [
            (offered, demanded)
            for offered, demanded in dict.fromkeys(pairs)
            if offered not in self.unsatisfiable and offered not in self._answered.get(demanded, ())
        ]

    def _classify(
        self, offered: Collection[Concept], demanded: Collection[Concept], time_limit_s: float | None
    ) -> None:
        """Classify all tags together, unless an earlier attempt with no more tags and no less time failed."""
        assert self._reference is not None
        tags = len(offered) + len(demanded)
        if time_limit_s is not None and any(tags >= n and time_limit_s <= s for n, s in self._too_hard):
            return
        try:
            part = self._part((*offered, *demanded))
            impossible, below = classify(self._reference, part, offered, demanded, time_limit_s)
        except ReasonerTimeoutError:
            self._too_hard.append((tags, time_limit_s or 0.0))
            return
        self._note({concept: concept not in impossible for concept in offered}, offered)
        for wanted, concepts in below.items():
            self._tell(wanted, offered, concepts)

    def _ask_one_by_one(
        self, pairs: Sequence[AskedPair], left_s: Callable[[], float | None], doubtful: Collection[Concept]
    ) -> None:
        """Ask pair by pair until time is over. A pair that gets no answer is tried again after the others."""
        limit_s = left_s()
        patience_s = VERDICT_PATIENCE_S if limit_s is None else PATIENCE * limit_s
        size = FIRST_PAIRS
        while pairs and (limit_s is None or limit_s > 0):
            told, stuck = self._ask_some(pairs[:size], limit_s, patience_s, doubtful if len(pairs) <= size else ())
            pairs = self._missing(pairs)
            if stuck is not None:
                pairs = sorted(pairs, key=lambda pair: stuck in _questions(pair))
                patience_s *= 1 if told else 2
            size = min(4 * size, MOST_PAIRS)
            limit_s = left_s()

    def _ask_some(
        self,
        pairs: Sequence[AskedPair],
        time_limit_s: float | None,
        patience_s: float,
        doubtful: Collection[Concept],
    ) -> tuple[int, Concept | None]:
        """Ask about some pairs, and then about doubtful concepts, in one call. Returns how many questions were
        answered, and the first that was not.
        """
        assert self._reference is not None
        questions = dict.fromkeys(
            question for pair in pairs for question in _questions(pair) if question not in self.possible
        )
        questions |= dict.fromkeys(self._unknown(doubtful))
        told = satisfiable(self._reference, self._part(questions), questions, time_limit_s, patience_s)
        self._note(told, {*(concept for concept, _ in pairs), *doubtful})
        rows: defaultdict[Concept, list[tuple[Concept, bool]]] = defaultdict(list)
        for pair in pairs:
            concept, both = _questions(pair)
            if concept in self.possible and (both in told or both in self.possible):
                rows[pair[1]].append((concept, both in told and not told[both]))
        for demanded, row in rows.items():
            self._tell(demanded, (concept for concept, _ in row), (concept for concept, holds in row if holds))
        return len(told), next((question for question in questions if question not in told), None)

    def _tell(self, demanded: Concept, answered: Iterable[Concept], accepted: Iterable[Concept]) -> None:
        """Note for a demanded concept which offered ones were asked about, and which of them are below it."""
        known = self._answered[demanded]
        self._answered[demanded] = known.union(answered) if known else frozenset(answered)
        self._accepted[demanded] |= frozenset(accepted)


def _questions(pair: AskedPair) -> tuple[Concept, Concept]:
    """The two questions for a pair: can something be offered; can something be offered and not demanded? Offered ⊑
    demanded if the answers are yes and no.
    """
    offered, demanded = pair
    return offered, conjunction((offered, negation(demanded)))


def countdown(time_limit_s: float | None) -> Callable[[], float | None]:
    """Return a function that gives the remaining seconds of a time limit starting now; None without a limit."""
    deadline = None if time_limit_s is None else time.monotonic() + time_limit_s
    return lambda: None if deadline is None else deadline - time.monotonic()
