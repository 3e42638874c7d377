"""The helper itself: a node of ROS 2, orders that come as lines of JSON, and answers that go the same way.

A line with a `size` is followed by so many bytes, which are the message's `data`.
"""

from __future__ import annotations

import inspect
import json
import os
import platform
import queue
import signal
import socket
import sys
import threading
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import rclpy
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from cfgplan_runtime.ros2.host.waiting import Waiting

NAMELESS = "_NODE_NAME_UNKNOWN_"
"""The name in rmw of a node whose endpoint has been found before it has."""
_PR_SET_PDEATHSIG = 1
_HAS_MATCHED = "matched" in inspect.signature(SubscriptionEventCallbacks.__init__).parameters


def die_with_parent(parent: int) -> None:
    """Have the kernel kill this process when the thread that made it ends. `parent` is that thread's process."""
    if sys.platform != "linux":
        return
    import ctypes

    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(1)


class Host:
    """State that all parts of the helper share. `handlers` maps an order's `type` to the function that carries it out.

    All but the reading and writing of the socket is done by the thread of `run`.
    """

    def __init__(self, end: socket.socket, name: str) -> None:
        self._socket = end
        self._orders: deque[dict[str, Any]] = deque()
        self._words: queue.SimpleQueue[tuple[bytes, int | None]] = queue.SimpleQueue()
        """What is to be sent, and the topic that waits until that is done."""
        self._is_over = False
        self.on_match: Callable[[], None] = lambda: None
        self._is_match_due = False
        self.handlers: dict[str, Callable[[dict[str, Any]], None]] = {"Finish": lambda _: self._finish()}
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        space, _, own = name.rpartition("/")
        self.node: Any = Node(own, namespace=space or None, enable_rosout=False, start_parameter_services=False)
        self.context: Any = self.node.context
        self.waiting = Waiting(self.context)
        self._guard = self.node.create_guard_condition(self._do_orders)
        self.waiting.watch("guard_condition", self._guard.handle, self._do_orders)
        for work in (self._hear, self._speak):
            threading.Thread(target=work, daemon=True).start()
        self.say(
            "Listening",
            rmw=rclpy.get_rmw_implementation_identifier(),
            distribution=os.environ.get("ROS_DISTRO", ""),
            python=platform.python_version(),
        )

    def say(self, kind: str, data: bytes = b"", **fields: Any) -> None:
        """Send a message. Never waits. Once `data` of a topic by `number` has left, the order `Sent` tells of it."""
        size = {"size": len(data)} if data else {}
        line = json.dumps({"type": kind, **size, **fields}).encode() + b"\n"
        self._words.put((line + data, fields.get("number") if data else None))

    def is_own(self, endpoint: Any) -> bool:
        """Whether an end of a topic, as rclpy tells of it, is the helper's."""
        return bool(endpoint.node_name == self.node.get_name())

    def matched(self) -> dict[str, Callable[[Any], None]]:
        """Return the argument that asks for matched events, where rclpy has them (Iron or newer)."""
        return {"matched": lambda _: None} if _HAS_MATCHED else {}

    def note_match(self) -> None:
        """Call `on_match` soon, once for all endpoints that have matched by then."""
        if not self._is_match_due:
            self._is_match_due = True
            self.waiting.later(0.0, self._tell_match)

    def _tell_match(self) -> None:
        self._is_match_due = False
        self.on_match()

    def run(self) -> None:
        """Carry out orders until one says to finish, or the other end of the socket closes."""
        while not self._is_over:
            self.waiting.wait()

    def close(self) -> None:
        """Take leave of other nodes."""
        self.node.destroy_node()
        rclpy.shutdown()

    def _finish(self) -> None:
        self._is_over = True

    def _do_orders(self) -> None:
        while self._orders:
            order = self._orders.popleft()
            self.handlers[order.pop("type")](order)

    def _hear(self) -> None:
        with self._socket.makefile("rb") as lines:
            for line in lines:
                order = json.loads(line)
                size = order.pop("size", 0)
                self._order(order | {"data": lines.read(size)} if size else order)
        self._order({"type": "Finish"})

    def _order(self, order: dict[str, Any]) -> None:
        self._orders.append(order)
        self._guard.trigger()

    def _speak(self) -> None:
        with suppress(OSError):
            while True:
                words, topic = self._words.get()
                self._socket.sendall(words)
                if topic is not None:
                    self._order({"type": "Sent", "number": topic})
