"""Every code block of the manual and the README runs here, or says which test runs it, or why none does.

A comment before a block says what becomes of it: `file: NAME` writes it for the blocks after it, `append: NAME` adds
it to that file, `tested by: FILE` names another test, `exit: N` is the exit code of its last command, and
`not run: REASON`: its commands are only parsed. A block of text shows what the block before it prints; dots stand for
anything. An environment without a mark is loaded.
"""

from __future__ import annotations

import re
import shlex
import sys
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path
from textwrap import dedent
from types import ModuleType

import pytest
import yaml

import cfgplan
from cfgplan.cli import main
from cfgplan.cli.main import parser_of

ROOT = Path(__file__).parent.parent
PAGES = [ROOT / "README.md", *sorted((ROOT / "cfgplan" / "manual").glob("*.md"))]
SHOWN = ("ini", "mermaid")
"""Languages of blocks that are for other programs."""


@dataclass(frozen=True)
class Block:
    language: str
    text: str
    mark: str
    said: str


def blocks_of(page: Path) -> list[Block]:
    pattern = r"(?:<!-- (file|append|tested by|exit|not run): (.*?) -->\n)?^( *)```(\w+)\n(.*?)^ *```$"
    found = re.findall(pattern, page.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)
    return [Block(language, dedent(text), mark, said) for mark, said, _, language, text in found]


def commands(block: Block) -> list[list[str]]:
    """The arguments of each `cfgplan` command, without redirection; `.venv/bin` and other programs are left out."""
    lines = block.text.replace("\\\n", " ").splitlines()
    parts = [shlex.split(part, comments=True) for line in lines for part in line.split(" && ")]
    return [
        list(takewhile(lambda word: word != ">", part[1:]))
        for part in parts
        if part and part[0].rpartition("/")[2] == "cfgplan"
    ]


def check_text(shown: str, said: str) -> None:
    """A command that takes long says so after its output, on stderr."""
    parts = [re.escape(part) for part in " ".join(shown.split()).split("...")]
    assert re.search(".*".join(parts), " ".join(said.split())), said


def forget_module(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the next import read the page's file, whichever module had its name; afterwards that module is back."""
    monkeypatch.setitem(sys.modules, name, ModuleType(name))
    del sys.modules[name]


@pytest.mark.usefixtures("warm_runs")
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_code_blocks_run(
    page: Path,
    tmp_path: Path,
    tmp_path_factory: pytest.TempPathFactory,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    for folder in ("models", "experiments"):
        (tmp_path / folder).symlink_to(ROOT / folder)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path_factory.mktemp("r")))
    names: dict[str, object] = {}
    said = ""
    for block in blocks_of(page):
        arguments = commands(block) if block.language == "sh" else []
        for each in arguments:
            parser_of(each).parse_args(each)
        match block.mark, block.language:
            case "not run", _:
                continue
            case "tested by", _:
                assert page.stem in (ROOT / block.said).read_text(encoding="utf-8"), block.said
            case _, language if language in SHOWN:
                continue
            case _, "text":
                check_text(block.text, said)
            case _, "python" if block.mark != "file":
                exec(compile(block.text, str(page), "exec"), names)
                said = capsys.readouterr().out
            case _, "sh":
                assert arguments, f"a block without commands: {block.text}"
                codes = [main(each) for each in arguments]
                said = "".join(capsys.readouterr())
                assert codes[-1] == int(block.said or 0), block.text
            case "append", _:
                with (tmp_path / block.said).open("a") as file:
                    file.write(block.text)
            case "file", _:
                (tmp_path / block.said).write_text(block.text)
                if block.said.endswith(".py"):
                    forget_module(Path(block.said).stem, monkeypatch)
                if block.language == "yaml" and "format" in yaml.safe_load(block.text):
                    cfgplan.load(block.said)
            case _, "yaml" if "format" in yaml.safe_load(block.text):
                (tmp_path / "shown.yaml").write_text(block.text)
                cfgplan.load("shown.yaml")
            case _:
                pytest.fail(f"put `<!-- not run: REASON -->` before the block, or another mark: {block.text}")
