"""Watches one ROS 1 node: whether it has registered with its master, and then whether it still answers."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Collection
from contextlib import suppress
from functools import partial
from typing import Protocol
from xmlrpc.client import ServerProxy

from cfgplan.errors import InputError
from cfgplan.ros.node_api import SilentError, asked, peer

_WATCHER = "/cfgplan_watch"
_NODE_LOOK_S, _MOST_NODE_LOOK_S = 0.02, 0.2
"""Seconds between two checks of a starting node, growing up to the second value."""
_PORTS_S = 2.0
"""Seconds after which a registered node is ready, even if it does not publish all its topics yet."""
_LATE_S = 10.0
"""Seconds after which the topics that it does not publish are reported."""
ALIVE_S = 1.0
"""Seconds between two calls that check whether it answers."""


class WatchOwner(Protocol):
    """The owner of a watch, called by the watch's thread."""

    def note_ready(self, node: str, address: str) -> None: ...
    def note_alive(self, node: str) -> None: ...
    def note_late(self, node: str, topics: list[str]) -> None:
        """The node has been running for a while and does not publish these topics."""

    def note_silence(self, node: str) -> None:
        """The node did not answer twice in a row: a busy computer may make it miss one call."""


class NodeWatch:
    """A watch that begins at once. `is_own` decides by its process id whether a node of this name is the right one.

    `published` and `subscribed` are the topics of its ports. A node may begin with them late, or never.
    """

    def __init__(
        self,
        owner: WatchOwner,
        master: str,
        node: str,
        is_own: Callable[[int], bool],
        published: Collection[str],
        subscribed: Collection[str],
    ) -> None:
        self._owner, self._master, self._node, self._is_own = owner, peer(master), node, is_own
        self._published, self._subscribed = set(published), set(subscribed)
        self._is_over = threading.Event()
        threading.Thread(target=self._watch, name=f"watch {node}", daemon=True).start()

    def end(self) -> None:
        """Stop calling the owner."""
        self._is_over.set()

    def _watch(self) -> None:
        address = self._address()
        if address is None:
            return
        node = peer(address)
        until, look_s = time.monotonic() + _PORTS_S, _NODE_LOOK_S
        while not self._has_ports(node) and time.monotonic() < until and not self._is_over.wait(look_s):
            look_s = _longer(look_s)
        self._tell(partial(self._owner.note_ready, self._node, address))
        late_s, is_silent = time.monotonic() + _LATE_S, False
        while not self._is_over.wait(ALIVE_S):
            try:
                asked(node, _WATCHER, "getPid")
                if time.monotonic() > late_s:
                    late_s = float("inf")
                    missing = self._unpublished(node)
                    if missing:
                        self._tell(partial(self._owner.note_late, self._node, missing))
            except SilentError:
                if is_silent:
                    self._tell(partial(self._owner.note_silence, self._node))
                is_silent = True
            else:
                is_silent = False
                self._tell(partial(self._owner.note_alive, self._node))

    def _address(self) -> str | None:
        """Wait until the node answers. Returns its address, or None if the watch has ended."""
        look_s = _NODE_LOOK_S
        while not self._is_over.wait(look_s):
            look_s = _longer(look_s)
            with suppress(SilentError, InputError):
                address = str(asked(self._master, _WATCHER, "lookupNode", self._node))
                if self._is_own(int(asked(peer(address), _WATCHER, "getPid"))):
                    return address
        return None

    def _has_ports(self, node: ServerProxy) -> bool:
        try:
            return not self._unpublished(node) and self._subscribed <= _topics(node, "getSubscriptions")
        except SilentError:
            return False

    def _unpublished(self, node: ServerProxy) -> list[str]:
        """The names of outputs that it neither publishes nor offers as services."""
        left = self._published - _topics(node, "getPublications")
        return sorted(name for name in left if not self._serves(name))

    def _serves(self, name: str) -> bool:
        try:
            asked(self._master, _WATCHER, "lookupService", name)
        except SilentError:
            return False
        return True

    def _tell(self, call: Callable[[], None]) -> None:
        if not self._is_over.is_set():
            call()


def _longer(look_s: float) -> float:
    return min(1.2 * look_s, _MOST_NODE_LOOK_S)


def _topics(node: ServerProxy, method: str) -> set[str]:
    return {str(topic) for topic, _ in asked(node, _WATCHER, method)}
