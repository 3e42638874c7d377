"""The engine with streams that are lists: set-up, answers, what is missing, and taking down."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import NoReturn

import pytest
from cfgplan_runtime.reasoning.engine import Engine
from cfgplan_runtime.reasoning.features import DeclaredFeatures, Feature, of_options
from cfgplan_runtime.reasoning.queries import Answer, Noted, QueryReport, SetUp, UnmetTargetsError, query
from cfgplan_runtime.reasoning.states import Timing
from cfgplan_runtime.reasoning.truth import Verdict
from fake_subscriptions import FakeSubscriptions, Given, Stream, stream

from cfgplan.domain import Target
from cfgplan.errors import InputError

MS = 1_000_000
REGIONS = of_options([], ["right={box: [0, -3, 4, 3]}"]).regions
WORLD = DeclaredFeatures({"ball": Feature("ball", "Ball"), "robot": Feature("robot", "Robot", "/robot")}, REGIONS)


def at(x: float) -> dict[str, float]:
    return {"x": x, "y": 0.0}


def ask(text: str, fake: FakeSubscriptions, for_s: float = 60, wait_s: float = 0, **timing: int) -> list[QueryReport]:
    told: list[QueryReport] = []
    engine = Engine(query(text, WORLD, Timing(**timing)), fake, told.append, name="q")
    engine.run(for_s=for_s, wait_s=wait_s)
    return told


def answer(told: list[QueryReport]) -> Answer:
    assert isinstance(told[-1], Answer)
    return told[-1]


def test_an_answer_comes_with_the_state_that_decides_and_takes_the_targets_down() -> None:
    fake = FakeSubscriptions({"Ball": stream(*(at(x) for x in (1, 2, -1, 3)))})
    told = ask("always in(ball, right)", fake)
    found = answer(told)
    assert (found.verdict, found.time_ns, found.states) == (Verdict.FALSE, 200 * MS, 3)
    assert fake.log == ["add Ball", "remove Ball"]
    assert isinstance(told[0], SetUp)
    assert told[0].topics == {"ball": "/query/q/ball"}


def test_a_formula_without_features_needs_no_stream() -> None:
    fake = FakeSubscriptions({})
    assert answer(ask("true or false", fake)).verdict is Verdict.TRUE
    assert fake.log == []


def test_only_the_features_that_the_formula_names_are_subscribed_to() -> None:
    fake = FakeSubscriptions({"/robot": stream({"ok": True})})
    assert answer(ask("eventually robot.ok", fake)).verdict is Verdict.TRUE
    assert fake.log == []


def test_two_streams_are_compared_in_states_of_one_time() -> None:
    balls = stream(at(1), at(2), at(3), at(4), at(4))
    robots = stream(at(9), at(9), at(4), at(9), at(9), begin_ms=50)
    fake = FakeSubscriptions({"Ball": balls, "/robot": robots})
    found = answer(ask("eventually distance(ball, robot) < 1.5", fake))
    assert (found.verdict, found.time_ns) == (Verdict.TRUE, 250 * MS)


def test_a_stream_that_falls_silent_makes_the_answer_unknown_not_true() -> None:
    fake = FakeSubscriptions({"Ball": stream(at(1), at(1), at(1))})
    found = answer(ask("always[0,600ms] in(ball, right)", fake, hold_ns=150 * MS))
    assert found.verdict is Verdict.UNKNOWN
    assert found.missing == {"ball": pytest.approx(2, abs=2)}


def test_what_is_seen_after_a_silence_still_decides() -> None:
    late = [*stream(at(-1), at(-1)), *stream(at(1), begin_ms=500)]
    found = answer(ask("eventually[0,600ms] in(ball, right)", FakeSubscriptions({"Ball": late}), hold_ns=150 * MS))
    assert (found.verdict, found.time_ns) == (Verdict.TRUE, 500 * MS)


def test_a_field_that_is_not_there_is_told_once_and_makes_it_unknown() -> None:
    fake = FakeSubscriptions({"Ball": stream(*[at(1)] * 5)})
    told = ask("always[0,300ms] ball.z > 0", fake)
    assert answer(told).verdict is Verdict.UNKNOWN
    notes = [one.text for one in told if isinstance(one, Noted)]
    assert notes == ["ball.z > 0 is unknown where ball has no field `z`; it has x, y"]


def test_a_mapping_that_is_compared_as_a_whole_is_told_with_one_of_its_fields() -> None:
    told = ask("always[0,300ms] ball > 0", FakeSubscriptions({"Ball": stream(*[at(1)] * 5)}))
    notes = [one.text for one in told if isinstance(one, Noted)]
    assert notes == ["ball > 0 is unknown where ball is a mapping: compare one of its fields, such as ball.x"]
    assert all(one.is_unknown for one in told if isinstance(one, Noted))


def test_an_answer_that_is_open_when_the_time_is_over_says_what_it_waits_for() -> None:
    now = stream(at(-1))
    found = answer(
        ask("always (not in(ball, right) -> eventually[0,99s] in(ball, right))", FakeSubscriptions({"Ball": now}), 0.4)
    )
    assert (found.verdict, found.delay_s) == (Verdict.OPEN, None)
    assert ("eventually[0s, 99s] in(ball, right)", 0, 99_000 * MS) in [
        (each.text, each.since_ns, each.until_ns) for each in found.waiting
    ]


def test_a_target_that_nothing_can_meet_ends_the_query_with_the_reason() -> None:
    fake = FakeSubscriptions({"Ball": []}, refusals={"Ball": ["no output matches"] * 99})
    with pytest.raises(UnmetTargetsError, match="no output matches"):
        ask("always ball.x > 0", fake)
    assert fake.log[-1] == "remove Ball"
    assert fake.targets == {}


def test_a_target_can_be_waited_for() -> None:
    fake = FakeSubscriptions({"Ball": stream(at(1))}, refusals={"Ball": ["not yet", "not yet"]})
    assert answer(ask("eventually ball.x > 0", fake, wait_s=30)).verdict is Verdict.TRUE


def test_a_target_that_is_refused_is_not_taken_down() -> None:
    class Refusing(FakeSubscriptions):
        def add(self, targets: Sequence[Target]) -> None:
            raise InputError.of(f"{targets[0].tag} can't be used")

    fake = Refusing({})
    with pytest.raises(InputError, match="can't be used"):
        ask("always ball.x > 0", fake)
    assert fake.log == []


def test_a_topic_that_fails_ends_the_query_and_takes_the_targets_down() -> None:
    class Broken(FakeSubscriptions):
        def samples(self, topic: str, wait_s: float) -> NoReturn:  # noqa: ARG002
            raise InputError.of(f"{topic} is gone")

    fake = Broken({})
    with pytest.raises(InputError, match="is gone"):
        ask("always ball.x > 0", fake)
    assert fake.log == ["add Ball", "remove Ball"]


def test_a_stream_on_the_computers_clock_is_answered_with_its_delay() -> None:
    now = time.time_ns()
    fake = FakeSubscriptions({"Ball": [Given(now - 50 * MS, at(1)), Given(now, at(-1))]})
    found = answer(ask("always in(ball, right)", fake))
    assert (found.verdict, found.time_ns) == (Verdict.FALSE, now)
    assert found.delay_s is not None
    assert 0 <= found.delay_s < 50


@pytest.mark.parametrize("ahead_s", [30, -30])
def test_states_go_by_the_runs_clock_though_the_computers_was_set_since(ahead_s: int) -> None:
    class Set(FakeSubscriptions):
        """A run whose clock began as the time of day, which was set by `ahead_s` since."""

        @contextmanager
        def samples(self, topic: str, wait_s: float) -> Iterator[Stream]:
            with super().samples(topic, wait_s) as given:
                given.now_ns = run_ns  # type: ignore[attr-defined]
                yield given

    def run_ns() -> int:
        return time.time_ns() + ahead_s * 1000 * MS

    now = run_ns()
    fake = Set({"Ball": [Given(now, at(1))], "/robot": [Given(now, at(9)), Given(now + MS, at(1))]})
    found = answer(ask("eventually distance(ball, robot) < 1", fake, for_s=10))
    assert (found.verdict, found.time_ns, found.late) == (Verdict.TRUE, now + MS, 0)
    assert found.delay_s is not None
    assert 0 <= found.delay_s < 10
