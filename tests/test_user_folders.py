"""Folders of the XDG specification: a relative path is ignored, in cfgplan and in the scripts of `.ci`."""

from __future__ import annotations

import os
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from cfgplan_runtime.estimating.estimates_file import default_file
from cfgplan_runtime.streams.run_folder import base_folder

from cfgplan.cache_folder import cache_folder

ENVIRONMENT = Path("/robot/env.yaml")
SCRIPT = Path(__file__).parents[1] / ".ci" / "cache-folder"


@pytest.fixture
def short() -> Iterator[Path]:
    """A folder whose name leaves room for the names of sockets."""
    with tempfile.TemporaryDirectory() as folder:
        yield Path(folder).resolve()


@pytest.mark.parametrize(
    ("variable", "folder"),
    [
        ("XDG_CACHE_HOME", cache_folder),
        ("XDG_STATE_HOME", lambda: default_file(ENVIRONMENT)),
        ("XDG_RUNTIME_DIR", base_folder),
    ],
    ids=lambda each: each if isinstance(each, str) else "",
)
def test_a_folder_that_is_a_relative_path_counts_as_none(
    variable: str, folder: Callable[[], Path], short: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(short)
    monkeypatch.setattr("tempfile.tempdir", str(short / "temporary"))
    monkeypatch.delenv(variable, raising=False)
    default = folder()
    for nothing in ("", "kept", "./kept", "~/kept"):
        monkeypatch.setenv(variable, nothing)
        assert folder() == default
    assert {path.name for path in short.iterdir()} <= {"temporary"}
    monkeypatch.setenv(variable, str(short / "own"))
    assert folder().is_relative_to(short / "own" / "cfgplan")


@pytest.mark.parametrize("home", [None, "", "kept", "/own"])
def test_the_scripts_of_ci_have_the_same_cache_folder(home: str | None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    if home is not None:
        monkeypatch.setenv("XDG_CACHE_HOME", home)
    found = subprocess.run([SCRIPT], env=os.environ, capture_output=True, text=True, check=True)
    assert found.stdout == f"{cache_folder()}\n"
