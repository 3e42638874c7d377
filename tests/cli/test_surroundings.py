"""What a command does where it is started: closed, full or plain streams, signals, missing packages."""

from __future__ import annotations

import errno
import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from command import MODELS, Run
from rich.console import Group
from rich.table import Table
from rich.text import Text
from warm import cold_command, command

from cfgplan import extras
from cfgplan.cli import styled
from cfgplan.cli.interrupts import Interrupts, ended_cleanly
from cfgplan.cli.main import _SYNONYMS, VERBS
from cfgplan.cli.screen import _ESCAPE, Screen
from cfgplan.planners import cpsat

NAO = MODELS / "nao"
UNMET = NAO / "0-target-only.yaml"
FUSION = NAO / "4-fusion-available.yaml"
pytestmark = [
    pytest.mark.skipif(os.name != "posix", reason="signals, pipes and devices of POSIX"),
    pytest.mark.usefixtures("warm_cfgplan"),
]


def start(*arguments: object, **more: Any) -> subprocess.CompletedProcess[bytes]:
    return ended(command(*arguments), **more)


def ended(line: list[str], **more: Any) -> subprocess.CompletedProcess[bytes]:
    streams = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, **more}
    return subprocess.run(line, check=False, timeout=120, **streams)


def test_without_a_verb_there_is_help(run: Run) -> None:
    result = run()
    assert result.code == 30
    assert "solve" in result.err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["solve", FUSION, "--jsn"], "unrecognized arguments: --jsn"),
        (["solve"], "the following arguments are required: ENV"),
        (["solve", FUSION, "--horizon", "long"], "argument --horizon: 'long' is not a horizon"),
        (["solve", FUSION, "--out", MODELS], f"argument --out: {str(MODELS)!r} is a folder: name a file"),
        (
            ["graph", FUSION, "--out", "nodir/a.svg"],
            "argument --out: 'nodir/a.svg' can't be written: there is no folder",
        ),
        (["sensitivity", FUSION, "--out", ""], "argument --out: it is an empty word"),
        (
            ["export", "schema", "--out", "a" * 300],
            f"argument --out: {'a' * 300!r} can't be written: File name too long",
        ),
        (["ctl", "fly"], "argument COMMAND: invalid choice: 'fly'"),
    ],
)
def test_a_command_line_that_is_wrong_is_bad_input_like_any_other(
    run: Run, arguments: list[object], message: str
) -> None:
    text, found = run(*arguments), run(*arguments, "--json")
    assert (text.code, text.out, found.code, found.err) == (30, "", 30, "")
    assert text.err.startswith(f"error: {message}")
    (fault,) = found.document["errors"]
    assert fault["message"].startswith(message)
    assert fault["mend"].endswith(f"cfgplan {arguments[0]} --help tells more")


def test_a_misspelt_verb_is_told_the_nearest_one(run: Run) -> None:
    err = run("slove", UNMET).err
    assert err.startswith("error: there is no command `slove`\n    $ cfgplan slove ")
    assert "\n              ^^^^^\n       did you mean `solve`?" in err


@pytest.mark.parametrize(
    ("word", "mend"),
    [
        ("manual", "write `cfgplan help`"),
        ("new", "write `cfgplan init`"),
        ("validate", "write `cfgplan check`"),
        ("plan", "write `cfgplan solve`, or `cfgplan ctl plan` for a live run"),
        ("status", "write `cfgplan ctl state`: it is a command for a live run"),
    ],
)
def test_a_verb_of_another_program_is_told_what_it_is_called_here(run: Run, word: str, mend: str) -> None:
    assert run(word).err.splitlines()[-1].strip() == mend


def test_no_word_of_another_program_hides_a_verb() -> None:
    words = [word for words in _SYNONYMS.values() for word in words]
    assert len({*words, *VERBS}) == len(words) + len(VERBS)
    assert _SYNONYMS.keys() <= VERBS.keys()


def test_a_terminal_without_unicode_gets_escapes_and_json_is_utf_8_everywhere() -> None:
    ascii_only = {**os.environ, "PYTHONIOENCODING": "ascii"}
    text = ended(cold_command("explain", UNMET), env=ascii_only)
    assert text.returncode == 10
    assert b"target ball wants Position \\u2293 \\u2203hasSource.Ball" in text.stdout
    found = ended(cold_command("explain", UNMET, "--json"), env=ascii_only)
    assert found.returncode == 10
    assert "∃hasSource.Ball" in json.dumps(json.loads(found.stdout.decode()), ensure_ascii=False)


@pytest.mark.parametrize("verb", [["solve", FUSION], ["graph", FUSION, "--format", "mermaid"]])
def test_closed_streams_are_no_errors(verb: list[object]) -> None:
    line = ["sh", "-c", '"$@" >&- 2>&-', "sh", *cold_command(*verb)]
    done = subprocess.run(line, check=False, timeout=120)
    assert done.returncode == 0


