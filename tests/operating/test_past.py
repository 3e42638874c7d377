"""The events that a run remembers, and the rates of its streams, by a clock that stands still."""

from __future__ import annotations

import pytest
from cfgplan_runtime.children.messages import PortCounts
from cfgplan_runtime.lifecycle.reports import Observed, Report, UnitEvent
from cfgplan_runtime.operating import past as bounds
from cfgplan_runtime.operating.past import EVENTS_KEPT, Past
from cfgplan_runtime.operating.stream_rates import StreamRates
from cfgplan_runtime.supervision.events import UnitPrinted, UnitReady
from cfgplan_runtime.supervision.observation import Observation


class Clock:
    def __init__(self) -> None:
        self.now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


def ready(unit: str) -> Report:
    return UnitEvent(UnitReady(unit, 10))


def test_the_last_events_and_those_of_the_last_seconds_are_told() -> None:
    clock = Clock()
    past = Past(clock)
    for number in range(4):
        clock.now_s = 10.0 * number
        past.take(ready(f"a.{number}"))
    assert [event["unit"] for event in past.events()] == ["a.0", "a.1", "a.2", "a.3"]
    assert [event["unit"] for event in past.events(last=2)] == ["a.2", "a.3"]
    assert [event["number"] for event in past.events(since_s=15)] == [3, 4]
    assert [event["number"] for event in past.events(last=1, since_s=15)] == [4]
    assert past.events(last=0) == []


def test_observations_are_no_events_and_printed_lines_are_not_kept_here() -> None:
    past = Past()
    assert past.take(Observed(())) is None
    printed = past.take(UnitEvent(UnitPrinted("a.1", "hello")))
    assert printed is not None and printed["number"] == 1
    assert past.events() == []


def test_the_past_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    past = Past()
    for number in range(EVENTS_KEPT + 5):
        past.take(ready(f"a.{number}"))
    assert [event["unit"] for event in past.events()][:: EVENTS_KEPT - 1] == ["a.5", f"a.{EVENTS_KEPT + 4}"]
    monkeypatch.setattr(bounds, "MOST_BYTES", 1000)
    past.take(ready("x" * 2000))
    assert len(past.events()) == 1
    past.take(ready("b.1"))
    assert [event["unit"] for event in past.events()] == ["b.1"]


def seen(elements: int) -> Report:
    return Observed((Observation("a.1", "a", 0, 0, outputs={"o": PortCounts(elements)}),))


@pytest.mark.parametrize(("period_s", "rate_hz"), [(0.1, 10.0), (8.0, 0.125)])
def test_a_rate_is_over_ten_seconds_or_as_long_as_a_slow_stream_needs(period_s: float, rate_hz: float) -> None:
    clock = Clock()
    rates = StreamRates(clock)
    for second in range(200):
        clock.now_s = float(second)
        rates.hear(seen(int(second / period_s + 1e-9)))
    (record,) = rates.records()
    assert record["rate_hz"] == pytest.approx(rate_hz, rel=0.2)
    assert record["silent_s"] == pytest.approx(199 % 8 if period_s == 8.0 else 0)


def test_streams_of_units_that_are_gone_are_forgotten() -> None:
    rates = StreamRates()
    rates.hear(seen(1))
    assert [record["silent_s"] is None for record in rates.records()] == [False]
    rates.hear(Observed(()))
    assert rates.records() == []


def test_a_new_unit_with_the_id_of_a_dead_one_has_a_rate_of_its_own() -> None:
    clock = Clock()
    rates = StreamRates(clock)
    for second, elements in enumerate([0, 10, 20, 5, 15]):
        clock.now_s = float(second)
        rates.hear(seen(elements))
    assert [(record["rate_hz"], record["silent_s"]) for record in rates.records()] == [(10.0, 0.0)]
