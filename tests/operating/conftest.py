"""Run folders of their own for each test."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from cfgplan_runtime.operating.control_client import Control, connect
from cfgplan_runtime.operating.control_server import ControlServer
from cfgplan_runtime.operating.methods import Methods
from cfgplan_runtime.streams.run_folder import RunFolder
from fake_manager import FakeManager


@pytest.fixture(autouse=True)
def runs(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder in which the runs of this test are."""
    base = tmp_path_factory.mktemp("run")
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(base))
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
    return base


@pytest.fixture
def run_folder() -> Iterator[RunFolder]:
    folder = RunFolder()
    yield folder
    folder.close()


@pytest.fixture
def manager() -> FakeManager:
    return FakeManager()


@pytest.fixture
def server(run_folder: RunFolder, manager: FakeManager) -> Iterator[ControlServer]:
    """A control server of a fake manager."""
    methods = Methods(manager).by_name()
    with ControlServer(run_folder.path, methods, "/robots/env.yaml") as running:
        yield running


@pytest.fixture
def control(server: ControlServer) -> Iterator[Control]:
    """A client of that server."""
    assert server is not None
    with connect() as client:
        yield client
