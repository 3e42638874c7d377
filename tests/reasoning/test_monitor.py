"""The monitor: early verdicts, three values, memory, and being fed."""

from __future__ import annotations

import numpy as np
import pytest
from cfgplan_runtime.reasoning import automaton, obligations
from cfgplan_runtime.reasoning.monitor import Monitor
from cfgplan_runtime.reasoning.obligations import TooManyObligationsError
from cfgplan_runtime.reasoning.syntax import Always, And, Atom, Eventually, Formula, Implies, Interval, Not, Or, Until
from cfgplan_runtime.reasoning.truth import FALSE, TRUE, UNKNOWN, Truth, Verdict
from direct import State, holds
from following import VERDICT, follow, truths
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from random_formulas import ATOMS, formulas, three_values, traces

from cfgplan.errors import InvalidValueError

P, Q, R = (Atom(name) for name in ATOMS)
TEN = Interval(0, 10)


def states(text: str, every: int = 1) -> list[State]:
    """One state for each group of letters: the atoms that hold in it; `?p` is unknown."""
    found = []
    for number, group in enumerate(text.split()):
        known: dict[str, bool | None] = {name: name in group for name in ATOMS}
        found.append((number * every, {**known, **{name: None for name in ATOMS if f"?{name}" in group}}))
    return found


@pytest.mark.parametrize(
    ("formula", "text", "verdict", "decided_at"),
    [
        (Always(P, TEN), "p p p - p", Verdict.FALSE, 3),
        (Eventually(P, TEN), "- - p", Verdict.TRUE, 2),
        (Eventually(P, TEN), "- " * 20, Verdict.FALSE, 10),
        (Always(P, TEN), "p " * 20, Verdict.TRUE, 10),
        (Until(P, Q, TEN), "p p - q", Verdict.FALSE, 2),
        (Until(P, Q, TEN), "p p q", Verdict.TRUE, 2),
        (Always(Implies(P, Eventually(Q, Interval(0, 3)))), "- p q - p - - - -", Verdict.FALSE, 7),
        (Eventually(And(Q, Always(P, Interval(0, 2)))), "qp qp p p", Verdict.TRUE, 2),
        (Always(P), "?p p -", Verdict.FALSE, 2),
        (Eventually(P), "?p - p", Verdict.TRUE, 2),
        (Eventually(P, Interval(0, 2)), "- ?p - p", Verdict.UNKNOWN, 2),
        (Always(P, Interval(0, 2)), "p ?p p p", Verdict.UNKNOWN, 2),
        (Or(Always(P), Not(Always(P))), "p p p", Verdict.OPEN, 2),
    ],
)
def test_a_verdict_comes_with_the_state_that_makes_it_certain(
    formula: Formula, text: str, verdict: Verdict, decided_at: int
) -> None:
    monitor = Monitor(formula)
    follow(monitor, states(text))
    assert (monitor.verdict, monitor.time_ns) == (verdict, decided_at)


def test_what_can_still_come_of_an_unknown_value_is_told() -> None:
    monitor = Monitor(Always(P))
    follow(monitor, states("p ?p p"))
    assert monitor.possible == {Verdict.FALSE, Verdict.UNKNOWN}


@settings(max_examples=250, deadline=None)
@given(formulas, traces(three_values, 8), st.data())
def test_a_verdict_holds_however_unknown_values_are_filled_in(
    formula: Formula, trace: list[State], data: st.DataObject
) -> None:
    monitor = Monitor(formula)
    follow(monitor, trace)
    assume(monitor.ended() is not Verdict.UNKNOWN)
    filled = [
        (time, {name: data.draw(st.booleans()) if value is None else value for name, value in state.items()})
        for time, state in trace
    ]
    assert VERDICT[holds(formula, filled)] == monitor.ended()


def test_always_within_always_is_one_obligation() -> None:
    monitor = Monitor(Always(Always(P, TEN)))
    follow(monitor, states("p " * 50))
    assert monitor.size == 3 + 1
    (inner,) = [each for each in monitor.waiting() if each.until_ns is not None]
    assert (inner.since_ns, inner.until_ns) == (49, 59)


