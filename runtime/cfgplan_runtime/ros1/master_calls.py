"""Calls of a relay to ROS 1's master, in a thread of their own, in order."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import partial

from cfgplan.ros.node_api import SilentError, asked, peer

_AGAIN_S, _MOST_AGAIN_S = 0.05, 2.0
"""Seconds until a call without an answer is made again, doubled up to the second value."""


class MasterCalls:
    """Calls the master at an address as a node. Answers come in the thread of the calls."""

    def __init__(self, master: str, node: str) -> None:
        self._master, self._node = master, node
        self._calls = ThreadPoolExecutor(1, "to-master")

    def tell(self, method: str, *arguments: str) -> None:
        """Call the master once, after all earlier calls."""
        self._calls.submit(self._ask, method, *arguments)

    def ask(
        self,
        *call: str,
        is_wanted: Callable[[], bool],
        then: Callable[[list[str]], None],
    ) -> None:
        """Call the master until it answers, as long as the call `is_wanted`, and `then` with its answer.

        Other calls are made while this one waits.
        """
        self._calls.submit(self._ask_until_answered, *call, is_wanted=is_wanted, then=then, again_s=_AGAIN_S)

    def address_of(self, node: str) -> str:
        """The address of a node. Waits for the master; raises SilentError."""
        return str(asked(peer(self._master), self._node, "lookupNode", node))

    def _ask_until_answered(
        self, *call: str, is_wanted: Callable[[], bool], then: Callable[[list[str]], None], again_s: float
    ) -> None:
        if not is_wanted():
            return
        answer = self._ask(*call)
        if answer is not None:
            then(answer)
            return
        longer_s = min(2 * again_s, _MOST_AGAIN_S)
        again = partial(self._ask_until_answered, *call, is_wanted=is_wanted, then=then, again_s=longer_s)
        timer = threading.Timer(again_s, self._submit, [again])
        timer.daemon = True
        timer.start()

    def _submit(self, call: Callable[[], None]) -> None:
        with suppress(RuntimeError):  # this process is ending
            self._calls.submit(call)

    def _ask(self, method: str, *arguments: str) -> list[str] | None:
        """The master's answer; None if it does not answer."""
        try:
            answer: list[str] = asked(peer(self._master), self._node, method, *arguments)
        except SilentError:
            return None
        return answer
