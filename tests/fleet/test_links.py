"""Links of a fleet: what may listen where, and what is said without Zenoh."""

from __future__ import annotations

import socket
import sys

import pytest
from cfgplan_runtime.fleet.links import config
from cfgplan_runtime.streams.zenoh_link import ZenohLink

from cfgplan.errors import InputError


@pytest.mark.parametrize("endpoint", ["tcp/127.0.0.1:7447", "tcp/[::1]:0", "tcp/localhost:7447", "unixsock-stream//x"])
def test_without_certificates_a_link_listens_on_loopback(endpoint: str) -> None:
    assert config([endpoint])["listen"] == {"endpoints": [endpoint]}


@pytest.mark.parametrize("endpoint", ["tcp/0.0.0.0:7447", "tcp/192.168.1.5:7447", "tcp/[::]:7447", "tcp/robot:7447"])
def test_without_certificates_a_link_listens_nowhere_else(endpoint: str) -> None:
    with pytest.raises(InputError, match="loopback only"):
        config([endpoint])


def test_a_fleet_without_zenoh_is_told_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "zenoh", None)
    with pytest.raises(InputError, match="cfgplan\\[fleet\\]"):
        ZenohLink(config())


def test_an_address_that_is_taken_is_told() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        endpoint = f"tcp/127.0.0.1:{taken.getsockname()[1]}"
        with pytest.raises(InputError, match=f"can't listen on {endpoint}"):
            ZenohLink(config([endpoint]))
