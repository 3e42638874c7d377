"""Beginners' mistakes: each gets one message with the place, a caret, the cause, and a mend that mends it."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import NamedTuple

import pytest
import yaml
from command import Run


class Row(NamedTuple):
    right: str
    wrong: str
    place: str
    cause: str
    mend: str
    mended: str | None = None


class Command(NamedTuple):
    wrong: str
    marked: str
    cause: str
    mend: str
    mended: str


TABLE = yaml.load(Path(__file__).with_name("mistakes.yaml").read_text(), yaml.CSafeLoader)
WORLD, BESIDE = TABLE["world"], TABLE["beside"]
ROWS = [Row(**row) for rows in TABLE["slips"].values() for row in rows]
COMMANDS = [Command(**row) for row in TABLE["commands"]]

LOADS = (0, 1)
"""Codes of `check` for a file that loads; 1 says that what runs there breaks a rule."""
REFUSED = 30
_WRITTEN = re.compile(
    r"(?:did you mean|write|write it as|after the key:|after the colon:|after the dash:|around it:) `([^`]+)`"
)
_NUMBER = re.compile(r"(?:seconds|megabytes, a plain number): ([\d.]+)$")


@pytest.fixture(autouse=True)
def _folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for name, text in BESIDE.items():
        Path(name).write_text(text)
    Path("env.yaml").write_text(WORLD)


def _with(right: str, written: str) -> str:
    assert right in WORLD
    return WORLD.replace(right, written, 1)


@pytest.mark.parametrize("row", ROWS, ids=lambda row: f"{row.wrong} for {row.right}")
def test_a_slip_in_a_file_is_told_with_its_place_and_its_line_and_is_mended_as_told(run: Run, row: Row) -> None:
    mended = _with(row.right, row.right if row.mended is None else row.mended)
    Path("env.yaml").write_text(_with(row.right, row.wrong))
    code, _, err = run("check", "env.yaml")
    said, *below = err.rstrip("\n").split("\n")
    kind, _, message = said.partition(": ")
    assert (kind, code) in (("error", REFUSED), ("warning", 0))
    assert message.startswith(f"{row.place}: ")
    assert message.endswith(row.cause)
    assert below[2:] == [f"       {row.mend}"], "there is one message, with one mend"
    _assert_marked(row.place, *below[:2])
    for suggested in _WRITTEN.findall(row.mend):
        assert suggested in mended or "..." in suggested or suggested == "name: tag"
    for number in _NUMBER.findall(row.mend):
        assert f": {number}\n" in mended
    Path("env.yaml").write_text(mended)
    after = run("check", "env.yaml")
    assert after.code in LOADS
    warned = [line for line in after.err.splitlines() if not line.startswith(" ")]
    assert all(" has no effect: " in line for line in warned), "a mended word may still have no effect there"


def _assert_marked(place: str, shown: str, carets: str) -> None:
    """Hold the two lines below a message against the place in the file that it names."""
    file, line, column = [*place.split(":"), "1"][:3]
    written = Path(file).read_text().split("\n")[int(line) - 1]
    assert shown == f"{line:>5} | {written}".replace("\t", " ").rstrip()
    assert re.fullmatch(r" {6}\| *\^+", carets)
    if ":" in place.partition(":")[2]:
        assert carets.index("^") == len("      | ") + int(column) - 1


@pytest.mark.parametrize("row", COMMANDS, ids=lambda row: row.wrong)
def test_a_slip_in_a_command_is_told_with_a_caret_and_is_mended_as_told(run: Run, row: Command) -> None:
    code, _, err = run(*shlex.split(row.wrong))
    said, shown, carets, *mend = err.rstrip("\n").split("\n")
    assert code == REFUSED
    assert said == f"error: {row.cause}"
    assert shown == f"    $ cfgplan {row.wrong}"
    assert mend == [f"       {row.mend}"]
    begin, end = carets.index("^"), len(carets)
    assert shown[begin:end] == row.marked
    assert carets.strip("^ ") == ""
    for suggested in _WRITTEN.findall(row.mend):
        assert suggested in row.mended
    after = run(*shlex.split(row.mended))
    assert after.code < REFUSED, after.err


def test_an_undeclared_prefix_of_an_ontology_is_mended_by_the_line_that_is_told(run: Run) -> None:
    Path("env.yaml").write_text(WORLD.replace("house.ttl", "bad.ttl"))
    told = re.search(r"`(@prefix owl: .*)`", run("check", "env.yaml").err)
    assert told is not None
    Path("bad.ttl").write_text(told[1] + "\n" + BESIDE["house.ttl"].replace("@prefix owl:", "@prefix other:"))
    assert run("check", "env.yaml").code == 0


@pytest.mark.parametrize(
    ("wrong", "column", "mend", "mended"),
    [
        ("{'format': 'cfgplan/1'}", 2, "put the key in double quotes", '{"format": "cfgplan/1"}'),
        ('{"format" "cfgplan/1"}', 11, "put a colon between key and value", '{"format": "cfgplan/1"}'),
        ('{"format": "cfgplan/1" "horizon": 9}', 24, "put a comma", '{"format": "cfgplan/1", "horizon": 9}'),
        ('{"format": cfgplan/1}', 12, "with text in double quotes", '{"format": "cfgplan/1"}'),
        ('{"format": "cfgplan/1}', 12, 'close the text with "', '{"format": "cfgplan/1"}'),
        ('{"format": "cfgplan/1"}}', 24, "keep one value", '{"format": "cfgplan/1"}'),
    ],
)
def test_a_slip_in_json_is_told_likewise(run: Run, wrong: str, column: int, mend: str, mended: str) -> None:
    Path("env.json").write_text(wrong)
    code, _, err = run("check", "env.json")
    said, *below = err.rstrip("\n").split("\n")
    assert code == REFUSED
    assert said.startswith(f"error: env.json:1:{column}: this is not JSON: ")
    _assert_marked(f"env.json:1:{column}", *below[:2])
    assert mend in below[2]
    Path("env.json").write_text(mended)
    assert run("check", "env.json").code == 0


@pytest.mark.parametrize(
    ("tag", "mend", "mended"),
    [
        ("some hasPlace Kitchen", "the property comes first: `hasPlace some Kitchen`", "hasPlace some Kitchen"),
        ("geometry_msgs/Pose", "the message type is written beside the tag, under `type:`", "Pose"),
        ("Image and frequency > 10", "state them under `quality:`", "Image"),
        ("Image AND Ball", "did you mean `and`?", "Image and Ball"),
        ("Image || Ball", "write `or` once", "Image or Ball"),
    ],
)
def test_a_slip_in_a_tag_is_told_without_an_ontology_too(run: Run, tag: str, mend: str, mended: str) -> None:
    world = WORLD.replace("ontology: house.ttl\n", "").replace("tag: Person", "tag: TAG")
    Path("env.yaml").write_text(world.replace("TAG", tag))
    assert mend in run("check", "env.yaml").err
    Path("env.yaml").write_text(world.replace("TAG", mended))
    assert run("check", "env.yaml").code in LOADS


def test_what_is_told_to_programs_has_no_line_of_the_file(run: Run) -> None:
    Path("env.yaml").write_text(_with("upkeep: 0.2", "upkep: 0.2"))
    code, out, err = run("check", "env.yaml", "--json")
    assert (code, err) == (REFUSED, "")
    assert '"upkep: 0.2"' not in out
    assert '"mend": "did you mean `upkeep`?"' in out


@pytest.mark.parametrize(
    ("wrong", "right"),
    [
        ("topics", "ctl topics"),
        ("hz /somebody", "ctl hz"),
        ("status", "ctl state"),
        ("env.yaml", "solve env.yaml"),
    ],
)
def test_a_command_line_without_its_command_is_told_which(run: Run, wrong: str, right: str) -> None:
    code, _, err = run(*wrong.split())
    said, _, carets, mend = err.rstrip("\n").split("\n")
    assert (code, said) == (REFUSED, f"error: there is no command `{wrong.split()[0]}`")
    assert carets == " " * len("    $ cfgplan ") + "^" * len(wrong.split()[0])
    assert f"`cfgplan {right}`" in mend


@pytest.mark.parametrize(("wrong", "mend"), [("status", "did you mean `state`?"), ("explain", "did you mean `why`?")])
def test_an_unknown_command_of_a_live_run_is_told_by_what_it_is_called_here(run: Run, wrong: str, mend: str) -> None:
    said, _, carets, mended = run("ctl", wrong).err.rstrip("\n").split("\n")
    assert said == f"error: argument COMMAND: invalid choice: '{wrong}'"
    assert carets.strip() == "^" * len(wrong)
    assert mended.strip().startswith(mend)


@pytest.mark.parametrize("encoding", ["utf-8-sig", "ascii"])
@pytest.mark.parametrize("ending", ["\n", "\r\n"])
def test_a_file_of_an_editor_of_windows_loads(run: Run, encoding: str, ending: str) -> None:
    Path("env.yaml").write_bytes(WORLD.replace("\n", ending).encode(encoding))
    assert run("check", "env.yaml").code == 0


@pytest.mark.parametrize(
    ("encoding", "place", "cause"),
    [
        ("latin-1", "env.yaml:13:14", "byte 0xfc is not UTF-8"),
        ("utf-16-le", "env.yaml:1:1", "the file is in UTF-16"),
        ("utf-16-be", "env.yaml:1:1", "the file is in UTF-16"),
    ],
)
def test_a_file_in_another_encoding_is_told_with_its_first_foreign_byte(
    run: Run, encoding: str, place: str, cause: str
) -> None:
    mark = "" if encoding == "latin-1" else "\ufeff"
    Path("env.yaml").write_bytes((mark + _with("label: somebody", "label: für alle")).encode(encoding))
    said, _, carets, mend = run("check", "env.yaml").err.rstrip("\n").split("\n")
    assert said == f"error: {place}: {cause}"
    assert carets.index("^") == len("      | ") + int(place.rpartition(":")[2]) - 1
    assert mend == "       save the file in the encoding UTF-8"
    Path("env.yaml").write_text(_with("label: somebody", "label: für alle"), encoding="utf-8")
    assert run("check", "env.yaml").code == 0


def test_the_table_has_the_mistakes_of_many_beginners() -> None:
    assert len(ROWS) >= 190
    assert len(COMMANDS) >= 40
    assert len({row.wrong for row in (*ROWS, *COMMANDS)}) == len(ROWS) + len(COMMANDS)
