"""The sources of graphs named on the command line, and the reader of each."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from cfgplan.errors import InputError
from cfgplan.ros.graph import RosGraph, merged
from cfgplan.ros.launch_files import launch_graph
from cfgplan.ros.master import master_graph
from cfgplan.ros.pasted import is_pasted, pasted_graph
from cfgplan.ros.recordings import is_recording, recorded_graph
from cfgplan.ros.ros2_launch_files import XML_FILES, YAML_FILES, ros2_launch_graph
from cfgplan.ros.sources import REMAPS

LIVE = "live"
ROS1_SOURCES = (
    "`live`, the address of a master such as http://localhost:11311, a bag, a launch file, or text (.txt) of "
    "`rosnode info`; `-` is standard input"
)
ROS2_SOURCES = (
    "`live`, a bag, a launch file in XML or YAML, or text "
    "(.txt) of `ros2 node info` and `ros2 topic info -v`; `-` is standard input; launch files in Python are programs: "
    "start them, and name `live`"
)
_LAUNCH_FILES = (".launch", ".xml", ".test")


def ros1_graph(sources: Sequence[str]) -> RosGraph:
    """Return the merged graph of all sources; NAME:=VALUE entries are arguments of launch files.

    Raises InputError for an entry that is no source of ROS 1.
    """
    return _merged(sources, _ros1, ROS1_SOURCES)


def ros2_graph(sources: Sequence[str], live: Callable[[], RosGraph]) -> RosGraph:
    """Return the merged graph of all sources; NAME:=VALUE entries are arguments of launch files.

    `live` queries the running system. Raises InputError for an entry that is no source of ROS 2.
    """
    return _merged(sources, lambda source, arguments: _ros2(source, arguments, live), ROS2_SOURCES)


def _merged(
    sources: Sequence[str], read: Callable[[str, Mapping[str, str]], RosGraph], those_that_are: str
) -> RosGraph:
    pairs = [source.partition(REMAPS)[::2] for source in sources if REMAPS in source]
    if len(pairs) == len(sources):
        raise InputError.of("there are arguments, but no launch file", mend=f"name {those_that_are}")
    return merged([read(source, dict(pairs)) for source in sources if REMAPS not in source])


def _ros1(source: str, arguments: Mapping[str, str]) -> RosGraph:
    if source == LIVE or "://" in source:
        return master_graph(None if source == LIVE else source)
    if is_pasted(source):
        return pasted_graph(source, 1)
    if Path(source).suffix in _LAUNCH_FILES and Path(source).is_file():
        return launch_graph(Path(source), arguments)
    return _file(Path(source), ROS1_SOURCES)


def _ros2(source: str, arguments: Mapping[str, str], live: Callable[[], RosGraph]) -> RosGraph:
    if source == LIVE:
        return live()
    if is_pasted(source):
        return pasted_graph(source, 2)
    path = Path(source)
    if path.suffix == ".py":
        mend = "start it, and name `live`: it is a program, and only running it tells what it starts"
        raise InputError.of("launch files in Python can't be read", file=source, mend=mend)
    if path.suffix in (*XML_FILES, *YAML_FILES) and path.is_file() and not is_recording(path):
        return ros2_launch_graph(path, arguments)
    return _file(path, ROS2_SOURCES)


def _file(path: Path, sources: str) -> RosGraph:
    if not path.exists():
        raise InputError.of("there is no such file", file=str(path), mend=f"name {sources}")
    if is_recording(path):
        return recorded_graph(path)
    raise InputError.of("a graph can't be read from this", file=str(path), mend=f"name {sources}")
