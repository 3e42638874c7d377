"""Several ontologies that HermiT reads in one start: each answer, or error, is about its own ontology."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import islice

import pytest

from cfgplan.matching import Ontology, hermit
from cfgplan.matching.concepts import TOP
from cfgplan.matching.derivations import fewest
from cfgplan.matching.faults import InconsistentOntologyError, ReasonerError
from cfgplan.matching.reference import FIRST_DOCUMENTS, first_answered

NAMES = "Ontology(<t:o> Declaration(Class(<t:0>)) Declaration(NamedIndividual(<t:i>)) "
POSSIBLE = f"{NAMES} ClassAssertion(<t:0> <t:i>))"
NEVER = "SubClassOf(<t:0> <http://www.w3.org/2002/07/owl#Nothing>)"
DENIED = f"{NAMES} {NEVER})"
CONTRADICTING = f"{NAMES} {NEVER} ClassAssertion(<t:0> <t:i>))"


def test_documents_are_answered_in_their_order_until_one_denies() -> None:
    answers, error = hermit.satisfiable_in_each([POSSIBLE, POSSIBLE, DENIED, POSSIBLE], "t:0")
    assert (answers[:3], error) == ([True, True, False], None)


def test_an_error_is_about_the_document_after_the_last_answer() -> None:
    answers, error = hermit.satisfiable_in_each([POSSIBLE, CONTRADICTING, POSSIBLE], "t:0")
    assert answers == [True]
    assert isinstance(error, InconsistentOntologyError)


def test_a_document_that_can_not_be_read_is_an_error_of_all() -> None:
    with pytest.raises(ReasonerError, match="refused"):
        hermit.satisfiable_in_each([POSSIBLE, "Ontology(<t:o> Nonsense)", DENIED], "t:0")


class Refusing:
    """A reasoner that denies documents with one axiom, refuses those with another, and notes the sizes of its calls."""

    def __init__(self) -> None:
        self.sizes: list[int] = []

    def satisfiable_in_each(
        self, documents: Sequence[str], _: str, **_limits: float | None
    ) -> tuple[list[bool], ReasonerError | None]:
        self.sizes.append(len(documents))
        answers: list[bool] = []
        for document in documents:
            if "<w#Refused>" in document:
                return answers, ReasonerError("refused")
            answers.append("<w#Denied>" not in document)
            if not answers[-1]:
                break
        return answers, None


def of(*names: str) -> list[Ontology]:
    return [Ontology([f"SubClassOf(<w#A> <w#{name}>)"]) for name in names]


@pytest.mark.parametrize("number", [0, 3, 7, 8, 30, 200])
def test_the_first_that_is_denied_is_found_behind_those_that_are_refused(number: int) -> None:
    before = ["Refused" if place % 3 == 1 else "Possible" for place in range(number)]
    reasoner = Refusing()
    found = first_answered(reasoner, of(*before, "Denied", "Denied"), TOP, lambda: None, lambda answer: answer is False)  # type: ignore[arg-type]
    assert found == number
    assert reasoner.sizes[0] == min(FIRST_DOCUMENTS, number + 2)


def test_nothing_is_found_once_time_is_over_and_no_more_ontologies_are_made_than_asked() -> None:
    left_s = iter([1.0, 0.0])
    ontologies = iter(of(*["Possible"] * 100))
    found = first_answered(Refusing(), ontologies, TOP, lambda: next(left_s), lambda answer: answer is False)  # type: ignore[arg-type]
    assert found is None
    assert len([*ontologies]) == 100 - FIRST_DOCUMENTS - 4 * FIRST_DOCUMENTS


def test_a_reasoner_that_answers_nothing_in_its_time_is_not_asked_again() -> None:
    class Silent(Refusing):
        def satisfiable_in_each(
            self, documents: Sequence[str], _: str, **_limits: float | None
        ) -> tuple[list[bool], ReasonerError | None]:
            self.sizes.append(len(documents))
            return [], None

    reasoner = Silent()
    assert first_answered(reasoner, of("Denied"), TOP, lambda: None, lambda answer: answer is False) is None  # type: ignore[arg-type]
    assert reasoner.sizes == [1]


@pytest.mark.parametrize("needed", [(), (0,), (4,), (2, 3), (0, 6, 11), tuple(range(12))])
def test_the_fewest_axioms_are_those_that_are_needed(needed: tuple[int, ...]) -> None:
    axioms = [f"axiom {number}" for number in range(12)]
    wanted = {axioms[number] for number in needed}
    asked = 0

    def first(parts: Sequence[Sequence[str]]) -> int | None:
        nonlocal asked
        asked += 1
        return next((place for place, part in enumerate(islice(parts, None)) if wanted <= {*part}), None)

    assert {*fewest(axioms, first)} == wanted  # type: ignore[arg-type]
    assert asked <= 12
