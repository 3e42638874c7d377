"""Programs are units: they keep to a protocol, and are killed, replaced, observed and stopped as others."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any, get_args

import psutil
import pytest
from cfgplan_runtime import ApplyError
from cfgplan_runtime.supervision.events import (
    SourceExhausted,
    UnitCutShort,
    UnitDied,
    UnitFailed,
    UnitHung,
    UnitPrinted,
)
from living import lives
from program_units import program, provider
from unit_signals import signal_unit
from watching import Listener, StartRuntime, seen
from world import eventually, source, start, unit, worker

from cfgplan.domain import ChangeSet, RunOptions, Transformation
from cfgplan.transformations import ProgramFormat

COUNT, WORK = unit("count.1"), unit("work.1", topic="/result", x="count.1/n")


pytestmark = pytest.mark.parametrize("form", get_args(ProgramFormat))


def process_of(pid: int | None) -> psutil.Process:
    """The program that a unit's process hosts."""
    (started,) = psutil.Process(pid).children()
    return started


def rises(values: list[Any]) -> bool:
    return values == list(range(values[0], values[0] + len(values)))


def test_each_step_is_a_line_with_number_time_and_inputs(run_units: StartRuntime, form: ProgramFormat) -> None:
    runtime = run_units(source(), program(form, "request"))
    runtime.apply(start(COUNT, WORK))
    listener = Listener("/result")
    eventually(lambda: len(listener.received) > 5)
    first = listener.received[0]
    assert set(first.value) == {"step", "time_ns", "inputs"}
    assert first.value["time_ns"] == first.time_ns
    steps = [value["step"] for value in listener.values]
    assert rises(steps)
    assert rises([value["inputs"]["x"] for value in listener.values])
    runtime.close()
    listener.join()


def test_a_program_gets_params_and_logs_on_standard_error(run_units: StartRuntime, form: ProgramFormat) -> None:
    runtime = run_units(program(form, level=5))
    runtime.apply(start(unit("work.1")))
    eventually(lambda: any('{"level":5}' in event.line for event in seen(runtime, UnitPrinted)))


def test_an_answer_may_have_several_results_or_none(run_units: StartRuntime, form: ProgramFormat) -> None:
    runtime = run_units(source(), program(form, "several"), program(form, "nothing", label="quiet"))
    runtime.apply(start(COUNT, WORK, unit("quiet.1", x="count.1/n")))
    listener = Listener("/result")
    eventually(lambda: len(listener.received) > 20)
    values = listener.values
    assert all(later in ([value], value + 1) for value, later in pairwise(values) if isinstance(value, int))
    eventually(lambda: any(o.unit == "quiet.1" and o.steps > 20 for o in runtime.observe()))
    assert seen(runtime, UnitFailed)[0].what == "not ready yet"
    runtime.close()
    listener.join()


@pytest.mark.parametrize(
    ("deed", "what", "part"),
    [
        ("chatter", "no {form}", "loading the model"),
        ("broken", "no {form}", ""),
        ("no utf-8", "no {form}", "\\xff\\xfe"),
        ("deep", "no {form}", "recursion"),
        ("no answer", "no answer", "`output`"),
        ("no step", "no answer", "its `step` is missing"),
        ("two steps", "no answer", "all answers of a list must have one `step`"),
        ("skips", "no answer", "got no answer before step"),
        ("port", "unknown port", "there is no output port 'z', only y"),
        ("time", "time going back", "the time 1 is before 2, the last at y"),
        ("no time", "no answer", "`int` <="),
        ("large", "too large", "more than 64 MB in one message"),
        ("twice", "not asked for", ""),
        ("late", "not asked for", ""),
        ("early", "not asked for", ""),
    ],
)
def test_wrong_output_is_told_once_with_the_line_and_counted_and_the_unit_goes_on(
    run_units: StartRuntime, form: ProgramFormat, deed: str, what: str, part: str
) -> None:
    what = what.format(form={"json": "JSON", "msgpack": "msgpack"}[form])
    runtime = run_units(source(rate_hz=20 if deed == "large" else 200), program(form, deed))
    runtime.apply(start(COUNT, WORK))
    listener = Listener("/result")
    eventually(lambda: any(o.errors > (1 if deed == "large" else 3) for o in runtime.observe()))
    got = len(listener.received)
    eventually(lambda: len(listener.received) > got + 10)
    told = [event for event in seen(runtime, UnitFailed) if event.what == what]
    assert len(told) == 1
    assert part in told[0].text
    assert seen(runtime, UnitDied) == []
    runtime.close()
    listener.join()
    values = listener.values
    assert all(one % 5 for one in values) or deed in ("chatter", "no utf-8", "twice", "late", "early", "time")
    assert sorted(set(values)) == values, "each answer is that of its own step"


