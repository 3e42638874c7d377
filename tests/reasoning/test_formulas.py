"""The formula language: what is read, and what is refused with column and hint."""

from __future__ import annotations

import pytest
from cfgplan_runtime.reasoning.conditions import Comparison, Field, Flag, Literal, Membership, RegionName
from cfgplan_runtime.reasoning.parser import parse
from cfgplan_runtime.reasoning.reader import Vocabulary
from cfgplan_runtime.reasoning.regions import region_from
from cfgplan_runtime.reasoning.syntax import (
    Always,
    And,
    Atom,
    Eventually,
    Formula,
    Implies,
    Interval,
    Not,
    Or,
    Until,
)
from hypothesis import given
from hypothesis import strategies as st
from random_formulas import ATOMS, formulas_over

from cfgplan.errors import InputError

SECOND = 1_000_000_000
REGIONS = {"goal": region_from({"circle": [0, 0], "radius": 1}), "opponent_half": region_from({"box": [0, -3, 4, 3]})}
KNOWN = Vocabulary({"ball", "hull", "robot", *ATOMS}, REGIONS)
P, Q, R = (Atom(Flag(Field(name))) for name in ATOMS)


def test_the_papers_rule_is_read_in_words_and_in_signs() -> None:
    inside = Atom(Membership(Field("ball"), RegionName("opponent_half")))
    rule = Always(Implies(Not(inside), Eventually(inside, Interval(0, 10 * SECOND))))
    assert parse("always (not in(ball, opponent_half) -> eventually[0,10s] in(ball, opponent_half))", KNOWN) == rule
    assert parse("□ (¬in(ball, opponent_half) → ◇[0,10s] in(ball, opponent_half))", KNOWN) == rule


@pytest.mark.parametrize(
    ("text", "meant"),
    [
        ("not p and q or r -> p", Implies(Or(And(Not(P), Q), R), P)),
        ("p -> q -> r", Implies(P, Implies(Q, R))),
        ("p => q", Implies(P, Q)),
        ("always p until q and r", And(Until(Always(P), Q), R)),
        ("p until q until r", Until(P, Until(Q, R))),
        ("eventually always p", Eventually(Always(P))),
        ("p 𝒰[1ms, 2min] q", Until(P, Q, Interval(1_000_000, 120 * SECOND))),
        ("always[1,10ms] p", Always(P, Interval(1_000_000, 10_000_000))),
        ("always[1.5, 2] p", Always(P, Interval(1_500_000_000, 2 * SECOND))),
        ("always[1,2) p", Always(P, Interval(SECOND, 2 * SECOND - 1))),
        ("always[1s,inf) p", Always(P, Interval(SECOND))),
        (
            "0 < ball.x < 3",
            And(
                Atom(Comparison("<", Literal(0.0), Field("ball", ("x",)))),
                Atom(Comparison("<", Field("ball", ("x",)), Literal(3.0))),
            ),
        ),
        ("ball.x ≥ -3", Atom(Comparison(">=", Field("ball", ("x",)), Literal(-3.0)))),
        ("robot.state == 'play'", Atom(Comparison("==", Field("robot", ("state",)), Literal("play")))),
        ("robot.hands[1].open", Atom(Flag(Field("robot", ("hands", 1, "open"))))),
        ("((p))", P),
    ],
)
def test_operators_bind_as_documented(text: str, meant: Formula) -> None:
    assert parse(text, KNOWN) == meant


@given(formulas_over([P, Q, R]))
def test_what_a_formula_is_shown_as_is_read_as_the_same(formula: Formula) -> None:
    assert parse(str(formula), KNOWN) == formula


