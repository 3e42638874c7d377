"""What is not decided stays open until it is asked about, and is asked about once."""

from __future__ import annotations

import time
from collections.abc import Sequence
from itertools import product
from pathlib import Path

import pytest

from cfgplan.errors import InputError
from cfgplan.matching import Matcher, Ontology, ReasonerTimeoutError, hermit
from cfgplan.matching.concepts import Concept, Named
from cfgplan.matching.verdicts import Verdicts

COVERED = Ontology(
    [
        "SubClassOf(<w#A> <w#W>)",
        "SubClassOf(<w#B> <w#W>)",
        "SubClassOf(<w#C> ObjectUnionOf(<w#A> <w#B>))",
        "SubClassOf(<w#D> ObjectUnionOf(<w#A> <w#E>))",
    ]
)


def matcher(reasoner: str = "auto", ontology: Ontology = COVERED) -> Matcher:
    result = Matcher(ontology, reasoner=reasoner)
    result.add(offered=["C", "D", "A"], demanded=["W"])
    return result


@pytest.mark.parametrize("reasoner", ["auto", "hermit"])
def test_pairs_are_open_until_they_are_asked_about_and_asked_about_once(reasoner: str) -> None:
    some = matcher(reasoner)
    before = some.matching(decide=False).similarity
    assert before.is_open("C", "W")
    assert some.decide([("C", "W")]) == 1
    assert some.decide([("C", "W")]) == 0
    after = some.matching(decide=False).similarity
    assert after.holds("C", "W")
    assert set(before.open_pairs()) - set(after.open_pairs()) == {("C", "W")}
    assert after.optimistic.offers["W"] == before.optimistic.offers["W"]
    everything = some.matching().similarity
    assert everything.offers == {"W": {"C", "A"}}
    assert not everything.open


