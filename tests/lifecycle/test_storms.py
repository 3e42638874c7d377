"""Short storms; long ones are `python experiments/lifecycle/storm.py`, with `--real` on processes."""

from __future__ import annotations

import sys

import pytest

from experiments.lifecycle import storm

HOW = {
    "in thought": ["--perturbations", "200"],
    "on hosts": ["--perturbations", "60", "--hosts"],
    "on processes": ["--perturbations", "30", "--real"],
}


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("how", HOW)
def test_after_a_storm_what_runs_is_exactly_as_good_as_a_fresh_optimal_plan(
    how: str, seed: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["storm.py", *HOW[how], "--seeds", "1", "--seed", str(seed)])
    found = storm.main()
    said = capsys.readouterr().out
    assert found == 0, said
    assert "'applied'" in said