def test_the_earliest_of_open_promises_is_kept() -> None:
    monitor = Monitor(Always(Implies(P, Eventually(Q, TEN))))
    follow(monitor, states("- - p p p -"))
    assert [(each.since_ns, each.until_ns) for each in monitor.waiting() if each.until_ns] == [(2, 12)]


def test_what_had_ended_when_the_verdict_came_is_told() -> None:
    monitor = Monitor(Always(Implies(P, Eventually(Q, Interval(0, 3)))))
    follow(monitor, states("- p - - - -"))
    assert [(each.text, each.since_ns) for each in monitor.expired] == [("eventually[0s, 3ns] q", 1)]


@settings(max_examples=200, deadline=None)
@given(formulas, traces(three_values, 30))
def test_feeding_many_states_at_once_is_the_same_as_one_at_a_time(formula: Formula, trace: list[State]) -> None:
    slow, fast = Monitor(formula), Monitor(formula)
    follow(slow, trace)
    times = np.array([time for time, _ in trace])
    values = np.array([truths(fast, state) for _, state in trace], np.int8).reshape(len(trace), -1)
    half = len(trace) // 2
    fast.feed(times[:half], values[:half])
    fast.feed(times[half:], values[half:])
    assert (fast.verdict, fast.time_ns, fast.states) == (slow.verdict, slow.time_ns, slow.states)
    assert fast.waiting() == slow.waiting()


@settings(max_examples=150, deadline=None)
@given(formulas, traces(three_values, 30))
def test_forgetting_transitions_changes_nothing(formula: Formula, trace: list[State]) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(automaton, "MOST_REMEMBERED", 8)
        monitor = Monitor(formula)
        follow(monitor, trace)
        assert monitor.ended() == VERDICT[holds(formula, trace)]


