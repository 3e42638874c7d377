"""What a notebook shows: short texts, tables in which markup stays text, a picture; and a notebook that runs.

`python tests/test_notebooks.py` runs the notebooks and keeps their new outputs.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

import cfgplan
from cfgplan.domain import ChangeSet, Environment, Target
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


def test_figures_of_tables_have_their_units(answers: dict[str, Any]) -> None:
    assert "<td>0.35 s</td><td>5 % of a core</td>" in answers["World"]._repr_html_()
    (row,) = re.findall(r"<tr><td>0 s</td>.*?</tr>", answers["Sensitivity"]._repr_html_())[:1]
    assert re.match(r"<tr><td>0 s</td><td>([\d.]+ s)?</td>", row)
    assert "<td>18.6 s</td><td>nothing</td>" in answers["Alternatives"]._repr_html_()
    office = cfgplan.match(cfgplan.load(ROOT / "models" / "building" / "office.yaml"))
    upkeep = cfgplan.sensitivity(office, upkeep_of="air_flow_meter")._repr_html_()
    assert "<td>0 % of a core</td>" in upkeep


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


def test_a_gap_a_change_and_a_unit_are_tables() -> None:
    problem = cfgplan.match(cfgplan.load(NAO / "2-segmenter-lost.yaml"))
    environment = problem.environment
    changes = cfgplan.plan(problem).change_set
    assert changes is not None
    (gap,) = cfgplan.violations(environment, problem.similarity)
    after = environment.update(changes)
    shown: Any = [environment, gap, changes, after.unit["ball_detector(piff).1"], after]
    tables = [each._repr_html_() for each in shown]
    assert "hull: a gap" in tables[0]
    assert "ball_detector(piff).1" in tables[1]
    assert "hull" in tables[1]
    assert "<td>start</td><td>segmenter(piff).1</td>" in tables[2]
    assert "1 to start, 1 to rewire, 0 to stop" in tables[2]
    assert "<td>hull</td><td>segmenter(piff).1/hull</td>" in tables[3]
    assert "a gap" not in tables[4]


def test_a_change_of_the_library_stands_in_its_table() -> None:
    changes: Any = ChangeSet(added_targets=(Target("new", "A", "/new"),), removed_hosts=("r1",), stopped=("camera.1",))
    table = changes._repr_html_()
    for row in ("<td>add target</td><td>new</td>", "<td>remove host</td><td>r1</td>", "<td>stop</td><td>camera.1</td>"):
        assert row in table


def run_again(path: Path) -> tuple[Any, Any]:
    """A notebook as it is kept, and the same notebook after a run in its own folder, as in Jupyter."""
    nbclient = pytest.importorskip("nbclient", reason="pip install 'cfgplan[test]'")
    nbformat = pytest.importorskip("nbformat")
    kept, now = (nbformat.read(path, as_version=4) for _ in range(2))
    where = {"metadata": {"path": path.parent}}
    nbclient.NotebookClient(now, timeout=300, kernel_name="python3", resources=where).execute()
    for cell in now.cells:
        cell.metadata.pop("execution", None)
    return kept, now


def shown_texts(notebook: Any) -> list[list[str]]:
    """The tables, or else the texts, that each cell shows; pictures depend on the version of Graphviz."""
    return [
        [data.get("text/html") or data["text/plain"] for out in cell.get("outputs", []) for data in [out["data"]]]
        for cell in notebook.cells
    ]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_shows_what_it_is_kept_with(path: Path) -> None:
    kept, now = run_again(path)
    assert shown_texts(now) == shown_texts(kept), "run `python tests/test_notebooks.py`"
    for notebook in (kept, now):
        kinds = [kind for cell in notebook.cells for out in cell.get("outputs", []) for kind in out.get("data", {})]
        assert {"text/html", "image/svg+xml"} <= set(kinds)


if __name__ == "__main__":
    import nbformat

    for each in NOTEBOOKS:
        nbformat.write(run_again(each)[1], each)
