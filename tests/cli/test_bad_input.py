"""What a user can write that is wrong: the screen names what, where and how to mend it, and no traceback reaches it."""

from __future__ import annotations

import argparse
import os
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from command import Run

from cfgplan import file_content
from cfgplan.cli import options
from cfgplan.cli.main import VERBS, parser_with

LIBRARY = "transformations: [{label: a, outputs: {o: X}}]\ntargets: [{label: t, topic: /t, tag: X}]\n"
PREFIXES = "@prefix : <x:> . @prefix owl: <http://www.w3.org/2002/07/owl#> ."


@pytest.fixture
def env(write: Callable[[str], Path], monkeypatch: pytest.MonkeyPatch) -> Path:
    """A small environment, in the folder where commands are called."""
    path = write(LIBRARY)
    monkeypatch.chdir(path.parent)
    return path


@pytest.mark.parametrize(
    ("command", "message", "mend"),
    [
        ("solve -", "error: -: there is no such file", "name /dev/stdin for standard input"),
        ("solve ENV --without b", "--without: there is no transformation, unit or target `b`", "write a or t"),
        ("solve ENV --front", "error: env.yaml: no quality attribute is declared", "declare one under `qualities:`"),
        ("solve ENV --max-cost -1", "-1 is negative: write a number of 0 or more", "cfgplan solve --help"),
        ("solve ENV --max-cost 1e9999999", "'1e9999999' is too large: the limit is 9007199254", "cfgplan solve --help"),
        ("solve ENV --alternatives 1e9999999", "'1e9999999' is too large", "cfgplan solve --help"),
        ("solve ENV --horizon 999999999h", "is too long: write at most 1000000000 seconds", "cfgplan solve --help"),
        ("solve ENV --set t.priority=1e9999999", "'1e9999999' is not a whole number", "write one from -1000000000 to"),
        ("ctl fact night", "'night' is not NAME=VALUE: write one, such as night=true", "cfgplan ctl fact --help"),
        ("solve ENV --planner os:getcwd", "error: the planner os:getcwd can't be called", "write it as `def plan("),
        ("explain ENV --stream o", "there is no output `o`", "write a/o"),
        (
            "graph ENV --out picture",
            "the file name has no ending that gives the picture's format",
            "end it in one of .svg",
        ),
        ("export schema ENV", "the schema is the same for all files", "leave the file out"),
        ("export yaml ENV --out new.json", "new.json: this name does not end as YAML does", "end it in .yaml"),
        ("export xml ENV --out new.yaml", "new.yaml: this name does not end as XML does", "end it in .xml"),
        ("export launch ENV", "a.1: a has no `source`", "write node:PACKAGE/EXECUTABLE"),
        ("import xml ENV --works", "--works: `import xml` does not take this option", "leave it out"),
        (
            "import ros1 live --objective length --out new.yaml",
            "--objective: `import ros1` does not take this option",
            "leave it out",
        ),
        ("import ros1 robot.launch --out new.ttl", "new.ttl: this name does not end as YAML does", "end it in .yaml"),
        ("import ros1 sim:=true --out new.yaml", "there are arguments, but no launch file", "name `live`"),
        ("init env.yaml", "env.yaml: this folder can't be made", "name a folder that exists or can be made"),
        (
            "solve ENV --alternatives 2 --progress -v",
            "--progress and -v would have no effect with --alternatives",
            "leave out one or the other",
        ),
        (
            "solve ENV --front q --detailed-exitcode",
            "--detailed-exitcode would have no effect with --front",
            "leave out",
        ),
        ("solve ENV --best-effort --progress", "--progress would have no effect with --best-effort", "leave out"),
        ("run ENV --allow-code --dry-run", "--allow-code is for the page of the run", "add --page"),
        ("replay a.mcap --out b.yaml --for 3s", "--for would have no effect with --out", "leave out"),
        ("replay a.mcap ENV --extract b --loop", "ENV and --loop would have no effect with --extract", "leave out"),
        ("agent --name a/b", "--name: 'a/b' can't be the name of a host", "without /"),
    ],
)
def test_a_command_that_is_wrong_says_what_and_how_to_mend_it(
    run: Run, env: Path, command: str, message: str, mend: str
) -> None:
    code, _, err = run(*(env.name if word == "ENV" else word for word in command.split()))
    assert code == 30
    assert message in err
    assert mend in err