def test_memory_is_bounded_on_irregular_streams() -> None:
    random = np.random.default_rng(5)
    formula = Always(Implies(P, Eventually(And(Q, Always(R, Interval(0, 30))), Interval(20, 90))))
    monitor = Monitor(formula)
    count = 3_000
    given_ = {"p": random.random(count) < 0.5, "q": random.random(count) < 0.7, "r": np.full(count, True)}
    values = np.stack([given_[str(each)] for each in monitor.program.propositions], axis=1)
    times = np.cumsum(random.integers(1, 9, count))
    sizes = []
    for at in range(0, count, 100):
        monitor.feed(times[at : at + 100], values[at : at + 100])
        sizes.append(monitor.size)
    assert monitor.verdict is Verdict.OPEN
    assert max(sizes) < 300
    assert max(sizes[len(sizes) // 2 :]) <= 2 * max(sizes[: len(sizes) // 2])


@settings(max_examples=60, deadline=None)
@given(formulas, st.integers(0, 2**32), st.sampled_from([0.2, 0.5, 0.9]))
def test_what_is_left_does_not_grow_with_the_stream(formula: Formula, seed: int, share: float) -> None:
    random = np.random.default_rng(seed)
    monitor = Monitor(formula)
    values = random.random((300, len(monitor.program.propositions))) < share
    times = np.cumsum(random.integers(1, 4, 300))
    sizes = []
    for at in range(0, 300, 5):
        monitor.feed(times[at : at + 5], values[at : at + 5])
        sizes.append(monitor.size)
    assert max(sizes) <= 500


def test_a_queue_that_was_short_when_a_step_was_learnt_may_be_long_the_next_time() -> None:
    formula = Always(Implies(P, Eventually(Q, Interval(10, 12))))
    times = [0, 1, 11, 12, 20, 21, 22, 31, 36, 40]
    trace = [(time, {"p": time in (0, 1, 20, 21, 22), "q": time in (11, 31)}) for time in times]
    monitor = Monitor(formula)
    follow(monitor, trace)
    assert (monitor.verdict, monitor.time_ns) == (Verdict.FALSE, 36)


def test_later_promises_for_ever_are_not_kept_by_what_kept_the_earlier() -> None:
    formula = Always(Implies(P, Eventually(Q, Interval(5))))
    monitor = Monitor(formula)
    follow(monitor, [(time, {"p": time in (0, 3), "q": time == 6}) for time in range(12)])
    assert monitor.ended() is Verdict.FALSE


def test_a_queue_that_falls_apart_is_followed_one_by_one() -> None:
    formula = Eventually(Until(P, Q, Interval(10, 10)))
    trace: list[State] = []
    for time in range(25):
        trace.append((time, {"p": None if time == 8 else True, "q": time == 17}))
        monitor = Monitor(formula)
        follow(monitor, trace)
        assert monitor.ended() == VERDICT[holds(formula, trace)]
    shared = Monitor(formula)
    for count, (time, state) in enumerate(trace, 1):
        shared.step(time, truths(shared, state))
        assert shared.ended() == VERDICT[holds(formula, trace[:count])]


def test_members_that_come_again_deeper_inside_are_not_kept_twice() -> None:
    always_p, always_q = Always(P, Interval(1)), Always(Eventually(Q, Interval(4)), Interval(7))
    monitor = Monitor(Until(Eventually(always_p, Interval(3)), always_q))
    random = np.random.default_rng(3)
    sizes = []
    for time in range(200):
        monitor.step(time, [bool(each) for each in random.random(2) < 0.5])
        sizes.append(monitor.size)
    assert max(sizes) < 100


def test_times_must_rise() -> None:
    monitor = Monitor(Always(P))
    monitor.step(5, [TRUE])
    with pytest.raises(InvalidValueError, match="times must rise"):
        monitor.step(5, [TRUE])
    assert monitor.step(6, [FALSE]) is Verdict.FALSE


@pytest.mark.parametrize("row", [[], [TRUE, TRUE], [FALSE, FALSE, TRUE]])
def test_rows_of_the_wrong_length_are_refused(row: list[Truth]) -> None:
    monitor = Monitor(Always(P))
    with pytest.raises(InvalidValueError, match=f"{len(row)} truths, but there are 1 propositions"):
        monitor.step(5, row)
    assert monitor.step(5, [FALSE]) is Verdict.FALSE


def test_a_state_can_be_given_by_names_and_what_is_absent_is_unknown() -> None:
    monitor, names = Monitor(And(Eventually(P), Always(Q))), [str(each) for each in (P, Q)]
    with pytest.raises(InvalidValueError, match="'r' is not a proposition of the formula; its propositions are "):
        monitor.step_by_names(0, {"r": True})
    assert monitor.step_by_names(0, {names[1]: True}) is Verdict.OPEN
    assert monitor.step_by_names(1, {names[1]: False, names[0]: True}) is Verdict.FALSE


def test_arrays_of_the_wrong_shape_are_refused() -> None:
    with pytest.raises(InvalidValueError, match="1 propositions"):
        Monitor(Always(P)).feed(np.array([1, 2]), np.zeros((2, 2), np.int8))


def test_a_formula_of_many_propositions_is_fed_like_any_other() -> None:
    names = [Atom(f"a{number}") for number in range(45)]
    formula: Formula = Always(names[0])
    for name in names[1:]:
        formula = And(formula, Always(name))
    monitor = Monitor(formula)
    values = np.full((3, 45), TRUE, np.int8)
    values[1, 44] = UNKNOWN
    values[2, 40] = FALSE
    assert monitor.feed(np.array([1, 2, 3]), values) is Verdict.FALSE
    assert monitor.time_ns == 3


def test_obligations_without_end_are_refused_rather_than_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(obligations, "MOST_MEMBERS", 20)
    monitor = Monitor(Always(Implies(P, Eventually(And(Q, Eventually(R, Interval(30, 40))), Interval(0, 90)))))
    with pytest.raises(TooManyObligationsError, match="shorten the intervals"):
        follow(monitor, states("pq p " * 40))


def test_moments_without_end_are_refused_rather_than_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(automaton, "MOST_MOMENTS", 20)
    monitor = Monitor(Always(Implies(P, Eventually(Q, Interval(50, 60)))))
    with pytest.raises(TooManyObligationsError, match="shorten them"):
        follow(monitor, states("p " * 40))


def test_a_final_verdict_stays() -> None:
    monitor = Monitor(Eventually(P))
    follow(monitor, states("p - -"))
    assert (monitor.verdict, monitor.time_ns, monitor.states) == (Verdict.TRUE, 0, 1)
