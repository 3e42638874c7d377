"""`cfgplan init` writes a world that plans and runs."""

from __future__ import annotations

from pathlib import Path

from command import Run


def test_what_it_writes_is_planned_and_has_another_way(run: Run, tmp_path: Path) -> None:
    folder = tmp_path / "kitchen"
    assert f"cfgplan solve {folder / 'env.yaml'}" in run("init", folder).out
    assert run("solve", folder / "env.yaml", "--json").document["status"] == "optimal"
    other = run("solve", folder / "env.yaml", "--without", "thermometer").out
    assert "picture <- infrared_camera.1/picture" in other


def test_a_folder_named_like_a_template_gets_that_template(run: Run, tmp_path: Path) -> None:
    run("init", tmp_path / "robot")
    run("init", tmp_path / "other", "--template", "robot")
    texts = [(tmp_path / name / "env.yaml").read_text() for name in ("robot", "other")]
    assert texts[0] == texts[1]
    assert "This is the template" not in run("init", tmp_path / "kitchen").out
    told = run("init", tmp_path / "robott").out.splitlines()[-1]
    assert told == "This is the template `kitchen`; `cfgplan init FOLDER --template robot` writes another one."


def test_what_it_writes_runs(run: Run, tmp_path: Path) -> None:
    run("init", tmp_path)
    ended = run("run", tmp_path / "env.yaml", "--for", "2s")
    assert "started fire_alarm.1, thermometer.1" in ended.out + ended.err
    assert ended.code == 0


def test_nothing_is_overwritten(run: Run, tmp_path: Path) -> None:
    (tmp_path / "units.py").write_text("mine")
    assert "units.py: this file is there already" in run("init", tmp_path).err
    assert [path.name for path in tmp_path.iterdir()] == ["units.py"]
    assert "can't be made" in run("init", tmp_path / "units.py" / "folder").err


def test_versions_of_solver_and_reasoner_are_told(run: Run) -> None:
    out = run("--version").out
    assert "OR-Tools 9." in out
    assert "owlready2" in out