@pytest.mark.parametrize(
    ("deed", "cause"), [("exit", "the program: ended with exit status 3"), ("crash", "the program: killed by SIGSEGV")]
)
def test_a_program_that_ends_in_a_step_has_died(
    run_units: StartRuntime, form: ProgramFormat, deed: str, cause: str
) -> None:
    runtime = run_units(source(), program(form, deed))
    with suppress(ApplyError):  # on a slow machine it dies before the update is over
        runtime.apply(start(COUNT, WORK))
    eventually(lambda: bool(seen(runtime, UnitDied)))
    assert seen(runtime, UnitDied)[0].cause.startswith(cause)


def test_a_program_that_is_killed_while_nothing_is_asked_of_it_has_died(
    run_units: StartRuntime, form: ProgramFormat
) -> None:
    runtime = run_units(program(form))
    runtime.apply(start(unit("work.1")))
    process_of(runtime.pid("work.1")).kill()
    eventually(lambda: bool(seen(runtime, UnitDied)))
    assert seen(runtime, UnitDied)[0].cause == "the program: killed by SIGKILL"


def test_a_program_dies_with_its_unit(run_units: StartRuntime, form: ProgramFormat) -> None:
    runtime = run_units(program(form))
    runtime.apply(start(unit("work.1")))
    hosted = process_of(runtime.pid("work.1"))
    signal_unit(runtime, "work.1")
    eventually(lambda: bool(seen(runtime, UnitDied)))
    eventually(lambda: not lives(hosted))


def test_a_program_that_hangs_is_killed(run_units: StartRuntime, form: ProgramFormat) -> None:
    runtime = run_units(source(), program(form, "hang", run=RunOptions(hang_us=2_000_000)))
    runtime.apply(start(unit("count.1"), unit("work.1", x="count.1/n")))
    eventually(lambda: bool(seen(runtime, UnitHung)) and bool(seen(runtime, UnitDied)))


@pytest.mark.parametrize(
    ("made", "cause"),
    [
        (Transformation("work", source="program:./absent"), "there is no file ./absent"),
        (Transformation("work", source="program:no-such-command-1"), "there is no program no-such-command-1"),
        (Transformation("work", source="program:./world.py"), "chmod \\+x world.py"),
        (Transformation("work", source="program:'"), "quote arguments as in a shell"),
        (Transformation("work", source="program:"), "names no program"),
    ],
)
def test_a_program_that_can_not_be_started_undoes_the_update_and_says_why(
    run_units: StartRuntime, form: ProgramFormat, made: Transformation, cause: str
) -> None:
    runtime = run_units(replace(made, run=RunOptions(format=form)))
    with pytest.raises(ApplyError, match=cause) as told:
        runtime.apply(start(unit("work.1")))
    assert "Traceback" not in str(told.value)


def test_an_update_from_program_to_program_loses_repeats_and_reorders_nothing(
    run_units: StartRuntime, form: ProgramFormat
) -> None:
    runtime = run_units(source(rate_hz=500), program(form))
    runtime.apply(start(COUNT, WORK))
    listener = Listener("/result")
    for number in range(2, 8):
        got = len(listener.received)
        eventually(lambda got=got: len(listener.received) > got + 20)  # type: ignore[misc]
        successor = unit(f"work.{number}", topic="/result", x="count.1/n")
        runtime.apply(ChangeSet(started=(successor,), stopped=(f"work.{number - 1}",)))
    got = len(listener.received)
    eventually(lambda: len(listener.received) > got + 20)
    runtime.close()
    listener.join()
    assert rises(listener.values)
    assert seen(runtime, UnitDied) == seen(runtime, UnitCutShort) == []


def test_a_program_that_ends_before_it_is_ready_undoes_the_update_and_says_why(
    run_units: StartRuntime, form: ProgramFormat
) -> None:
    runtime = run_units(program(form, "never ready"))
    with pytest.raises(ApplyError, match="ended with exit status 4"):
        runtime.apply(start(unit("work.1")))


def test_a_program_gets_more_steps_before_it_has_answered_the_last(
    run_units: StartRuntime, form: ProgramFormat
) -> None:
    runtime = run_units(source(), program(form, "pairs"))
    runtime.apply(start(COUNT, WORK))
    listener = Listener("/result")
    eventually(lambda: len(listener.received) > 20)
    assert rises(listener.values)
    runtime.close()
    listener.join()