@pytest.mark.parametrize("reasoner", ["auto", "hermit"])
def test_one_start_of_hermit_decides_pairs_and_whether_offers_are_satisfiable(
    reasoner: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Only HermiT finds that C matches and that Q is unsatisfiable; the fast engine finds that A and Q match."""
    starts, ask = list[Sequence[str]](), hermit.satisfiable

    def satisfiable(document: str, classes: Sequence[str], **limits: float | None) -> dict[str, bool]:
        starts.append(classes)
        return ask(document, classes, **limits)

    monkeypatch.setattr(hermit, "satisfiable", satisfiable)
    never = ("SubClassOf(<w#Q> <w#W>)", "SubClassOf(<w#Q> ObjectUnionOf(<w#R> <w#S>))")
    empty = ("DisjointClasses(<w#Q> <w#R>)", "DisjointClasses(<w#Q> <w#S>)")
    ontology = Ontology([*COVERED.axioms, *never, *empty])
    some = matcher(reasoner, ontology)
    some.add(offered=["Q"])
    found = some.matching()
    assert found.similarity.offers == {"W": {"C", "A"}}
    assert (len(starts), found.impossible) == (1, {"Q"})


def test_the_fast_engine_alone_asks_nothing() -> None:
    some = matcher("el")
    assert some.decide([("C", "W")]) == 0
    assert some.matching().similarity.is_open("C", "W")
    assert some.matching().similarity.holds("A", "W")


def test_what_was_asked_is_known_after_tags_come_and_go(monkeypatch: pytest.MonkeyPatch) -> None:
    some = matcher()
    some.decide([("C", "W")])
    some.remove(offered=["C", "D"])
    some.add(offered=["(C)"])
    for question in ("classify", "satisfiable"):
        monkeypatch.setattr(hermit, question, None)
    assert some.matching(decide=False).similarity.offers == {"W": {"(C)", "A"}}


def test_another_ontology_is_asked_anew() -> None:
    some = matcher()
    some.decide([("C", "W")])
    some.change_ontology(Ontology([*(COVERED.axioms - {"SubClassOf(<w#B> <w#W>)"}), "Declaration(Class(<w#F>))"]))
    changed = some.matching(decide=False).similarity
    assert not changed.holds("C", "W")
    assert not changed.is_open("C", "W")
    some.change_ontology(COVERED)
    assert some.matching(decide=False).similarity.is_open("C", "W")
    assert some.decide([("C", "W")]) == 1


def test_only_what_is_registered_can_be_asked_about() -> None:
    with pytest.raises(KeyError):
        matcher().decide([("W", "W")])


def test_without_time_a_pair_stays_open() -> None:
    some = matcher()
    assert some.decide([("C", "W")], time_limit_s=0.0) == 1
    assert some.matching(decide=False).similarity.is_open("C", "W")


@pytest.mark.parametrize("pairs", [[("C", "W"), ("F", "V")], [("F", "V"), ("C", "W")]])
def test_what_is_wanted_most_is_asked_first(monkeypatch: pytest.MonkeyPatch, pairs: list[tuple[str, str]]) -> None:
    axioms = ["SubClassOf(<w#W> <w#V>)", "SubClassOf(<w#F> ObjectUnionOf(<w#A> <w#B>))"]
    some = Matcher(Ontology([*COVERED.axioms, *axioms]))
    some.add(offered=["C", "F"], demanded=["V", "W"])

    told: list[str] = []

    def satisfiable(document: str, classes: Sequence[str], **_limits: float | None) -> dict[str, bool]:
        told.extend(line for line in document.splitlines() if line.startswith("SubClassOf(<t:"))
        return dict.fromkeys(classes, False)

    monkeypatch.setattr(hermit, "satisfiable", satisfiable)
    assert some.decide(pairs) == 2
    assert [f"<w#{offered}>" in line for (offered, _), line in zip(pairs, told, strict=True)] == [True, True]


def test_a_contradiction_is_told_whatever_is_asked() -> None:
    contradicting = Ontology(
        [
            *COVERED.axioms,
            "ClassAssertion(<w#C> <w#i>)",
            "ClassAssertion(ObjectComplementOf(<w#W>) <w#i>)",
        ]
    )
    with pytest.raises(InputError, match="contradicts"):
        matcher(ontology=contradicting).decide([("C", "W")])
    with pytest.raises(InputError, match="contradicts"):
        matcher(ontology=contradicting).matching()


@pytest.mark.parametrize("reasoner", ["auto", "hermit"])
def test_an_offer_that_nothing_can_have_is_found_where_it_is_asked_about(reasoner: str) -> None:
    excluded = Ontology([*COVERED.axioms, "SubClassOf(<w#C> ObjectComplementOf(<w#W>))"])
    some = matcher(reasoner, excluded)
    assert some.decide([("C", "W"), ("D", "W")]) == (1 if reasoner == "auto" else 2)
    found = some.matching(decide=False)
    assert found.similarity.offers == {"W": {"A"} if reasoner == "auto" else frozenset()}
    assert not found.similarity.is_open("C", "W")
    assert any("'C'" in warning and "never matches" in warning for warning in found.warnings)


def test_what_was_dropped_leaves_open_what_does_not_match() -> None:
    dropped = Ontology(COVERED.axioms, dropped={"DLSafeRule(...)": "rules are not read"})
    some = matcher(ontology=dropped)
    assert some.decide([("C", "W"), ("D", "W")]) == 1  # a model shows that D need not be W by all that is told
    assert some.decide([("C", "W"), ("D", "W")]) == 0
    found = some.matching().similarity
    assert found.offers == {"W": {"C", "A"}}
    assert list(found.open_pairs()) == [("D", "W")]
    inside = Matcher(Ontology(["SubClassOf(<w#A> <w#W>)"], dropped=dropped.dropped), reasoner="el")
    inside.add(offered=["A"], demanded=["W"])
    assert not inside.matching().similarity.open


class Slow:
    """A reasoner by which everything is below everything; it takes long about what `hard` is in, and to classify."""

    def __init__(self, hard: str) -> None:
        self._hard = hard
        self._calls = 0
        self.classified_s: list[float | None] = []
        self.answered: list[str] = []

    def classify(self, _: str, *, time_limit_s: float | None = None) -> list[tuple[str, str]]:
        self.classified_s.append(time_limit_s)
        raise ReasonerTimeoutError("too hard", "")

    def satisfiable(
        self,
        document: str,
        classes: Sequence[str],
        *,
        time_limit_s: float | None = None,
        patience_s: float | None = None,
    ) -> dict[str, bool]:
        assert patience_s is not None
        self._calls += 1
        meanings = {line.split()[0][12:-1]: line for line in document.splitlines() if line.startswith("SubClassOf(<t:")}
        answers: dict[str, bool] = {}
        for name in classes:
            if self._hard in meanings[name] and patience_s < (time_limit_s or 600.0) / 2:
                break
            answers[name] = "ObjectComplementOf" not in meanings[name]
            self.answered.append(meanings[name])
        return answers


def concepts(stem: str, count: int) -> list[Concept]:
    return [Named(f"w#{stem}{number}") for number in range(count)]


@pytest.mark.parametrize("time_limit_s", [None, 600.0])
def test_a_question_that_takes_long_is_asked_after_all_others(time_limit_s: float | None) -> None:
    reasoner = Slow("<w#A1>")
    verdicts = Verdicts(lambda _: Ontology(), reasoner)
    offered, demanded = concepts("A", 3), concepts("B", 2)
    assert verdicts.ask(product(offered, demanded), time_limit_s) == 6
    assert all(verdicts.accepted(demand) == {*offered} for demand in demanded)
    assert ["<w#A1>" in meaning for meaning in reasoner.answered] == [False] * 6 + [True] * 3


def test_what_could_not_be_classified_is_asked_pair_by_pair_and_not_classified_again_in_as_little_time() -> None:
    reasoner = Slow("<w#A1>")
    verdicts = Verdicts(lambda _: Ontology(), reasoner)
    demanded = concepts("B", 12)
    for stem, number, time_limit_s in (("A", 12, 600.0), ("C", 14, 400.0), ("D", 11, 400.0), ("E", 14, 800.0)):
        assert verdicts.ask(product(concepts(stem, number), demanded), time_limit_s) == 12 * number
    assert reasoner.classified_s == [450.0, 300.0, 600.0]
    assert all(len(verdicts.accepted(demand)) == 12 + 14 + 11 + 14 for demand in demanded)


def test_hermit_is_not_waited_for_when_no_answer_comes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    java = tmp_path / "java"
    java.write_text("#!/bin/sh\necho 't:0 is satisfiable.'\nexec sleep 600\n")
    java.chmod(0o755)
    monkeypatch.setattr(hermit, "_java_command", lambda: str(java))
    start = time.monotonic()
    assert hermit.satisfiable("", ["t:0", "t:1"], patience_s=1.0) == {"t:0": True}
    assert time.monotonic() - start < 60


NEVER_B = [
    "SubClassOf(<w#B> ObjectUnionOf(<w#A> <w#E>))",
    "DisjointClasses(<w#B> <w#A>)",
    "DisjointClasses(<w#B> <w#E>)",
]


@pytest.mark.parametrize("demanded", [["W"], ["W", "A"], ["W", "E"]])
@pytest.mark.parametrize("reasoner", ["auto", "hermit"])
def test_an_offer_that_nothing_can_have_matches_nothing_whoever_finds_its_matches(
    reasoner: str, demanded: list[str]
) -> None:
    some = Matcher(Ontology([*COVERED.axioms, "SubClassOf(<w#E> <w#W>)", *NEVER_B]), reasoner=reasoner)
    some.add(offered=["B", "D"], demanded=demanded)
    found = some.matching()
    assert not any("B" in offers for offers in found.similarity.offers.values())
    assert found.warnings == (
        "the offered tag 'B' contradicts the ontology: nothing can have it, and it never matches",
    )


LOST = [
    'DataPropertyAssertion(<w#since> <w#machine> "2020"^^<http://www.w3.org/2001/XMLSchema#gYear>)',
    "DataPropertyRange(<w#since> <http://www.w3.org/2001/XMLSchema#string>)",
    "ClassAssertion(<w#Machine> <w#machine>)",
    "SubClassOf(<w#Pump> <w#Machine>)",
]


GYEAR = "<http://www.w3.org/2001/XMLSchema#gYear>"
SINCE_1999 = [f'SubClassOf(ObjectIntersectionOf(<w#Machine> DataHasValue(<w#since> "1999"^^{GYEAR})) <w#W>)']


@pytest.mark.parametrize(
    ("axioms", "still_open"),
    [
        ([], [("{machine}", "W")]),
        (["SubClassOf(<w#E> ObjectSomeValuesFrom(<w#r> <w#A>))"], [("{machine}", "W")]),
        (["SubClassOf(<w#E> <w#Machine>)"], [("{machine}", "W")]),
        (["SubClassOf(<http://www.w3.org/2002/07/owl#Thing> <w#F>)"], [("{machine}", "W")]),
        (SINCE_1999, [("D", "W"), ("Pump", "W"), ("{machine}", "W")]),  # nothing is known of the W that it makes
    ],
)
def test_what_was_dropped_concerns_the_pairs_on_which_it_may_bear(
    axioms: list[str], still_open: list[tuple[str, str]]
) -> None:
    some = Matcher(Ontology([*COVERED.axioms, *LOST, *axioms]))
    some.add(offered=["C", "D", "A", "Pump", "{machine}"], demanded=["W"])
    found = some.matching().similarity
    assert some.ontology.dropped
    assert found.offers == {"W": {"C", "A"}}
    assert sorted(found.open_pairs()) == still_open


@pytest.mark.parametrize("reasoner", ["el", "auto", "hermit"])
def test_what_is_repeated_among_the_disjoint_counts_once_for_every_reasoner(reasoner: str) -> None:
    axioms = ["DisjointUnion(<w#U> <w#A> <w#A>)", "DisjointClasses(<w#B> <w#B> <w#C>)", "SubClassOf(<w#B> <w#V>)"]
    some = Matcher(Ontology(axioms), reasoner=reasoner)
    some.add(offered=["A", "B", "U"], demanded=["A", "C", "U", "V"])
    similarity = some.matching().similarity
    assert similarity.offers == {"A": {"A", "U"}, "C": set(), "U": {"A", "U"}, "V": {"B"}}
    assert not similarity.open
    assert some.matching().warnings == ()
