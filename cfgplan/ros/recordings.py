"""The topics of a recording: bags of ROS 1, bags of ROS 2, and single MCAP and SQLite files of them."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from cfgplan.errors import InputError
from cfgplan.extras import needed
from cfgplan.ros.graph import Role, RosGraph, RosNode, RosPort
from cfgplan.ros.types import MessageType

if TYPE_CHECKING:
    from rosbags.interfaces import Connection

_BAG1 = ".bag"
_RECORDING_ENDINGS = (_BAG1, ".mcap", ".db3")
_METADATA = "metadata.yaml"


def is_recording(path: Path) -> bool:
    """Whether a file or folder looks like a recording."""
    return (path / _METADATA).is_file() if path.is_dir() else path.suffix in _RECORDING_ENDINGS


def recorded_graph(path: Path) -> RosGraph:
    """Return the publishers of a recording. Raises InputError if it can't be read.

    Bags of ROS 1 usually name the publishers. A player publishes topics without a known publisher.
    """
    connections, seconds = _read(path)
    notes = [f"the subscribers to topics of {path}: a recording has only publications"]
    publishers: dict[str | None, list[RosPort]] = defaultdict(list)
    for one in connections:
        caller = getattr(one.ext, "callerid", None)
        rate_hz = float(f"{one.msgcount / seconds:.3g}") if one.msgcount > 1 and seconds else None
        kind = _type(one.msgtype)
        if kind is None:
            notes.append(f"the type of {one.topic}, which {path} calls `{one.msgtype}`")
        publishers[caller].append(
            RosPort(Role.PUBLISHES, one.topic, kind, rate_hz=rate_hz, definition=one.digest or None)
        )
    nodes = [
        _player(path, ports) if name is None else RosNode(name, tuple(ports)) for name, ports in publishers.items()
    ]
    return RosGraph(tuple(nodes), (f"the recording {path}",), tuple(notes))


def _player(path: Path, ports: Sequence[RosPort]) -> RosNode:
    """Return the player of a recording; in ROS 1 it is a node with its command."""
    name = f"/play_{re.sub(r'[^A-Za-z0-9]+', '_', path.stem)}"
    if path.suffix != _BAG1:
        return RosNode(name, tuple(ports), player=True)
    return RosNode(name, tuple(ports), "rosbag", "play", arguments=(str(path),), player=True)


def _type(text: str) -> MessageType | None:
    try:
        return MessageType.read(text)
    except InputError:
        return None


def _read(path: Path) -> tuple[Sequence[Connection], float]:
    """The connections of a recording, and how many seconds it lasts."""
    needed("recordings", "rosbags")
    from rosbags import rosbag1, rosbag2

    reader_of = rosbag1.Reader if path.suffix == _BAG1 else rosbag2.Reader
    try:
        with reader_of(path) as reader:
            return [*reader.connections], reader.duration / 1e9 if reader.message_count else 0.0
    except (rosbag1.ReaderError, rosbag2.ReaderError, OSError) as error:
        mend = "play it, and record it again" if path.suffix == _BAG1 else "`ros2 bag reindex` makes a new index"
        raise InputError.of(f"this recording can't be read: {error}", file=str(path), mend=mend) from None
    except Exception as error:  # of a file that is cut off or no recording at all, the readers raise whatever they meet
        mend = "is it a whole recording?"
        raise InputError.of(
            f"this is not a recording: {type(error).__name__}: {error}", file=str(path), mend=mend
        ) from None
