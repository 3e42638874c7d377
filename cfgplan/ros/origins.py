"""Where graphs come from: what people name on the command line, and who reads each."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from cfgplan.errors import InputError
from cfgplan.ros.graph import RosGraph, merged
from cfgplan.ros.master import master_graph

LIVE = "live"
ROS1_SOURCES = "`live`, or the address of a master such as http://localhost:11311"


def ros1_graph(sources: Sequence[str]) -> RosGraph:
    """The graph that all sources together tell. Raises InputError for what is no source of ROS 1."""
    return merged([_ros1(source) for source in sources])


def _ros1(source: str) -> RosGraph:
    if source == LIVE or "://" in source:
        return master_graph(None if source == LIVE else source)
    if not Path(source).exists():
        raise InputError.of("there is no such file", file=source, mend=f"name {ROS1_SOURCES}")
    raise InputError.of("this is no source of a ROS 1 graph", file=source, mend=f"name {ROS1_SOURCES}")