@pytest.mark.usefixtures("env")
def test_the_name_of_no_file_and_of_no_host_is_bad_input(run: Run) -> None:
    told = "error: argument ENV: it is an empty word\n    $ cfgplan solve ''\n                    ^^\n"
    mend = "write a value (a shell's variable that is not set gives an empty word); cfgplan solve --help tells more"
    assert run("solve", "") == (30, "", f"{told}       {mend}\n")
    assert run("agent", "--name", "").code == 30


def test_a_name_that_stands_for_something_else_is_told_what_may_stand_there(run: Run, env: Path) -> None:
    Path("house.ttl").write_text(f"{PREFIXES} :X a owl:Class . :i a :X .")
    env.write_text("format: cfgplan/1\nontology: house.ttl\n" + LIBRARY.replace("o: X", "o: '{X}'"))
    err = run("check", env).err
    assert "'X' is a class, but an individual is expected here\n" in err
    assert "^\n       write one, such as i" in err


def test_an_ontology_that_contradicts_itself_is_named_as_from_here(run: Run, env: Path) -> None:
    Path("house.ttl").write_text(f"{PREFIXES} :X a owl:Class ; owl:disjointWith :Y . :i a :X , :Y .")
    env.write_text("format: cfgplan/1\nontology: house.ttl\n" + LIBRARY)
    assert run("check", env.name).err.startswith("error: house.ttl: the ontology contradicts itself")


def test_sensitivity_says_that_it_leaves_the_largest_cost_out(run: Run, env: Path) -> None:
    assert "The largest cost is ignored" in run("sensitivity", env, "--max-cost", "0.5").err
    assert "largest cost" not in run("sensitivity", env).err


def test_a_comparison_may_wait_as_long_as_anybody_likes(run: Run, env: Path) -> None:
    assert run("compare", env, "--planner", "exhaustive", "--timeout", 9_007_199_254).code == 0


def test_a_new_environment_is_named_with_its_folder(run: Run, env: Path) -> None:
    env.unlink()
    assert run("init").out.startswith("Wrote env.yaml, kitchen.ttl, units.py. Next:")
    assert run("init", "other").out.startswith("Wrote other/env.yaml, ")


