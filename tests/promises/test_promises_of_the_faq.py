"""The promises of `manual/faq.md` that no other test of the manual checks.

`tests/operating/test_run_in_operation.py` checks that `ctl` finds a run by its name, and that `ctl logs`, `ctl restart`
and `--reload` do what they say; `tests/runtime/test_faults.py` checks that units end with a run that is killed.
"""

from __future__ import annotations

import argparse
import tomllib
from importlib import import_module
from pathlib import Path

import pytest
from promised import solved

from cfgplan.cli import main

ROOT = Path(__file__).parents[2]
TEXT = """\
transformations:
  - {label: camera, outputs: {image: Image}}
  - {label: detector, inputs: {image: Image}, outputs: {ball: Ball}}
targets:
  - {label: ball, topic: /ball, tag: Ball}
"""


def test_without_an_ontology_only_equal_names_match(tmp_path: Path) -> None:
    assert solved(tmp_path, TEXT).runs == ["camera", "detector"]
    assert solved(tmp_path, TEXT.replace("inputs: {image: Image}", "inputs: {image: image}")).plan.change_set is None


def test_costs_that_are_left_out_are_a_second_of_labor_and_no_upkeep(tmp_path: Path) -> None:
    assert solved(tmp_path, TEXT).cost_s == 2
    assert solved(tmp_path, f"horizon: 9000\n{TEXT}").cost_s == 2


def test_spares_are_kept_ready_for_the_failure_of_a_unit(tmp_path: Path) -> None:
    after = solved(tmp_path, f"{TEXT}survive: units\n").after
    assert sorted(unit.id for unit in after.units) == ["camera.1", "camera.2", "detector.1", "detector.2"]


def test_sensitivity_tells_how_far_horizon_and_upkeep_may_change(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    solved(tmp_path, TEXT)
    for arguments, parameter in (((), "the horizon"), (("--upkeep-of", "camera"), "the upkeep of camera")):
        assert main(["sensitivity", str(tmp_path / "env.yaml"), *arguments]) == 0
        assert f"is optimal for every value of {parameter}" in capsys.readouterr().out


@pytest.mark.parametrize("command", ["ctl", "listen", "page"])
def test_commands_for_a_run_take_its_name(command: str) -> None:
    parser = argparse.ArgumentParser()
    import_module(f"cfgplan.cli.{command}").add_to(parser)
    assert "--name" in parser.format_help()


def test_the_licence_is_the_one_that_is_named() -> None:
    assert tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["license"] == "Apache-2.0"
    assert "Apache License" in (ROOT / "LICENSE").read_text()
    assert "The licence is Apache 2.0." in (ROOT / "cfgplan" / "manual" / "faq.md").read_text()
