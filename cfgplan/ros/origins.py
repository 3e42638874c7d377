"""Where graphs come from: what people name on the command line, and who reads each."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from cfgplan.errors import InputError
from cfgplan.ros.graph import RosGraph, merged
from cfgplan.ros.master import master_graph
from cfgplan.ros.router import router_graph

LIVE = "live"
ROS1_SOURCES = "`live`, or the address of a master such as http://localhost:11311"
ROS2_SOURCES = "`live`, or the endpoint of a Zenoh router such as tcp/localhost:7447"
_ENDPOINT = re.compile(r"(tcp|udp|tls|quic|ws|unixsock-stream)/\S+")


def ros1_graph(sources: Sequence[str]) -> RosGraph:
    """The graph that all sources together tell. Raises InputError for what is no source of ROS 1."""
    return merged([_ros1(source) for source in sources])


def ros2_graph(sources: Sequence[str]) -> RosGraph:
    """The graph that all sources together tell. Raises InputError for what is no source of ROS 2."""
    return merged([_ros2(source) for source in sources])


def _ros1(source: str) -> RosGraph:
    if source == LIVE or "://" in source:
        return master_graph(None if source == LIVE else source)
    raise _no_source(source, ROS1_SOURCES)


def _ros2(source: str) -> RosGraph:
    if source == LIVE or _ENDPOINT.fullmatch(source):
        return router_graph(None if source == LIVE else source)
    raise _no_source(source, ROS2_SOURCES)


def _no_source(source: str, sources: str) -> InputError:
    what = "this is no source of a graph" if Path(source).exists() else "there is no such file"
    return InputError.of(what, file=source, mend=f"name {sources}")