def test_all_that_is_wrong_with_programs_is_told_before_anything_is_started(
    run: Run, write: Callable[[str], Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write(
        "transformations: [{label: a, source: program:./absent, outputs: {o: X}}, "
        '{label: b, source: "program:\'", outputs: {o: X}}]\ntargets: [{label: t, topic: /t, tag: X}]\n'
    )
    monkeypatch.chdir(path.parent)
    result = run("run", path.name)
    assert result.code == 30
    assert f"{path.name}:3:38: a can't be started: absent: there is no file ./absent" in result.err
    assert "files are relative to the environment file" in result.err
    assert "b can't be started: source `program:'`: No closing quotation" in result.err
    assert "Traceback" not in result.err


OF_NUMBERS = (
    options.cost,
    options.count,
    options.duration,
    options.horizon,
    options.not_negative,
    options.port,
    options.positive,
)


def actions(parser: argparse.ArgumentParser, words: str = "") -> Iterator[tuple[str, argparse.Action]]:
    """Each option and operand of a parser and of its commands, behind the words that lead to it."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for name, inner in action.choices.items():
                yield from actions(inner, f"{words} {name}".strip())
        else:
            yield f"{words} {'/'.join(action.option_strings) or action.dest}", action


@pytest.mark.parametrize("text", ["-3s", "-3", "-.5", "x", "", "nan", "inf", "1e9999999", "99999999999999999999"])
@pytest.mark.parametrize("kind", OF_NUMBERS)
def test_an_option_with_a_number_says_what_is_wrong_with_another_and_what_is_allowed(
    kind: Callable[[str], object], text: str
) -> None:
    with pytest.raises(argparse.ArgumentTypeError) as caught:
        kind(text)
    what, _, allowed = str(caught.value).partition(": ")
    assert what.strip("'").startswith((text, "-0.5"))
    assert allowed.startswith(("write ", "the limit is "))
    assert text[:1] != "-" or "negative" in what or "at least 1" in what or "positive" in what or kind is options.port


def test_every_option_with_a_number_has_one_of_these_kinds() -> None:
    """A type such as `int` would tell neither what is wrong nor what is allowed."""
    kinds = {action.type for _, action in actions(parser_with(VERBS))}
    assert kinds.issuperset(OF_NUMBERS)
    assert kinds.isdisjoint((int, float))


@pytest.mark.parametrize("written", ["--for -3s", "--for=-3s", "--for -.5", "--for 5d", "--for nan"])
def test_a_negative_value_reaches_the_option_that_it_stands_behind(run: Run, written: str) -> None:
    err = run("listen", "/x", *written.split()).err
    assert "error: argument --for: '" in err
    assert ": write " in err


@pytest.mark.parametrize(
    "command",
    [
        "check PIPE",
        "check ENV --against PIPE",
        "solve PIPE",
        "solve ENV --with PIPE",
        "solve ENV --observed PIPE",
        "compare PIPE",
        "run PIPE",
        "ctl add PIPE",
        "import xml PIPE",
        "import wot PIPE --out new.yaml",
        "export yaml PIPE",
        "replay PIPE",
    ],
)
def test_a_pipe_that_no_program_writes_to_is_an_error(
    run: Run, env: Path, monkeypatch: pytest.MonkeyPatch, command: str
) -> None:
    """Commands once waited for ever."""
    monkeypatch.setattr(file_content, "WRITER_WAIT_S", 0.0)
    os.mkfifo("pipe.yaml")
    code, _, err = run(*command.replace("PIPE", "pipe.yaml").replace("ENV", env.name).split())
    assert code == 30
    assert "error: pipe.yaml: " in err
    assert " pipe" in err.partition("pipe.yaml: ")[2]


@pytest.mark.parametrize("named", ["ontology: PIPE", "include: PIPE"])
def test_a_file_may_name_a_pipe_too(run: Run, env: Path, monkeypatch: pytest.MonkeyPatch, named: str) -> None:
    monkeypatch.setattr(file_content, "WRITER_WAIT_S", 0.0)
    os.mkfifo("pipe.ttl")
    env.write_text(f"format: cfgplan/1\n{named.replace('PIPE', 'pipe.ttl')}\n{LIBRARY}")
    assert "it is a pipe, and no program writes to it" in run("check", env.name).err


def test_a_pipe_is_read_when_its_program_has_written(run: Run, env: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(file_content, "WRITER_WAIT_S", threading.TIMEOUT_MAX)
    os.mkfifo("pipe.yaml")
    writer = threading.Thread(target=Path("pipe.yaml").write_bytes, args=(env.read_bytes(),))
    writer.start()
    assert "1 transformation, 0 running units, 1 target: the file is valid" in run("check", "pipe.yaml").out
    writer.join()


def test_a_folder_that_is_read_as_a_file_stays_open_nowhere(tmp_path: Path) -> None:
    """A run once kept an open descriptor of each look at its file, while a folder was in the file's place."""

    def is_open() -> bool:
        there = [each for each in Path("/proc/self/fd").iterdir() if each.exists()]
        return any(each.samefile(tmp_path) for each in there)

    with pytest.raises(IsADirectoryError):
        file_content.content_of(tmp_path)
    assert not is_open()
