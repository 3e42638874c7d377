"""What a notebook shows: short texts, tables in which markup stays text, a picture; and a notebook that runs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import cfgplan
from cfgplan.domain import Environment, Target
from cfgplan.summary import MOST_ROWS

ROOT = Path(__file__).parent.parent
NAO = ROOT / "models" / "nao"
NOTEBOOKS = sorted((ROOT / "experiments").rglob("*.ipynb"))


@pytest.fixture(scope="module")
def answers() -> dict[str, Any]:
    world = cfgplan.load(NAO / "4-fusion-available.yaml")
    problem, plan = cfgplan.solve(world)
    fleet = cfgplan.match(cfgplan.load(ROOT / "models" / "fleet" / "3-best-map.yaml"))
    nothing = cfgplan.load(NAO / "0-target-only.yaml")
    return {
        "World": world,
        "Environment": world.environment,
        "Problem": problem,
        "Similarity": problem.similarity,
        "Plan": cfgplan.solve(cfgplan.load(NAO / "2-segmenter-lost.yaml")).plan,
        "Why": cfgplan.why(problem, plan, "transformation", "fuse_ball_pos"),
        "WhyNot": cfgplan.why_not(nothing, cfgplan.match(nothing)),
        "Alternatives": cfgplan.alternatives(problem, 2),
        "BestEffort": cfgplan.best_effort(cfgplan.match(nothing)),
        "Sensitivity": cfgplan.sensitivity(problem),
        "Front": cfgplan.front(fleet, "obstacles", "error"),
    }


def test_each_has_a_short_repr_and_a_table(answers: dict[str, Any]) -> None:
    for name, answer in answers.items():
        assert repr(answer).startswith(f"<{name}: ")
        assert len(repr(answer)) < 300
        table = answer._repr_html_()
        assert table.startswith("<table>")
        assert table.count("<tr>") > 1, name


def test_the_lines_say_what_matters(answers: dict[str, Any]) -> None:
    assert repr(answers["Plan"]).startswith("<Plan: optimal by cpsat, 18.95 s of CPU, at least 18.95 s; 1 to start")
    assert repr(answers["Environment"]) == "<Environment: 13 transformations, 6 units, 1 target>"
    assert "horizon 60 s" in repr(answers["Problem"])
    assert "fuse_ball_pos" in repr(answers["Why"])
    assert repr(answers["Sensitivity"]).endswith("over the horizon>")
    assert "bottom_cam(piff)" in answers["World"]._repr_html_()


def test_markup_in_a_name_stays_text() -> None:
    environment = Environment(targets=(Target("<b>bold</b>", "A & B", "/t"),))
    table = environment._repr_html_()  # type: ignore[attr-defined]
    assert "&lt;b&gt;bold&lt;/b&gt;" in table
    assert "A &amp; B" in table
    assert "<b>" not in table


def test_a_long_table_says_what_it_leaves_out() -> None:
    environment = Environment(targets=tuple(Target(f"t{n}", "A", f"/{n}") for n in range(MOST_ROWS + 7)))
    table = environment._repr_html_()  # type: ignore[attr-defined]
    assert table.count("<tr>") == 1 + MOST_ROWS + 1
    assert "and 7 more" in table


def test_an_answer_is_a_picture(monkeypatch: pytest.MonkeyPatch) -> None:
    solved = cfgplan.solve(cfgplan.load(NAO / "2-segmenter-lost.yaml"))
    picture = solved._repr_svg_()
    assert picture is not None
    assert "segmenter(piff).1" in picture
    assert "<svg" in picture
    monkeypatch.setattr("cfgplan.api.is_there", lambda _: False)
    assert solved._repr_svg_() is None


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs(path: Path) -> None:
    nbclient = pytest.importorskip("nbclient", reason="pip install 'cfgplan[test]'")
    nbformat = pytest.importorskip("nbformat")
    notebook = nbformat.read(path, as_version=4)
    assert [cell for cell in notebook.cells if cell.get("outputs")] == [], "a notebook is kept without its output"
    nbclient.NotebookClient(
        notebook, timeout=300, kernel_name="python3", resources={"metadata": {"path": ROOT}}
    ).execute()
    shown = [kind for cell in notebook.cells for out in cell.get("outputs", []) for kind in out.get("data", {})]
    assert {"text/html", "image/svg+xml"} <= set(shown)
