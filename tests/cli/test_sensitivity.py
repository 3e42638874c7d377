"""`cfgplan sensitivity` as a user and as a script see it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from command import MODELS, Run

OFFICE = MODELS / "building" / "office.yaml"
TWO_WAYS = """
transformations:
  - {label: cheap, labor: 1, upkeep: 0.5, outputs: {o: Wanted}}
  - {label: dear, labor: 9, upkeep: 0.2, outputs: {o: Wanted}}
targets: [{label: t, topic: /t, tag: Wanted}]
"""


def test_it_says_for_which_horizons_the_plan_is_optimal_and_what_comes_next(
    run: Run, write: Callable[[str], Path]
) -> None:
    result = run("sensitivity", write(TWO_WAYS))
    assert result.code == 0
    assert "The plan for a horizon of 10 s is optimal from 0 s to about 26.67 s." in result.out
    assert "from about 26.67 s on: 9 s once and 20 % of a core\n    + dear\n    - cheap" in result.out


def test_its_json_has_the_exact_break_points(run: Run, write: Callable[[str], Path]) -> None:
    document = run("sensitivity", write(TWO_WAYS), "--json").document
    assert (document["breaks"], document["here"], document["exact"]) == (["80/3"], 0, True)
    assert document["spans"][1]["runs"] == ["dear"]


def test_the_upkeep_of_a_transformation_can_vary(run: Run, write: Callable[[str], Path]) -> None:
    result = run("sensitivity", write(TWO_WAYS), "--upkeep-of", "cheap")
    assert (
        "The plan for cheap with an upkeep of 50 % of a core is optimal from 0 % of a core to 100 % of a core."
        in result.out
    )
    assert "from 100 % of a core on: 11 s, without cheap" in result.out
    assert run("sensitivity", write(TWO_WAYS), "--upkeep-of", "cheep").code == 30


def test_a_fleet_has_break_points_too_where_its_costs_are_straight_lines(
    run: Run, write: Callable[[str], Path]
) -> None:
    fleet = f"hosts: [{{name: h, cpu: 1}}, {{name: g}}]\n{TWO_WAYS}"
    assert run("sensitivity", write(fleet), "--json").document["breaks"] == ["80/3"]
    limited = run("sensitivity", write(fleet), "--upkeep-of", "cheap")
    assert (limited.code, "host h limits CPU time" in limited.err) == (30, True)
    rounded = run("sensitivity", MODELS / "fleet" / "1-start.yaml")
    assert (rounded.code, "costs 1.5 microseconds each second" in rounded.err) == (30, True)


@pytest.mark.parametrize("options", [(), ("--upkeep-of", "air_flow_meter")])
def test_a_picture_is_drawn_with_the_break_points(run: Run, tmp_path: Path, options: tuple[str, ...]) -> None:
    out = tmp_path / "cost.svg"
    assert run("sensitivity", OFFICE, *options, "--out", out).code == 0
    first = out.read_bytes()
    assert b"<svg" in first
    run("sensitivity", OFFICE, *options, "--out", out)
    assert out.read_bytes() == first


@pytest.mark.parametrize(("options", "told"), [((), "3600 s →"), (("--horizon", "60"), "60 s")])
def test_a_picture_tells_where_you_are(run: Run, tmp_path: Path, options: tuple[str, ...], told: str) -> None:
    out = tmp_path / "cost.svg"
    assert run("sensitivity", OFFICE, *options, "--out", out).code == 0
    assert f"<!-- you are here: {told} -->" in out.read_text()


def test_other_endings_are_bad_input(run: Run, tmp_path: Path) -> None:
    assert run("sensitivity", OFFICE, "--out", tmp_path / "cost.txt").code == 30


def test_without_a_plan_there_is_nothing_to_vary(run: Run) -> None:
    result = run("sensitivity", MODELS / "nao" / "0-target-only.yaml")
    assert result.code == 10
    assert "There is no plan for any value of the horizon." in result.out


@pytest.mark.parametrize("name", ["a$x_$", "_b", "$\\frac$"])
def test_names_are_drawn_as_they_are_written(run: Run, write: Callable[[str], Path], tmp_path: Path, name: str) -> None:
    out = tmp_path / "breaks.svg"
    result = run("sensitivity", write(TWO_WAYS.replace("cheap", f"'{name}'")), "--upkeep-of", name, "--out", out)
    assert result.code == 0, result.err
    assert f"<!-- upkeep of {name} (% of a core) -->" in out.read_text()


def test_a_plot_without_matplotlib_is_refused_before_anything_is_planned(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cfgplan.extras.find_spec", lambda _: None)
    result = run("sensitivity", OFFICE, "--out", tmp_path / "cost.svg")
    assert (result.code, result.out) == (30, "")
    assert "pip install 'cfgplan[plots]'" in result.err
