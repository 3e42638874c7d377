"""Runtimes for tests, and a check that none leaves anything behind."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import psutil
import pytest
from cfgplan_runtime import Runtime
from living import descendants
from watching import StartRuntime
from world import RESULT

from cfgplan.domain import Transformation


@pytest.fixture(autouse=True)
def nothing_is_left_behind(
    tmp_path_factory: pytest.TempPathFactory,
    monkeypatch: pytest.MonkeyPatch,
    warm_nurseries: None,  # noqa: ARG001
) -> Iterator[Path]:
    base = tmp_path_factory.mktemp("run")
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(base))
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
    me = psutil.Process()
    children = descendants()
    descriptors = me.num_fds()
    yield base
    assert descendants() - children == set(), "processes"
    assert list((base / "cfgplan").rglob("*")) == []
    assert me.num_fds() <= descriptors, "descriptors"


@pytest.fixture
def run_units() -> Iterator[StartRuntime]:
    """Start a runtime of a library, with the target /result."""
    running: list[Runtime] = []

    def run(*library: Transformation, **more: Any) -> Runtime:
        runtime = Runtime(library, [RESULT], folder=Path(__file__).parent, **more)
        running.append(runtime)
        return runtime

    yield run
    for runtime in running:
        runtime.close()
