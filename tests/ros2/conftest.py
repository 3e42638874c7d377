"""A Zenoh router on a loopback port of the tests' own, and run folders of their own."""

from __future__ import annotations

import json
import socket
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import zenoh

sys.path.append(str(Path(__file__).parents[1] / "operating"))


@pytest.fixture(scope="session")
def router_port() -> Iterator[int]:
    """The port of a router that lives as long as the tests of this process: the sdk keeps its one session to it."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port: int = free.getsockname()[1]
    config = {
        "mode": "router",
        "listen": {"endpoints": [f"tcp/127.0.0.1:{port}"]},
        "connect": {"endpoints": []},
        "scouting": {"multicast": {"enabled": False}},
    }
    router = zenoh.open(zenoh.Config.from_json5(json.dumps(config)))
    yield port
    router.close()


@pytest.fixture
def endpoint(router_port: int) -> str:
    return f"tcp/127.0.0.1:{router_port}"


@pytest.fixture(autouse=True)
def surroundings(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path_factory.mktemp("r")))
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
    for name in ("ROS_DISTRO", "ROS_DOMAIN_ID", "AMENT_PREFIX_PATH", "ZENOH_SESSION_CONFIG_URI"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.delenv("ZENOH_CONFIG_OVERRIDE", raising=False)
