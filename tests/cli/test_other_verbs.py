"""`check`, `match`, `graph` and the help as a user sees them."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree

import pytest
from command import MODELS, Run

LOST = MODELS / "nao" / "2-segmenter-lost.yaml"
PIFF = MODELS / "nao" / "1-piff-registered.yaml"


def test_check_names_file_and_line_of_a_violated_rule(run: Run) -> None:
    result = run("check", LOST)
    line = 1 + LOST.read_text().splitlines().index("      hull: null   # the gap that the segmenter left")
    assert result.code == 1
    assert f"{LOST}:{line}:" in result.out
    assert "fed: input hull of unit ball_detector(piff).1 is not connected" in result.out


def test_check_finds_nothing_wrong_with_a_valid_configuration(run: Run) -> None:
    result = run("check", MODELS / "nao" / "3-puff-registered.yaml")
    assert result.code == 0
    assert "the running configuration is valid" in result.out


def test_check_gives_the_same_as_json(run: Run) -> None:
    document = run("check", LOST, "--json").document
    assert document["valid"] is False
    assert {violation["rule"] for violation in document["violations"]} == {"fed"}


def test_match_shows_who_may_feed_whom(run: Run) -> None:
    result = run("match", PIFF)
    assert result.code == 0
    assert "9 inputs and targets x 20 outputs: 9 of 180 pairs match." in result.out


def test_match_gives_the_matrix_as_json(run: Run) -> None:
    document = run("match", PIFF, "--json").document
    assert document["inputs"]["segmenter(piff)/y"]["outputs"] == ["subsampler(piff)/y80"]
    assert len(document["outputs"]) == 20


def test_match_explains_a_miss_with_what_is_lacking(run: Run) -> None:
    result = run("match", PIFF, "subsampler(piff)/y40", "segmenter(piff)/y")
    assert result.code == 0
    assert "does not feed" in result.out
    assert "it lacks Y80X60Image" in result.out
    assert "nearest: subsampler(piff)/y80" in result.out


def test_match_explains_a_match(run: Run) -> None:
    result = run("match", PIFF, "ball_localization(piff)/position", "ball")
    assert "feeds" in result.out
    assert "lacks" not in result.out


def test_match_suggests_the_port_that_was_meant(run: Run) -> None:
    result = run("match", PIFF, "subsampler(piff)/y81", "segmenter(piff)/y")
    assert result.code == 30
    assert "did you mean `subsampler(piff)/y80`?" in result.err


@pytest.mark.parametrize(
    ("ending", "begin"), [("svg", b"<?xml"), ("png", b"\x89PNG"), ("dot", b"digraph"), ("mmd", b"flowchart")]
)
def test_graph_writes_the_format_that_the_ending_says(run: Run, tmp_path: Path, ending: str, begin: bytes) -> None:
    out = tmp_path / f"update.{ending}"
    assert run("graph", LOST, "--out", out).code == 0
    assert out.read_bytes().startswith(begin)


def test_graph_refuses_an_ending_it_does_not_know(run: Run, tmp_path: Path) -> None:
    result = run("graph", LOST, "--out", tmp_path / "update.bmp")
    assert result.code == 30
    assert ".svg" in result.err


def test_graph_colours_what_changes(run: Run) -> None:
    picture = run("graph", LOST, "--format", "mermaid").out
    assert '["segmenter(piff).1"]:::started' in picture
    assert '["ball_detector(piff).1"]:::rewired' in picture
    running = run("graph", LOST, "--format", "mermaid", "--running").out
    assert ":::started" not in running


ODD = ["%a", "<b>", "c\\nd", "&lt;", 'e"f', "%%{init}%%", "$g$", "\\N"]


@pytest.fixture
def odd(tmp_path: Path) -> Path:
    """Units whose names mean something to those who draw them, as ids and as hosts."""
    hosts = [{"name": name} for name in ODD]
    transformations = [{"label": name, "host": name, "outputs": {"o": "A"}} for name in ODD]
    units = [{"id": name, "transformation": name, "host": name} for name in ODD]
    document = {"format": "cfgplan/1", "hosts": hosts, "transformations": transformations, "units": units}
    env = tmp_path / "odd.json"
    env.write_text(json.dumps(document))
    return env


def test_graph_shows_names_as_they_are_written(run: Run, odd: Path, tmp_path: Path) -> None:
    out = tmp_path / "odd.svg"
    result = run("graph", odd, "--running", "--out", out)
    assert result.code == 0, result.err
    shown = [text.text for text in ElementTree.parse(out).iter("{http://www.w3.org/2000/svg}text")]
    assert sorted(shown) == sorted(2 * ODD)


def test_a_mermaid_picture_has_no_name_that_mermaid_reads(run: Run, odd: Path) -> None:
    picture = run("graph", odd, "--running", "--format", "mermaid").out
    named = [line for line in picture.splitlines() if "[" in line]
    assert len(named) == 2 * len(ODD)
    for line in named:
        text = line.partition('["')[2].rpartition('"]')[0]
        assert not set(text) & set('"<>&%$\\')


@pytest.mark.parametrize("verb", ["check", "match", "solve", "graph", "import", "export"])
def test_each_verb_has_help_with_an_example(run: Run, verb: str) -> None:
    result = run(verb, "--help")
    assert result.code == 0
    assert f"example:\n  cfgplan {verb}" in result.out


def test_a_missing_file_is_one_clear_error(run: Run) -> None:
    result = run("solve", "nowhere.yaml")
    assert result.code == 30
    assert result.err.startswith("error: nowhere.yaml: ")


def test_errors_come_as_json_to_whom_asked_for_json(run: Run, write: Callable[[str], Path]) -> None:
    result = run("solve", write("targts: []\n"), "--json")
    assert result.code == 30
    assert result.document["errors"][0]["line"] == 3


def test_the_heavy_engines_are_imported_only_where_they_are_used() -> None:
    """What `import cfgplan` and `cfgplan --help` may cost, told by what they load rather than by a clock."""
    heavy = {"ortools", "owlready2", "pyhornedowl", "pydantic", "pygraphviz", "numpy", "networkx", "rich", "yaml"}
    code = (
        "import sys\nimport cfgplan\nfrom cfgplan.cli.main import main\n"
        "try:\n    main(['--help'])\nexcept SystemExit:\n    pass\n"
        "print(sorted({name.partition('.')[0] for name in sys.modules}), file=sys.stderr)"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not heavy & set(eval(found.stderr))


def test_units_are_the_same_whatever_their_ids() -> None:
    from cfgplan.cli.run import difference_text
    from cfgplan.domain import ComputationUnit, Environment, Publication, Stream, Subscription

    def fed(unit: str, by: str, topic: str = "/t") -> ComputationUnit:
        subscriptions = (Subscription("x", Stream(by, "n")),)
        return ComputationUnit(unit, "work", subscriptions, (Publication("y", topic),))

    said = Environment((ComputationUnit("a", "count"), ComputationUnit("b", "count"), fed("c", "b")))
    same = Environment((ComputationUnit("count.1", "count"), ComputationUnit("b", "count"), fed("work.1", "b")))
    assert difference_text(said, same) == "The running units are those of `units:`."
    other = Environment((ComputationUnit("c", "count"), fed("work.1", "c"), ComputationUnit("b", "else")))
    text = difference_text(said, other)
    assert "  + start   b (runs)" in text
    assert "  - stop    b" in text
    assert "x <- a/n   (was b/n)" in text


def test_check_says_that_a_file_without_units_is_valid_and_how_to_go_on(run: Run, write: Callable[[str], Path]) -> None:
    env = write("transformations: [{label: s, outputs: {x: A}}]\ntargets: [{label: q, topic: /q, tag: A}]\n")
    result = run("check", env)
    assert result.code == 0
    assert f"the file is valid. Nothing runs yet: `cfgplan solve {env}` plans what to start." in result.out
    assert run("check", env, "--json").document["valid"] is True


def test_check_of_a_file_without_units_does_not_hide_that_code_is_broken(
    run: Run, write: Callable[[str], Path], tmp_path: Path
) -> None:
    env = write("transformations: [{label: s, source: 'code.py:s', outputs: {x: A}}]\n")
    (tmp_path / "code.py").write_text("def s(:\n")
    result = run("check", env)
    assert result.code == 0
    assert "can't be started" in result.err
    assert "the file is valid, but the warnings say what to correct. Nothing runs yet" in result.out


def test_check_against_a_file_where_something_ran_still_says_what_broke(
    run: Run, write: Callable[[str], Path], tmp_path: Path
) -> None:
    text = "transformations: [{label: s, outputs: {x: A}}]\ntargets: [{label: q, topic: /q, tag: A}]\n"
    before = write(text + "units: [{id: s.1, transformation: s, topics: {x: [/q]}}]\n").rename(tmp_path / "before.yaml")
    assert run("check", write(text), "--against", before).code == 1


@pytest.mark.parametrize("verb", [["solve"], ["check"], ["run", "--dry-run", "--no-estimates"]])
def test_who_forgets_targets_is_asked_for_them(verb: list[str], run: Run, write: Callable[[str], Path]) -> None:
    env = write("transformations: [{label: s, source: 'units.py:S', outputs: {x: A}}]\n")
    result = run(verb[0], env, *verb[1:])
    assert "Is `targets:` missing?" in result.out + result.err


def test_who_asks_for_instances_instead_of_targets_is_not_asked(run: Run, write: Callable[[str], Path]) -> None:
    env = write("transformations: [{label: s, min_instances: 1, outputs: {x: A}}]\n")
    result = run("solve", env)
    assert "targets:" not in result.out + result.err