def test_with_a_queue_of_one_a_step_is_sent_after_the_last_answer(run_units: StartRuntime, form: ProgramFormat) -> None:
    run = RunOptions(queue=1, hang_us=2_000_000)
    runtime = run_units(source(), program(form, "pairs", run=run))
    runtime.apply(start(unit("count.1"), unit("work.1", x="count.1/n")))
    eventually(lambda: bool(seen(runtime, UnitHung)))


def test_a_program_whose_results_have_to_wait_is_not_taken_for_hung(
    run_units: StartRuntime, form: ProgramFormat
) -> None:
    slow = worker("slow", "Slow", run=RunOptions(queue=1, blocks=True), seconds=2.5)
    runtime = run_units(source(), program(form, run=RunOptions(hang_us=2_000_000)), slow)
    units = unit("count.1"), unit("work.1", x="count.1/n"), unit("slow.1", topic="/result", x="work.1/y")
    runtime.apply(start(*units))
    listener = Listener("/result")
    eventually(lambda: len(listener.received) > 3)
    assert seen(runtime, UnitHung) == seen(runtime, UnitDied) == []
    runtime.close()
    listener.join()


def test_a_source_with_a_rate_is_asked_at_its_rate(run_units: StartRuntime, form: ProgramFormat) -> None:
    runtime = run_units(provider(form, "same", rate_hz=100))
    runtime.apply(start(unit("give.1", topic="/result", port="n")))
    listener = Listener("/result")
    eventually(lambda: len(listener.received) > 20)
    assert rises(listener.values)
    runtime.close()
    listener.join()


def test_a_source_of_its_own_pace_gives_its_own_times_and_gets_sigterm_at_its_stop(
    run_units: StartRuntime, form: ProgramFormat, tmp_path: Path
) -> None:
    runtime = run_units(provider(form, "own pace", notes=str(tmp_path)))
    runtime.apply(start(unit("give.1", topic="/result", port="n")))
    listener = Listener("/result")
    eventually(lambda: len(listener.received) > 20)
    assert rises(listener.values)
    runtime.stop()
    assert (tmp_path / "terminated").exists()
    assert seen(runtime, UnitDied) == seen(runtime, UnitCutShort) == []
    runtime.close()
    listener.join()


def test_a_source_that_ends_well_has_no_more_to_give_and_its_unit_stays(
    run_units: StartRuntime, form: ProgramFormat
) -> None:
    runtime = run_units(provider(form, "ends"))
    runtime.apply(start(unit("give.1")))
    eventually(lambda: bool(seen(runtime, SourceExhausted)))
    assert set(runtime.environment.unit) == {"give.1"}
    eventually(lambda: any(o.outputs["n"].elements == 3 for o in runtime.observe()))


def test_a_source_that_ends_badly_has_died(run_units: StartRuntime, form: ProgramFormat) -> None:
    runtime = run_units(provider(form, "fails"))
    with suppress(ApplyError):
        runtime.apply(start(unit("give.1")))
    eventually(lambda: bool(seen(runtime, UnitDied)))
    assert seen(runtime, UnitDied)[0].cause.startswith("the program: ended with exit status 1")


def test_at_its_stop_a_program_gets_the_end_of_its_input_and_may_end(
    run_units: StartRuntime, form: ProgramFormat, tmp_path: Path
) -> None:
    runtime = run_units(source(), program(form, notes=str(tmp_path)))
    runtime.apply(start(unit("count.1"), unit("work.1", x="count.1/n")))
    runtime.stop()
    assert (tmp_path / "ended").exists()
    assert seen(runtime, UnitDied) == seen(runtime, UnitCutShort) == []


def test_a_program_that_does_not_end_at_its_stop_gets_sigterm_after_half_of_its_time(
    run_units: StartRuntime, form: ProgramFormat, tmp_path: Path
) -> None:
    runtime = run_units(program(form, "stubborn", notes=str(tmp_path)))
    runtime.apply(start(unit("work.1")))
    runtime.stop()
    assert (tmp_path / "ended").exists()
    assert seen(runtime, UnitCutShort) == []


def test_the_cpu_time_and_memory_of_a_program_are_its_units(run_units: StartRuntime, form: ProgramFormat) -> None:
    runtime = run_units(source(rate_hz=4), program(form, "burn"))
    runtime.apply(start(unit("count.1"), unit("work.1", x="count.1/n")))
    hosted = process_of(runtime.pid("work.1"))
    eventually(lambda: hosted.cpu_times().user > 0.25)
    (work,) = [each for each in runtime.observe() if each.unit == "work.1"]
    assert work.cpu_us > 250_000, "that is far more than its own process takes"
    assert work.memory_bytes > hosted.memory_info().rss