@pytest.mark.parametrize(
    ("text", "column", "message", "mend"),
    [
        ("", 1, "empty", "always ball.x > 0"),
        ("always", 7, "ends too early", "a part of the formula is missing"),
        ("p and", 6, "ends too early", "a part of the formula is missing"),
        ("ball.x >", 9, "ends too early", "a value is missing"),
        ("(p", 3, "ends too early", "close the parenthesis"),
        ("p)", 2, "is not expected here", "was not opened"),
        ("p q", 3, "is not expected here", "joined by"),
        ("eventualy[0,10s] p", 1, "`eventualy` is not an operator", "did you mean `eventually`?"),
        ("Always p", 1, "`Always` is not an operator", "did you mean `always`?"),
        ("p an q", 3, "`an` is not an operator", "did you mean `and`?"),
        ("p and\nball.note 5", 11, "is not expected here", "joined by"),
        ("G p", 3, "is not expected here", "`G` is written `always p` here"),
        ("F[0,10s] p", 4, "is not expected here", "`F` is written `eventually p` here"),
        ("F(p)", 1, "unknown function", "`F` is written `eventually p` here"),
        ("p U q", 3, "is not expected here", "`U` is written `p until q` here"),
        ("p && q", 3, "is not expected here", "`and`"),
        ("always[10s] p", 11, "is not expected here", "two bounds"),
        ("always[0,10 p", 13, "is not expected here", "close the interval"),
        ("eventually[-1,3] p", 12, "is not expected here", "begins at 0 or later"),
        ("always[10,5s] p", 7, "ends before it starts", "the earlier bound first"),
        ("always[3,3) p", 7, "is empty", "the earlier bound first"),
        ("always[0,9999999h] p", 10, "longer than a century", "inf"),
        ("always bal.x > 3", 8, "unknown feature `bal`", "did you mean `ball`?"),
        ("in(ball, goel)", 10, "unknown region `goel`", "did you mean `goal`?"),
        ("goal", 1, "goal is a region", "in(ball, goal)"),
        ("inn(ball, goal)", 1, "unknown function `inn`", "did you mean `in`?"),
        ("in(ball)", 1, "takes a point and a region", None),
        ("in(3, goal)", 4, "not a point", "a feature's name"),
        ("po(ball.x > 3, goal)", 4, "not a region", "a feature's name"),
        ("abs(ball.x)", 1, "is a number, no formula", "compare it"),
        ("ball.x + 3", 1, "a value, no formula", "compare it"),
        ("ball.x > 'a' + 1", 10, "only numbers can be calculated with", None),
        ("3 > 'b'", 1, "can't be compared", "both in quotes"),
        ("ball.seen < true", 1, "no order", "=="),
        ("ball.x > (p and q)", 11, "a value is compared", "parentheses"),
        ("ball.x > in(ball, goal)", 10, "no value", "`and`"),
        ("ball.corners[a]", 14, "is not expected here", "counts from 0"),
        ("not " * 70 + "p", 241, "nested", "several queries"),
    ],
)
def test_a_mistake_is_told_with_its_column_and_a_hint(text: str, column: int, message: str, mend: str | None) -> None:
    with pytest.raises(InputError) as caught:
        parse(text, KNOWN)
    (fault,) = caught.value.faults
    assert (fault.file, fault.column) == ("formula", column)
    assert message in fault.message
    assert mend is None or mend in (fault.mend or "")


def test_all_unknown_names_are_told_at_once() -> None:
    with pytest.raises(InputError) as caught:
        parse("bal.x > 3 and\n in(ball, goel)", KNOWN)
    assert [(fault.line, fault.column) for fault in caught.value.faults] == [(1, 1), (2, 11)]


KEYWORDS = ("always", "eventually", "until", "and", "or", "not", "in", "distance", "abs", "inf")
OTHERS = (
    "->",
    "(",
    ")",
    "[",
    "]",
    ",",
    "0",
    "10s",
    "p",
    "ball",
    ".x",
    "goal",
    "<",
    "==",
    "+",
    "-",
    "*",
    "/",
    "'a'",
    "∧",
    "½",
)
WORDS = st.sampled_from([*KEYWORDS, *OTHERS])


@given(st.lists(WORDS, max_size=14).map(" ".join))
def test_no_text_makes_anything_but_a_formula_or_faults_with_a_place(text: str) -> None:
    try:
        parse(text, KNOWN)
    except InputError as error:
        assert all(fault.line and fault.column for fault in error.faults)


@pytest.mark.parametrize("text", ["always (in(hand, land)", "in(hand, land", "in(hand, land) ball.x > 3"])
def test_a_declared_name_is_no_misspelt_operator(text: str) -> None:
    known = Vocabulary({"hand", "ball"}, {"land": region_from({"circle": [0, 0], "radius": 1})})
    with pytest.raises(InputError) as told:
        parse(text, known)
    assert "is not an operator" not in str(told.value)
