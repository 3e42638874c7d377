"""A command run in this process, with its exit code and what it said."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path

import pytest
from command import Result, Run

from cfgplan.cache_folder import cache_folder
from cfgplan.cli import main


@pytest.fixture
def run(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory
) -> Run:
    archives = cache_folder() / "hermit"
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
    # A cache of its own, but for the classes of HermiT's Java: each question would read them anew.
    archives.mkdir(parents=True, exist_ok=True)
    cache_folder().mkdir(parents=True)
    (cache_folder() / "hermit").symlink_to(archives)
    monkeypatch.setenv("COLUMNS", "200")
    # On a busy machine a phase may take so long that it is told on stderr; that is tested by itself.
    monkeypatch.setattr("cfgplan.cli.screen.WORK_TOLD_S", threading.TIMEOUT_MAX)

    def run(*arguments: object) -> Result:
        try:
            code = main([str(argument) for argument in arguments])
        except SystemExit as error:
            code = int(error.code or 0)
        captured = capsys.readouterr()
        return Result(code, captured.out, captured.err)

    return run


@pytest.fixture
def write(tmp_path: Path) -> Callable[[str], Path]:
    """Write an environment file with an open vocabulary; returns its path."""

    def write(text: str) -> Path:
        path = tmp_path / "env.yaml"
        path.write_text("format: cfgplan/1\nhorizon: 10\n" + text)
        return path

    return write
