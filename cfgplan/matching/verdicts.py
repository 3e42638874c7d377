"""What a reference reasoner said about pairs of tags, so that it is asked about each pair once."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from typing import Final

from cfgplan.matching.concepts import Concept
from cfgplan.matching.faults import ReasonerTimeoutError
from cfgplan.matching.ontology import Ontology
from cfgplan.matching.reference import Classifier, classify

_TOGETHER: Final = 400
"""Up to so many tags there is one question for all of them: to start the reasoner costs more than the tags."""


@dataclass(frozen=True, slots=True)
class Question:
    """Which of the offered concepts are below which of the demanded ones?"""

    offered: frozenset[Concept]
    demanded: frozenset[Concept]


class Verdicts:
    """The answers to questions about one ontology."""

    def __init__(self, ontology: Ontology, classifier: Classifier | None) -> None:
        self._ontology = ontology
        self._classifier = classifier
        self._asked: defaultdict[Concept, tuple[frozenset[Concept], ...]] = defaultdict(tuple)
        self._told: defaultdict[Concept, set[Concept]] = defaultdict(set)
        self.unsatisfiable: set[Concept] = set()

    def open_questions(self, wanted: Mapping[Concept, frozenset[Concept]]) -> list[Question]:
        """What is not yet answered of the demanded concepts wanted for each offered one."""
        groups: defaultdict[tuple[frozenset[Concept], tuple[frozenset[Concept], ...]], set[Concept]] = defaultdict(set)
        for offered, demanded in wanted.items():
            groups[demanded, self._asked[offered]].add(offered)
        merged: defaultdict[frozenset[Concept], set[Concept]] = defaultdict(set)
        for (demanded, asked), group in groups.items():
            missing = demanded.difference(*asked)
            if missing:
                merged[missing] |= group
        return [Question(frozenset(group), demanded) for demanded, group in merged.items()]

    def ask(self, questions: Collection[Question], time_limit_s: float | None) -> None:
        """Have questions answered. Raises what the reasoner raises, ReasonerTimeoutError for all of them together."""
        if self._classifier is None:
            raise ReasonerTimeoutError("no reference reasoner was asked")
        deadline = None if time_limit_s is None else time.monotonic() + time_limit_s
        for question in _joined(questions):
            left_s = None if deadline is None else deadline - time.monotonic()
            if left_s is not None and left_s <= 0:
                raise ReasonerTimeoutError(f"the reasoner did not answer all questions in {time_limit_s:g} s")
            concepts = [*question.offered, *question.demanded]
            answer = classify(self._classifier, self._ontology, concepts, left_s)
            for offered in question.offered:
                if answer.is_unsatisfiable(offered):
                    self.unsatisfiable.add(offered)
                else:
                    self._told[offered] |= answer.below(offered, question.demanded)
                self._asked[offered] += (question.demanded,)

    def accepted(self, offered: Concept) -> Collection[Concept]:
        """The demanded concepts that were found to subsume an offered one."""
        return self._told.get(offered, ())

    @property
    def offers(self) -> Iterable[Concept]:
        """The offered concepts that some demanded one subsumes."""
        return self._told.keys()

    def forget(self, offered: Concept) -> None:
        """Drop the answers about a tag that is no longer offered."""
        self._asked.pop(offered, None)
        self._told.pop(offered, None)
        self.unsatisfiable.discard(offered)


def _joined(questions: Collection[Question]) -> Collection[Question]:
    offered = frozenset().union(*(question.offered for question in questions))
    demanded = frozenset().union(*(question.demanded for question in questions))
    if len(offered) + len(demanded) <= _TOGETHER:
        return [Question(offered, demanded)]
    return questions
