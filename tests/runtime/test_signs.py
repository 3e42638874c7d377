"""How often units give signs of life: seldom while they have nothing to do."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from types import SimpleNamespace

import pytest
from cfgplan_runtime import Runtime
from cfgplan_runtime.children.messages import Activate, FromChild, UnitSign
from cfgplan_runtime.children.unit_order import unit_order
from cfgplan_runtime.supervision.events import Event, UnitHung, UnitStatus
from watching import StartRuntime, seen
from world import child_of, eventually, source, unit, worker

from cfgplan.domain import ChangeSet, RunOptions


def signs_told(runtime: Runtime) -> Counter[str]:
    """Counts the signs of life of each unit from now on."""
    told = Counter[str]()

    def note(event: Event) -> None:
        if isinstance(event, UnitStatus):
            told[event.unit] += 1

    runtime.listen(note)
    return told


def test_an_idle_unit_gives_few_signs_and_a_working_one_a_sign_a_second(run_units: StartRuntime) -> None:
    idle = replace(source(), label="idle", run=RunOptions(rate_hz=0.001))
    runtime = run_units(source(), worker(), idle)
    units = unit("count.1"), unit("work.1", topic="/result", x="count.1/n"), unit("idle.1")
    runtime.apply(ChangeSet(units))
    told = signs_told(runtime)
    eventually(lambda: told["work.1"] >= 10)
    assert told["count.1"] >= 8
    assert 1 <= told["idle.1"] <= 5


@pytest.mark.parametrize(("call_ms", "told"), [(10, [1]), (200, [1, 2, 3])])
def test_a_source_tells_its_first_element_and_those_of_slow_calls_before_its_code_is_called_again(
    monkeypatch: pytest.MonkeyPatch, call_ms: int, told: list[int]
) -> None:
    """The next call may block for long: a map that comes once, for example."""
    clock, said = SimpleNamespace(now_ns=0), list[FromChild]()
    times = SimpleNamespace(monotonic_ns=lambda: clock.now_ns, process_time_ns=lambda: 0)
    monkeypatch.setattr("cfgplan_runtime.children.unit_child.time", times)
    with child_of(source()) as child:
        code = child._code
        assert code is not None
        produce = code.produce

        def called() -> object:
            clock.now_ns += call_ms * 1_000_000
            return produce()

        monkeypatch.setattr(code, "produce", called)
        monkeypatch.setattr(child._ports, "say", said.append)
        child._obey(Activate(), [])
        for _ in range(4):
            child._work()
        assert child.step == 4
    assert [one.outputs["n"].elements for one in said if isinstance(one, UnitSign)] == told


@pytest.mark.parametrize(("hang_us", "sign_s"), [(None, 4), (0, 4), (60_000_000, 4), (6_000_000, 2), (2_000_000, 1)])
def test_signs_come_more_often_where_silence_is_judged_sooner(hang_us: int | None, sign_s: float) -> None:
    order = unit_order("work.1", replace(worker(), run=RunOptions(hang_us=hang_us)), None)
    assert order.idle_sign_ns == sign_s * 1e9


def test_an_idle_unit_that_may_be_silent_for_two_seconds_is_left_alone(run_units: StartRuntime) -> None:
    idle = replace(source(), label="idle", run=RunOptions(rate_hz=0.001, hang_us=2_000_000))
    runtime = run_units(idle)
    runtime.apply(ChangeSet((unit("idle.1"),)))
    told = signs_told(runtime)
    eventually(lambda: told["idle.1"] >= 4)
    assert seen(runtime, UnitHung) == []
