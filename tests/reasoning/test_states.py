"""Streams synchronised into states."""

from __future__ import annotations

from cfgplan_runtime.reasoning.states import FeatureState, Synchroniser, Timing
from hypothesis import given
from hypothesis import strategies as st

MS = 1_000_000
TIMING = Timing(hold_ns=500 * MS, delay_ns=100 * MS, beat_ns=10_000 * MS, patience_ns=2_000 * MS)


def brief(states: list[FeatureState]) -> list[tuple[int, dict[str, object]]]:
    return [(state.time_ns // MS, dict(state.values)) for state in states]


def test_states_begin_when_each_feature_has_a_sample() -> None:
    streams = Synchroniser({"a": None, "b": None}, TIMING, begin_ns=0)
    streams.push("a", 10 * MS, 1)
    assert brief(list(streams.ready(50 * MS))) == []
    streams.push("b", 30 * MS, "x")
    streams.push("a", 40 * MS, 2)
    assert brief(list(streams.ready(50 * MS))) == [(30, {"a": 1, "b": "x"})]


def test_a_state_is_given_when_every_feature_has_passed_its_time_and_at_the_latest_after_the_delay() -> None:
    streams = Synchroniser({"a": None, "b": None}, TIMING, begin_ns=0)
    for name in "ab":
        streams.push(name, 10 * MS, 1)
    streams.push("a", 20 * MS, 2)
    assert brief(list(streams.ready(30 * MS))) == [(10, {"a": 1, "b": 1})]
    streams.push("b", 25 * MS, 2)
    assert brief(list(streams.ready(30 * MS))) == [(20, {"a": 2, "b": 1})]
    assert list(streams.ready(124 * MS)) == []
    assert streams.due_ns() == 125 * MS
    (forced,) = streams.ready(125 * MS)
    assert (forced.time_ns, forced.values, forced.is_forced) == (25 * MS, {"a": 2, "b": 2}, True)
    assert streams.forced == 1


def test_a_value_that_is_older_than_the_hold_is_missing_in_a_state_of_its_own() -> None:
    streams = Synchroniser({"a": None}, TIMING, begin_ns=0)
    streams.push("a", 10 * MS, 1)
    assert [state.values for state in streams.ready(800 * MS)] == [{"a": 1}, {}]
    assert streams.missing == {"a": 1}
    streams.push("a", 700 * MS, 2)
    assert brief(list(streams.ready(800 * MS))) == [(700, {"a": 2})]


def test_a_feature_can_have_a_hold_of_its_own() -> None:
    streams = Synchroniser({"a": None, "map": 10_000 * MS}, TIMING, begin_ns=0)
    streams.push("a", 10 * MS, 1)
    streams.push("map", 10 * MS, "m")
    streams.push("a", 3_000 * MS, 2)
    assert brief(list(streams.ready(3_100 * MS)))[-1] == (3000, {"a": 2, "map": "m"})


def test_what_comes_after_its_state_is_late_and_counts_from_the_next_state_on() -> None:
    streams = Synchroniser({"a": None}, Timing(rate_hz=10, delay_ns=100 * MS), begin_ns=0)
    streams.push("a", 0, 1)
    assert brief(list(streams.ready(400 * MS))) == [(ms, {"a": 1}) for ms in (0, 100, 200, 300)]
    streams.push("a", 250 * MS, 2)
    assert streams.late == 1
    assert brief(list(streams.ready(500 * MS))) == [(400, {"a": 2})]
    streams.push("a", 240 * MS, 3)
    assert streams.late == 2
    assert brief(list(streams.ready(600 * MS))) == [(500, {"a": 2})]


def test_samples_within_the_tolerance_make_one_state() -> None:
    timing = Timing(hold_ns=500 * MS, delay_ns=100 * MS, tolerance_ns=5 * MS, beat_ns=10_000 * MS)
    streams = Synchroniser({"a": None, "b": None}, timing, begin_ns=0)
    for name, ms, value in [("a", 0, 0), ("b", 0, 0), ("a", 100, 1), ("b", 103, 1), ("a", 200, 2), ("b", 203, 2)]:
        streams.push(name, ms * MS, value)
    found = brief(list(streams.ready(210 * MS)))
    assert found == [(0, {"a": 0, "b": 0}), (103, {"a": 1, "b": 1})]
    assert brief(list(streams.ready(305 * MS))) == [(203, {"a": 2, "b": 2})]


def test_silence_is_seen_in_states_without_values() -> None:
    timing = Timing(hold_ns=100 * MS, delay_ns=0, beat_ns=250 * MS)
    streams = Synchroniser({"a": None}, timing, begin_ns=0)
    streams.push("a", 0, 1)
    found = brief(list(streams.ready(700 * MS)))
    assert found == [(0, {"a": 1}), (100, {}), (350, {}), (600, {})]


def test_states_begin_without_a_feature_when_the_patience_is_at_its_end() -> None:
    streams = Synchroniser({"a": None, "b": None}, TIMING, begin_ns=0)
    streams.push("a", 1_900 * MS, 1)
    assert list(streams.ready(1_999 * MS)) == []
    assert brief(list(streams.ready(2_100 * MS))) == [(2000, {"a": 1})]


samples = st.lists(st.tuples(st.sampled_from("ab"), st.integers(0, 40), st.integers(0, 30)), max_size=30)


@given(samples, st.sampled_from([None, 100.0, 250.0]))
def test_states_are_as_the_definition_says_whatever_arrives_when(
    arrivals: list[tuple[str, int, int]], rate_hz: float | None
) -> None:
    """Each arrival: a feature, its time after the last of the feature, its latency; all in ms."""
    timing = Timing(hold_ns=20 * MS, delay_ns=10 * MS, rate_hz=rate_hz, beat_ns=15 * MS, patience_ns=30 * MS)
    clock = {"a": 0, "b": 0}
    events = []
    for feature, step, latency in arrivals:
        clock[feature] += step + 1
        events.append((clock[feature] + latency, feature, clock[feature]))
    arrived: dict[str, list[int]] = {"a": [], "b": []}
    in_time: list[int] = []
    given_at: list[int] = []
    streams = Synchroniser({"a": None, "b": None}, timing, begin_ns=0)
    for now, feature, time in sorted(events):
        for state in streams.ready(now * MS):
            at = state.time_ns
            assert not given_at or at > given_at[-1]
            given_at.append(at)
            known = {name: [t for t in times if t * MS <= at] for name, times in arrived.items()}
            expected = {n: max(ts) for n, ts in known.items() if ts and at - max(ts) * MS <= timing.hold_ns}
            assert state.values == expected
            passed = all(times and max(times) * MS >= at for times in arrived.values())
            assert passed or at <= now * MS - timing.delay_ns
            assert state.is_forced != passed
        if not arrived[feature] or time > max(arrived[feature]):
            arrived[feature].append(time)
            if not given_at or time * MS > given_at[-1]:
                in_time.append(time * MS)
        streams.push(feature, time * MS, time)
        assert streams.due_ns() >= 0
    if given_at and rate_hz is None:
        assert {time for time in in_time if given_at[0] < time <= given_at[-1]} <= set(given_at)