def test_a_reader_that_has_gone_is_no_error() -> None:
    for verb, code in ((("solve", FUSION), 0), (("solve", "nothere.yaml", "--json"), 30)):
        reader, writer = os.pipe()
        os.close(reader)
        done = start(*verb, stdout=writer)
        os.close(writer)
        assert (done.returncode, done.stderr.count(b"Error")) == (code, 0)


@pytest.mark.skipif(not Path("/dev/full").is_char_device(), reason="this system has no /dev/full")
def test_a_full_disk_is_told() -> None:
    with Path("/dev/full").open("wb") as full:
        done = [start(*verb, stdout=full) for verb in (["export", "schema"], ["solve", "nothere.yaml", "--json"])]
    for each in done:
        assert each.returncode == 30
        assert b"error: standard output: the output can't be written: No space left" in each.stderr
        assert b"\n       free some space, or write to another disk\n" in each.stderr


@pytest.mark.parametrize(
    ("number", "mend"),
    [
        (errno.ENOSPC, "free some space, or write to another disk"),
        (errno.EROFS, "allow writing there, or name another place"),
        (errno.ENOENT, "make the folder first"),
        (errno.ENOTDIR, "a part of this path is a file: name another place"),
        (errno.EISDIR, "it is a folder: name a file in it"),
        (errno.ENAMETOOLONG, "give it a shorter name"),
    ],
)
def test_a_file_that_can_not_be_written_is_told_with_a_mend_that_helps(
    run: Run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, number: int, mend: str
) -> None:
    def refused(*_: object) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr("cfgplan.api._replace", refused)
    result = run("export", "schema", "--out", tmp_path / "schema.json")
    assert result.code == 30
    assert f"schema.json: can't be written: {os.strerror(number)}\n" in result.err
    assert f"\n       {mend}\n" in result.err


@pytest.mark.parametrize(
    ("options", "package", "extra"),
    [
        (["--local"], "zenoh", "fleet"),
        (["--record", "run.mcap"], "mcap", "record"),
        (["--metrics-port", "0"], "prometheus_client", "metrics"),
    ],
)
def test_a_run_names_a_missing_extra_before_it_plans(
    run: Run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, options: list[str], package: str, extra: str
) -> None:
    monkeypatch.chdir(tmp_path)
    find = extras.find_spec
    monkeypatch.setattr(extras, "find_spec", lambda name: None if name == package else find(name))
    result = run("run", FUSION, *options)
    assert (result.code, result.out) == (30, "")
    assert f"pip install 'cfgplan[{extra}]'" in result.err
    if "--local" not in options:  # it needs the hosts of a fleet
        assert run("run", FUSION, *options, "--dry-run").code == 0


