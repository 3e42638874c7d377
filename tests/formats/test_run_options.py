"""`run:` of a transformation: how its units run."""

from __future__ import annotations

from pathlib import Path

import pytest
from loading import faults_of, load_text

from cfgplan.domain import RunOptions
from cfgplan.errors import InputError, InvalidValueError

TRANSFORMATION = """format: cfgplan/1
transformations:
  - label: joiner
    run: {run}
    inputs: {{left: A, right: A}}
    outputs: {{both: B}}
"""


def options(folder: Path, run: str) -> RunOptions:
    return load_text(folder, TRANSFORMATION.format(run=run)).environment.transformation["joiner"].run


def test_what_is_not_said_is_usual(tmp_path: Path) -> None:
    assert options(tmp_path, "{}") == RunOptions()


def test_everything_can_be_said(tmp_path: Path) -> None:
    run = "{start: aligned, tolerance: 0.01, queue: 5, when_full: block, hang: 2.5, memory: 100, state: true}"
    assert options(tmp_path, run) == RunOptions("aligned", 10_000, None, 5, True, 2_500_000, 100, True)


def test_only_a_source_has_a_rate(tmp_path: Path) -> None:
    text = TRANSFORMATION.format(run="{rate: 30}")
    (fault,) = faults_of(tmp_path, text)
    assert "`rate` is only for sources" in fault.message
    assert fault.mend is not None
    assert "remove it" in fault.mend
    assert text.splitlines()[(fault.line or 0) - 1][(fault.column or 0) - 1 :].startswith("30")
    source = "transformations: [{label: s, run: {rate: 30}, outputs: {o: T}}]\n"
    assert load_text(tmp_path, "format: cfgplan/1\n" + source).environment.library[0].run.rate_hz == 30


@pytest.mark.parametrize(("hang", "hang_us"), [("0", 0), ("2", 2_000_000), ("2.5", 2_500_000)])
def test_a_unit_may_be_silent_for_two_seconds_or_more_or_for_ever(tmp_path: Path, hang: str, hang_us: int) -> None:
    assert options(tmp_path, f"{{hang: {hang}}}").hang_us == hang_us


@pytest.mark.parametrize("hang_us", [-1, 1, 1_999_999])
def test_in_python_a_unit_may_not_be_silent_for_a_shorter_time_either(hang_us: int) -> None:
    with pytest.raises(
        InvalidValueError,
        match=r"allow 2 s or more, or 0 for never|hang_us must be a whole number of 0 or more",
    ):
        RunOptions(hang_us=hang_us)


def test_a_step_can_start_on_a_named_input(tmp_path: Path) -> None:
    assert options(tmp_path, "{start: left}").start == "left"


@pytest.mark.parametrize(
    ("run", "part"),
    [
        ("{start: lfet}", "did you mean `left`?"),
        ("{rate: 0}", "a rate of 0 is out of range"),
        ("{rate: fast}", "this must be a number"),
        ("{tolerance: -1}", "negative"),
        ("{queue: 0}", "at least 1"),
        ("{when_full: explode}", "when_full"),
        ("{memory: 0.5}", "whole number"),
        ("{hang: 0.5}", "0.5 s is too short to miss one (allow 2 s or more, or 0 for never"),
        ("{hang: 1.999}", "allow 2 s or more, or 0 for never"),
        ("{hang: soon}", "this must be a number"),
        ("{color: red}", "unknown key `color`"),
        ("fast", "mapping"),
    ],
)
def test_nonsense_is_refused(tmp_path: Path, run: str, part: str) -> None:
    with pytest.raises(InputError) as refused:
        options(tmp_path, run)
    (fault,) = refused.value.faults
    assert part in str(fault)
    assert fault.line == 4


def test_planning_does_not_look_at_it(tmp_path: Path) -> None:
    plain, other = (load_text(tmp_path, TRANSFORMATION.format(run=run)) for run in ("{}", "{start: any}"))
    assert plain.digest == other.digest
