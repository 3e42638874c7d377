"""Users' code is checked by mypy against the installed package."""

from __future__ import annotations

import subprocess
import sys
from itertools import chain
from pathlib import Path
from zipfile import ZipFile

import pytest
from test_code_blocks import ROOT, blocks_of

PAGES = ("README.md", "cfgplan/manual/python.md")
WRONG = """\
import cfgplan

cfgplan.plan(cfgplan.load("a.yaml"))
cfgplan.load("a.yaml").horizon_s.upper()
"""


@pytest.fixture(scope="module")
def said(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """What `mypy --strict` says of the pages' examples and of a wrong one, a line for each error."""
    folder = tmp_path_factory.mktemp("typed")
    for page in PAGES:
        blocks = [block.text for block in blocks_of(ROOT / page) if block.language == "python"]
        assert blocks, page
        examples = [f"def example_{number}() -> None:\n{indented(text)}" for number, text in enumerate(blocks)]
        (folder / f"{Path(page).stem.lower()}.py").write_text("\n".join(examples))
    (folder / "wrong.py").write_text(WRONG)
    files = sorted(path.name for path in folder.iterdir())
    command = [sys.executable, "-m", "mypy", "--strict", "--no-incremental", "--no-error-summary", *files]
    found = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert found.returncode == 1, found.stdout + found.stderr
    return found.stdout.splitlines()


def indented(text: str) -> str:
    return "".join(chain.from_iterable(("    ", line) for line in text.splitlines(keepends=True)))


def test_examples_of_the_readme_and_the_manual_pass_strict_mypy(said: list[str]) -> None:
    assert [line for line in said if not line.startswith("wrong.py")] == []


def test_a_wrong_argument_is_found_by_mypy(said: list[str]) -> None:
    """The types are really those of the package, and not Any."""
    first, second = said
    assert 'incompatible type "World"; expected "Problem"' in first
    assert '"int" has no attribute "upper"' in second


def test_the_wheel_says_that_it_has_types_and_holds_the_files_of_the_page(tmp_path: Path) -> None:
    from hatchling.builders.wheel import WheelBuilder

    (wheel,) = WheelBuilder(str(ROOT)).build(directory=str(tmp_path), versions=["standard"])
    files = {*ZipFile(wheel).namelist()}
    assert {"cfgplan/py.typed", "cfgplan_runtime/py.typed", "cfgplan_runtime/page/page.js"} <= files
    runtime = ROOT / "runtime"
    assert {path.relative_to(runtime).as_posix() for path in runtime.glob("cfgplan_runtime/page/*.*s")} <= files