def test_a_folder_that_can_not_hold_a_run_is_named_and_not_the_environment_file(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run("init", tmp_path / "kitchen")
    too_long = tmp_path / ("x" * 99)
    for folder, told in (("/dev/null", "can't hold the run's sockets: Not a directory"), (too_long, "too long a name")):
        monkeypatch.setenv("XDG_RUNTIME_DIR", str(folder))
        ended = run("run", tmp_path / "kitchen" / "env.yaml", "--for", "1s", "--no-estimates")
        assert ended.code == 30
        assert f"error: {folder}/cfgplan: {told}" in ended.err
        assert "set XDG_RUNTIME_DIR to a" in ended.err
        assert "^" not in ended.err


def test_a_package_that_is_missing_is_named(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pygraphviz", None)
    result = run("graph", FUSION)
    assert result.code == 30
    assert "pictures need the package pygraphviz, which is not installed" in result.err
    assert "pip install 'cfgplan[graph]'" in result.err


@pytest.mark.parametrize("as_json", [False, True])
def test_a_bug_is_told_as_any_other_error(run: Run, monkeypatch: pytest.MonkeyPatch, as_json: bool) -> None:
    def plan(*_: object, **__: object) -> None:
        raise RuntimeError("planned badly")

    monkeypatch.setattr(cpsat, "plan", plan)
    result = run("solve", UNMET, *["--json"] * as_json)
    assert result.code == 31
    if as_json:
        (error,) = result.document["errors"]
        assert error["message"] == "internal error: RuntimeError: planned badly"
        assert "CFGPLAN_TRACEBACK" in error["mend"]
    else:
        assert "internal error: RuntimeError: planned badly" in result.err
        assert "Traceback" not in result.err


@pytest.mark.parametrize("arguments", [["--alternatives", "3"], ["--best-effort"]])
def test_ctrl_c_ends_what_asks_for_many_plans(run: Run, monkeypatch: pytest.MonkeyPatch, arguments: list[str]) -> None:
    """The planner turns Ctrl-C into its best plan so far, with which nothing more may be asked."""
    plan = cpsat.plan

    def interrupted(*given: Any, **more: Any) -> Any:
        more["stop"].set()
        return plan(*given, **more)

    monkeypatch.setattr(cpsat, "plan", interrupted)
    result = run("solve", FUSION, *arguments)
    assert (result.code, result.out) == (130, "")
    assert "interrupted" in result.err


def test_what_a_library_makes_of_ctrl_c_is_an_interruption(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    """ortools that is interrupted while it is imported says `ImportError: initialization failed`."""

    def interrupted(*_: Any, **__: Any) -> Any:
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
        raise ImportError("initialization failed")

    monkeypatch.setattr("cfgplan.api.load", interrupted)
    result = run("solve", FUSION)
    assert result.code == 130
    assert "interrupted" in result.err


def test_an_interrupted_start_of_a_run_is_an_interruption_too(
    run: Run, monkeypatch: pytest.MonkeyPatch, write: Callable[[str], Path]
) -> None:
    def interrupted(*_: Any, **__: Any) -> Any:
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
        raise ImportError("initialization failed")

    monkeypatch.setattr("cfgplan_runtime.operating.operation.Operation", interrupted)
    env = write("transformations: [{label: s, source: 'units.py:S', min_instances: 1, outputs: {x: A}}]\n")
    env.with_name("units.py").write_text("def S():\n    return 1\n")
    result = run("run", env, "--no-estimates")
    assert (result.code, result.err) == (130, "interrupted\n")


def test_what_the_first_interrupt_lets_go_is_not_interrupted_by_the_second() -> None:
    done = False
    with pytest.raises(KeyboardInterrupt), Interrupts() as interrupts:
        try:
            signal.raise_signal(signal.SIGINT)
        finally:
            signal.raise_signal(signal.SIGINT)
            done = True
    assert (done, interrupts.count) == (True, 2)


@pytest.mark.parametrize("when", ["sys.stderr = Bell()", "atexit.register(ring)"])
def test_a_second_ctrl_c_is_an_interruption_like_the_first(when: str) -> None:
    """It comes while the first is told, or when Python is about to end."""
    code = f"""
import atexit, signal, sys
import cfgplan.api
from cfgplan.cli import main

def ring(*_):
    signal.raise_signal(signal.SIGINT)

class Bell:
    write = ring
    isatty = flush = lambda self: None

def load(*_, **__):
    {when}
    ring()

cfgplan.api.load = load
sys.argv[1:] = ["check", "env.yaml"]
sys.exit(main())
"""
    done = subprocess.run([sys.executable, "-c", code], check=False, timeout=120, capture_output=True)
    assert done.returncode == 130
    assert b"Traceback" not in done.stderr


def test_a_thread_that_is_still_inside_a_library_neither_aborts_nor_holds_up_the_end() -> None:
    """It comes back from Rust while the interpreter ends."""
    pytest.importorskip("zenoh", reason="needs the extra fleet")
    code = """
import sys, threading, time
import zenoh
from cfgplan.cli import main

class Late:
    def __del__(self, sleep=time.sleep):
        sleep(1.0)

late = Late()
alone = '{"scouting": {"multicast": {"enabled": false}}, "listen": {"endpoints": []}}'
session = zenoh.open(zenoh.Config.from_json5(alone))
held = session.declare_queryable("slow", lambda query: time.sleep(0.7))
threading.Thread(target=lambda: [*session.get("slow", timeout=0.6)], daemon=True).start()
time.sleep(0.1)
sys.argv[1:] = ["--version"]
sys.exit(main())
"""
    done = subprocess.run([sys.executable, "-c", code], check=False, timeout=30, capture_output=True)
    assert (done.returncode, done.stderr) == (0, b"")
    assert done.stdout.startswith(b"cfgplan ")


def test_sigterm_lets_a_command_clear_away_what_it_has_made() -> None:
    before = signal.getsignal(signal.SIGTERM)
    with pytest.raises(SystemExit, match="143"), ended_cleanly():
        signal.raise_signal(signal.SIGTERM)
    assert signal.getsignal(signal.SIGTERM) == before


def test_the_demo_is_not_played_for_a_page_that_can_not_be_written(run: Run, tmp_path: Path) -> None:
    for page in (tmp_path, tmp_path / "nowhere" / "page.html"):
        result = run("demo", "nao", "--report", page)
        assert (result.code, result.out) == (30, "")
        assert str(page) in result.err


def test_no_other_file_is_taken_for_estimates(run: Run, tmp_path: Path) -> None:
    env = tmp_path / "env.yaml"
    env.write_text("format: cfgplan/1\n")
    result = run("run", env, "--estimates", env, "--dry-run")
    assert result.code == 30
    assert "name a file of its own, such as env.json" in result.out + result.err
    assert [path.name for path in tmp_path.iterdir()] == ["env.yaml"]


@pytest.mark.parametrize(
    "command",
    [
        ("solve", "ENV", "--out", "ENV"),
        ("export", "yaml", "ENV", "--out", "ENV"),
        ("run", "ENV", "--dry-run", "--log", "ENV"),
        ("solve", UNMET, "--with", "ENV", "--out", "ENV"),
    ],
)
def test_what_is_read_is_not_written_over(command: tuple[object, ...], run: Run, tmp_path: Path) -> None:
    env = tmp_path / "env.yaml"
    env.write_text(text := "format: cfgplan/1\ntransformations:\n  - {label: a, outputs: {o: A}}\n")
    result = run(*(env if word == "ENV" else word for word in command))
    assert result.code == 30
    assert "this file is read" in result.err
    assert env.read_text() == text


@pytest.mark.parametrize("columns", ["1", "40", "80"])
def test_a_table_is_whole_on_a_narrow_terminal(
    columns: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Names were cut, or stood one letter below the other. No line ends with spaces, which would be wrapped."""
    monkeypatch.setenv("COLUMNS", columns)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    table = Table("topic", "from", "seconds since the last element", box=None)
    table.add_row("/result", "detector_with_a_long_name.1/seen", Text("12", style="dim"))
    table.add_row("/other", "a.1/o", "")
    for result in (table, Group(table, "end")):
        Screen(json=False).show(result)
        out = _ESCAPE.sub("", capsys.readouterr().out)
        assert " topic    from                              seconds since the last element\n" in out
        assert " /result  detector_with_a_long_name.1/seen  12\n" in out
        assert " /other   a.1/o\n" in out


@pytest.mark.parametrize("is_terminal", [True, False])
def test_no_line_of_a_result_ends_with_spaces(
    is_terminal: bool, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Lines of `ctl plan | cat` did, where a name is shorter than the others."""
    monkeypatch.setattr(sys.stdout, "isatty", lambda: is_terminal)
    for result in (styled.Text("= keep  a.1   \n= keep  bc.1  "), "= keep  a.1   \n= keep  bc.1  "):
        Screen(json=False).show(result)
        assert _ESCAPE.sub("", capsys.readouterr().out) == "= keep  a.1\n= keep  bc.1\n"


def test_a_line_with_many_spaces_is_printed_at_once(capsys: pytest.CaptureFixture[str]) -> None:
    """Each space was looked at once for every space before it: wide tables took seconds, and this line minutes."""
    line = f"a{' ' * 200_000}b"
    Screen(json=False).show(f"{line}  ")
    assert capsys.readouterr().out == f"{line}\n"


def test_a_png_picture_is_not_written_to_a_terminal(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    result = run("graph", FUSION, "--format", "png")
    assert (result.code, result.out) == (30, "")
    assert "--out" in result.err


def test_a_query_without_a_formula_says_so(run: Run) -> None:
    result = run("query", FUSION)
    assert result.code == 30
    assert "the formula is missing" in result.err


def test_a_long_formula_is_no_file(run: Run) -> None:
    result = run("query", f"a > {'1' * 5000}")
    assert result.code == 30


@pytest.mark.skipif(not Path("/dev/full").is_char_device(), reason="this system has no /dev/full")
def test_nothing_depends_on_stderr(tmp_path: Path) -> None:
    with Path("/dev/full").open("wb") as full:
        assert start("solve", "nowhere.yaml", stderr=full).returncode == 30
        plan = tmp_path / "plan.json"
        assert start("solve", FUSION, "--progress", "--out", plan, stderr=full).returncode == 0
    assert json.loads(plan.read_text())["status"] == "optimal"


def test_who_reads_stderr_may_go(tmp_path: Path) -> None:
    reader, writer = os.pipe()
    os.close(reader)
    plan = tmp_path / "plan.json"
    result = start("solve", FUSION, "--progress", "--out", plan, stderr=writer)
    os.close(writer)
    assert result.returncode == 0
    assert b"Optimal" in result.stdout
    assert json.loads(plan.read_text())["status"] == "optimal"


def test_the_help_is_there_before_anything_that_plans_is_imported() -> None:
    heavy = {"cfgplan.domain", "cfgplan.planning", "numpy", "ortools", "pydantic", "rich", "yaml"}
    code = "import sys; from cfgplan.cli import main\ntry: main(['--help'])\nfinally: "
    code += f"print(*{heavy} & sys.modules.keys())"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stdout.startswith("usage: cfgplan")
    assert done.stdout.splitlines()[-1] == ""
