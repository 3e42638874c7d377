"""`cfgplan init` writes a world that plans and runs."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest
from command import Run

from cfgplan.cli.init import TEMPLATES
from cfgplan.cli.main import VERBS, parser_of, parser_with


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


def test_the_examples_of_all_commands_can_be_pasted_as_they_are_printed() -> None:
    (of_verb,) = (action.choices for action in parser_with(VERBS)._actions if isinstance(action.choices, dict))
    epilogs = [each.epilog or "" for each in of_verb.values()]
    blocks = [block for epilog in epilogs for block in re.findall(r"(?m)^examples?:\n((?:  .*\n?)+)", epilog)]
    lines = [shlex.split(line, comments=True) for block in blocks for line in block.splitlines()]
    examples = [words for words in lines if words and words[0] != "scp"]
    assert len(examples) > 50
    for words in examples:
        arguments = words[words.index("cfgplan") + 1 :][: words.index(">") - 1 if ">" in words else None]
        parser_of(arguments).parse_args(arguments)


@pytest.mark.parametrize("template", TEMPLATES)
def test_the_next_steps_can_be_pasted_as_they_are_printed(template: str, run: Run, tmp_path: Path) -> None:
    told = run("init", tmp_path / "my new", "--template", template).out
    steps = [shlex.split(line, comments=True) for line in told.splitlines() if line.startswith("  cfgplan ")]
    assert steps
    for _, *arguments in steps:
        options = parser_of(arguments).parse_args(arguments)
        assert Path(getattr(options, "env", tmp_path)).exists()


@pytest.mark.parametrize("arguments", [["my env.yaml"], ["suggest", "my env.yaml"], ["ontology", "new", "my own.yaml"]])
def test_a_command_in_a_mend_names_a_file_with_a_space_in_quotes(
    arguments: list[str], run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("my env.yaml").write_text("format: cfgplan/1\ntransformations: [{label: a, outputs: {x: X}}]\n")
    Path("x.ttl").write_text("<x#X> a <http://www.w3.org/2002/07/owl#Class> .\n")
    Path("my own.yaml").write_text("format: cfgplan/1\nontology: x.ttl\n")
    told = run(*arguments)
    assert told.code == 30
    _, *advised = shlex.split(told.err.splitlines()[-1].split("`")[1])
    assert Path(parser_of(advised).parse_args(advised).env).exists()


def test_nothing_is_overwritten(run: Run, tmp_path: Path) -> None:
    (tmp_path / "units.py").write_text("mine")
    assert "units.py: this file is there already" in run("init", tmp_path).err
    assert [path.name for path in tmp_path.iterdir()] == ["units.py"]
    assert "can't be made" in run("init", tmp_path / "units.py" / "folder").err


def test_versions_of_solver_and_reasoner_are_told(run: Run) -> None:
    out = run("--version").out
    assert "OR-Tools 9." in out
    assert "owlready2" in out
