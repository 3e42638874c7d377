"""The world under test is a folder of unit code, and the network that of an experiment; neither is installed."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from living import descendants
from warm import warm_processes
from warm_python import warm_subprocess

ROOT = Path(__file__).parents[2]
sys.path += [str(ROOT / "models" / "fleet"), str(ROOT / "experiments" / "fleet")]


@pytest.fixture(scope="session")
def warm_programs() -> None:
    """The processes that fork the programs of these tests are no processes of a test."""
    warm_processes()
    for module in ("other_manager", "failing_run"):
        warm_subprocess(module)


@pytest.fixture(autouse=True)
def nothing_is_left_behind(
    tmp_path_factory: pytest.TempPathFactory,
    monkeypatch: pytest.MonkeyPatch,
    warm_agents: None,  # noqa: ARG001
    warm_programs: None,  # noqa: ARG001
) -> Iterator[None]:
    base = tmp_path_factory.mktemp("r")
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(base))
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
    children = descendants()
    yield
    assert descendants() - children == set(), "processes"
    assert list((base / "cfgplan").rglob("*")) == []
