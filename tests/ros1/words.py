"""A small environment of ROS 1 nodes for tests, and what comes on a topic."""

from __future__ import annotations

import os
import shutil
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import psutil
from cfgplan_runtime.operating.control_client import connect
from cfgplan_runtime.ros1.tcpros import MessageReader, subscribed
from operated_world import PATIENCE_S, eventually
from warm_nodes import NODES

from cfgplan.ros.node_api import SilentError, asked, peer

ENVIRONMENT = """\
format: cfgplan/1
transformations:
  - label: talker
    source: node:./talking.py talker
    params: {rate: 25, first: 1000}
    outputs: {words: {tag: Word, type: std_msgs/String, remap: chatter}}
  - label: shouter
    source: node:./talking.py shouter
    inputs: {quiet: {tag: Word, type: std_msgs/String}}
    outputs: {loud: {tag: LoudWord, type: std_msgs/String, remap: ~loud}}
targets:
  - {label: shout, topic: /shout, tag: LoudWord}
"""


def write_words(folder: Path) -> Path:
    """The environment file, with its nodes beside it."""
    shutil.copy(NODES, folder)
    path = folder / "env.yaml"
    path.write_text(ENVIRONMENT)
    return path


def system_state() -> list[dict[str, list[str]]]:
    """The topics that are published, those that are subscribed to, and the services, each with its nodes.

    Only the master is asked. Raises SilentError if none answers.
    """
    return [dict(rows) for rows in asked(peer(os.environ["ROS_MASTER_URI"]), "/test", "getSystemState")]


def node_names() -> set[str]:
    return {node for rows in system_state() for nodes in rows.values() for node in nodes}


def published_topics() -> set[str]:
    return {*system_state()[0]}


def process_of_the_run() -> psutil.Process:
    """The process of the only run that can be controlled."""
    with connect() as control:
        return psutil.Process(control.system.pid)


def pid_of(node: str) -> int:
    """The process of a node; 0 if it does not answer."""
    with suppress(SilentError):
        address = str(asked(peer(os.environ["ROS_MASTER_URI"]), "/test", "lookupNode", node))
        return int(asked(peer(address), "/test", "getPid"))
    return 0


def await_pid(node: str) -> int:
    """The process of a node, once it answers: a busy computer may make it miss a call."""
    found: list[int] = []
    eventually(lambda: found.append(pid_of(node)) or found[-1])
    return found[-1]


def gives(topic: str) -> bool:
    """Whether a message comes on a topic within a second."""
    with suppress(SilentError, OSError):
        master = peer(os.environ["ROS_MASTER_URI"])
        for node in system_state()[0].get(topic, []):
            with subscribed(str(asked(master, "/test", "lookupNode", node)), "/test", topic)[0] as end:
                reader = MessageReader(end)
                end.settimeout(1.0)
                while not reader.has_ended:
                    if any(True for _ in reader.read()):
                        return True
    return False


@contextmanager
def messages(topic: str) -> Iterator[Iterator[bytes]]:
    """The messages that come on a topic, without their lengths, once it is published."""
    found: list[socket.socket] = []

    def connects() -> bool:
        with suppress(SilentError, OSError):
            if nodes := system_state()[0].get(topic):
                address = asked(peer(os.environ["ROS_MASTER_URI"]), "/test", "lookupNode", nodes[0])
                found.append(subscribed(str(address), "/test", topic)[0])
        return bool(found)

    eventually(connects)
    with found[0]:
        yield _messages(found[0])


def _messages(end: socket.socket) -> Iterator[bytes]:
    reader = MessageReader(end)
    end.settimeout(PATIENCE_S)
    while not reader.has_ended:
        yield from (bytes(message[4:]) for message in reader.read())


@contextmanager
def listening(topic: str) -> Iterator[Iterator[str]]:
    """The texts that come on a topic of `std_msgs/String`, once it is published."""
    with messages(topic) as received:
        yield (message[4:].decode() for message in received)
