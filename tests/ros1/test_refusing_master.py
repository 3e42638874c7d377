"""A master that refuses calls: the relay of ROS 1 calls it again, and makes its other calls meanwhile."""

from __future__ import annotations

import socket
import subprocess
import sys
import threading
from collections import Counter
from collections.abc import Iterator
from xmlrpc.server import SimpleXMLRPCServer

import pytest
from cfgplan_runtime.children.control import ControlConnection
from cfgplan_runtime.children.messages import Finish
from cfgplan_runtime.nodes.relay_messages import Lead
from cfgplan_runtime.ros1.relay_messages import RelayOrder
from cfgplan_runtime.ros1.topic_relay import TopicRelay, ToTopicRelay
from operated_world import eventually


class RefusingMaster:
    """A master that never lets /refused be subscribed to, and refuses the first two calls of any other kind."""

    def __init__(self) -> None:
        self.asked = Counter[tuple[str, str]]()
        self.server = SimpleXMLRPCServer(("127.0.0.1", 0), logRequests=False)
        for method in ("registerSubscriber", "registerPublisher", "registerService", "unregisterSubscriber"):
            self.server.register_function(lambda _, name, *__, method=method: self.answer(method, name), method)
        self.address = f"http://127.0.0.1:{self.server.server_address[1]}/"
        self.thread = threading.Thread(target=self.server.serve_forever, daemon=True)
        self.thread.start()

    def answer(self, method: str, name: str) -> tuple[int, str, list[str]]:
        self.asked[method, name] += 1
        refuses = name == "/refused" or self.asked[method, name] <= 2
        return (0, "not now", []) if refuses else (1, "", [])


@pytest.fixture
def master() -> Iterator[RefusingMaster]:
    made = RefusingMaster()
    yield made
    made.server.shutdown()
    made.server.server_close()


@pytest.fixture
def run(master: RefusingMaster) -> Iterator[ControlConnection[ToTopicRelay]]:
    """The run's end of the connection to a relay."""
    ours, theirs = socket.socketpair()
    order = RelayOrder("/relay", master.address, "127.0.0.1")
    relay = TopicRelay(order, ControlConnection(theirs, ToTopicRelay))
    thread = threading.Thread(target=relay.run)
    thread.start()
    control: ControlConnection[ToTopicRelay] = ControlConnection(ours, ToTopicRelay)
    yield control
    control.send(Finish())
    thread.join()
    control.close()


def lead(topic: str, number: int, *, is_service: bool = False) -> Lead:
    return Lead(number, "listener.1", f"listener.1/{number}", topic, f"/to{number}", 8, is_service=is_service)


def test_a_topic_that_is_refused_keeps_no_other_one_waiting(
    run: ControlConnection[ToTopicRelay], master: RefusingMaster
) -> None:
    run.send(lead("/refused", 1))
    run.send(lead("/fine", 2))
    eventually(lambda: master.asked["registerSubscriber", "/fine"] == 3)
    eventually(lambda: master.asked["registerSubscriber", "/refused"] > 4)
    assert master.asked["registerSubscriber", "/fine"] == 3


def test_what_is_refused_is_offered_again_until_it_is_taken(
    run: ControlConnection[ToTopicRelay], master: RefusingMaster
) -> None:
    run.send(lead("/add", 1, is_service=True))
    eventually(lambda: master.asked["registerService", "/to1"] == 3)


ENDING = """
import atexit, threading
from cfgplan_runtime.ros1.master_calls import MasterCalls

atexit.register(lambda: [one.join() for one in threading.enumerate() if isinstance(one, threading.Timer)])
calls = MasterCalls("http://127.0.0.1:1", "/relay")
calls.ask("registerSubscriber", "/topic", is_wanted=lambda: True, then=print)
"""
"""Code that ends while it calls a master that is not there, after its next call was due."""


def test_a_process_that_ends_while_no_master_answers_says_nothing_of_it() -> None:
    ended = subprocess.run([sys.executable, "-c", ENDING], capture_output=True, text=True, check=True)
    assert ended.stderr == ""
