"""Runs on real processes, and a check that none leaves anything behind."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from living import descendants
from real_run import RealRun


@pytest.fixture(autouse=True)
def warm(warm_nurseries: None) -> None:
    """Nurseries are warm."""


@pytest.fixture
def run_for_real(
    tmp_path: Path, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> Iterator[RealRun]:
    """An environment file that is watched, a manager, a runtime of processes, and a listener to /result."""
    base = tmp_path_factory.mktemp("r")  # short: a socket's path may have about 100 characters
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(base))
    before = descendants()
    run = RealRun(tmp_path)
    try:
        yield run
    finally:
        run.close()
    assert descendants() - before == set(), "processes"
    assert list((base / "cfgplan").rglob("*")) == []
