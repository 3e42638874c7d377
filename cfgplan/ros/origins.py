"""Where graphs come from: what people name on the command line, and who reads each."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from cfgplan.errors import InputError
from cfgplan.ros.graph import RosGraph, merged
from cfgplan.ros.launch_files import launch_graph
from cfgplan.ros.master import master_graph
from cfgplan.ros.recordings import is_recording, recorded_graph
from cfgplan.ros.router import router_graph

LIVE = "live"
ROS1_SOURCES = "`live`, the address of a master such as http://localhost:11311, a bag, or a launch file"
ROS2_SOURCES = (
    "`live`, the endpoint of a Zenoh router such as tcp/localhost:7447, or a bag; "
    "launch files of ROS 2 are programs: start them, and name `live`"
)
_LAUNCH_FILES, _ASSIGNS = (".launch", ".xml", ".test"), ":="
_ENDPOINT = re.compile(r"(tcp|udp|tls|quic|ws|unixsock-stream)/\S+")


def ros1_graph(sources: Sequence[str]) -> RosGraph:
    """The graph that all sources together tell; NAME:=VALUE among them are arguments of launch files.

    Raises InputError for what is no source of ROS 1.
    """
    pairs = [source.partition(_ASSIGNS)[::2] for source in sources if _ASSIGNS in source]
    if len(pairs) == len(sources):
        raise InputError.of("there are arguments, but no launch file", mend=f"name {ROS1_SOURCES}")
    return merged([_ros1(source, dict(pairs)) for source in sources if _ASSIGNS not in source])


def ros2_graph(sources: Sequence[str]) -> RosGraph:
    """The graph that all sources together tell. Raises InputError for what is no source of ROS 2."""
    return merged([_ros2(source) for source in sources])


def _ros1(source: str, arguments: Mapping[str, str]) -> RosGraph:
    if source == LIVE or "://" in source:
        return master_graph(None if source == LIVE else source)
    if Path(source).suffix in _LAUNCH_FILES and Path(source).is_file():
        return launch_graph(Path(source), arguments)
    return _file(Path(source), ROS1_SOURCES)


def _ros2(source: str) -> RosGraph:
    if source == LIVE or _ENDPOINT.fullmatch(source):
        return router_graph(None if source == LIVE else source)
    return _file(Path(source), ROS2_SOURCES)


def _file(path: Path, sources: str) -> RosGraph:
    if not path.exists():
        raise InputError.of("there is no such file", file=str(path), mend=f"name {sources}")
    if is_recording(path):
        return recorded_graph(path)
    raise InputError.of("this is no source of a graph", file=str(path), mend=f"name {sources}")
