"""A folder of its own for the runs of each test, which must be empty in the end."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest


@pytest.fixture
def runs(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    base = tmp_path_factory.mktemp("run")
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(base))
    monkeypatch.setenv("XDG_CACHE_HOME", str(base / "cache"))
    monkeypatch.setenv("COLUMNS", "200")
    me = psutil.Process()
    children = set(me.children(recursive=True))
    yield base
    left = [child for child in set(me.children(recursive=True)) - children if child.status() != psutil.STATUS_ZOMBIE]
    assert left == []
    assert list((base / "cfgplan").rglob("*")) == []
