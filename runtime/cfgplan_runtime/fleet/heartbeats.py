"""Heartbeats: numbered UDP datagrams by which a manager asks agents whether they are alive, beside the signs of life
that they send over their links.

Links use TCP, which delivers everything in order. On a radio that loses 20 % of all packets a link can be silent for
8 s although both computers are well. A lost datagram delays no other one. The manager asks more often while an agent
is silent, and the agent answers each question to the address that it came from. Both are signed with a secret that
the manager sends over the link.
"""

from __future__ import annotations

import hmac
import secrets
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from math import inf
from typing import Any

from cfgplan_runtime.fleet.links import LEASE_S, sign_period_s
from cfgplan_runtime.streams.ends import Ends, Waker

_DATAGRAM = struct.Struct("<4sQB16s")
"""A mark, the question's number, the kind of datagram, and its signature."""
_MARK = b"cfg1"
_QUESTION, _ANSWER = 0, 1
_HASTE = 5
"""The number of questions per period while an agent is silent."""
_PATIENT_PERIODS = 2
"""An agent is silent if no answer has come for so many periods. A lossless link answers once a period."""
_ROUND_TRIPS, _LEAST_PATIENCE_S = 4, 0.02
"""An agent whose links have ended must answer within so many round trips, but has at least so many seconds. It is asked
as many times meanwhile, since questions and answers may be lost.
"""
_SECRET_BYTES, _MOST_BYTES = 16, 256


def new_secret() -> bytes:
    """Return a secret for the heartbeats of one session."""
    return secrets.token_bytes(_SECRET_BYTES)


def _signed(secret: bytes, number: int, kind: int) -> bytes:
    signature = hmac.digest(secret, struct.pack("<QB", number, kind), "sha256")[:16]
    return _DATAGRAM.pack(_MARK, number, kind, signature)


def _read(datagram: bytes) -> tuple[int, int] | None:
    """The number and kind of a datagram, whose signature is not yet checked; None if it is no heartbeat."""
    if len(datagram) != _DATAGRAM.size:
        return None
    mark, number, kind, _ = _DATAGRAM.unpack(datagram)
    return (number, kind) if mark == _MARK else None


def _address(place: str) -> tuple[str, int] | None:
    """The address of `HOST PORT`, as in `ReachedAt`; None for a socket in a folder."""
    host, _, port = place.rpartition(" ")
    return (host, int(port)) if host and port.isdecimal() and int(port) else None


def _family(address: tuple[str, int]) -> int:
    return socket.AF_INET6 if ":" in address[0] else socket.AF_INET


def _socket_for(address: tuple[str, int]) -> socket.socket:
    made = socket.socket(_family(address), socket.SOCK_DGRAM)
    made.setblocking(False)
    return made


class Answering:
    """An agent's end: a thread that answers questions at these addresses until `close`.

    `heard` is called with the name of the manager whose question came. `places` has the addresses that could be opened,
    written `HOST PORT`; an address whose UDP port is taken is left out.
    """

    def __init__(self, places: Iterable[str], heard: Callable[[str], None]) -> None:
        self._heard = heard
        self._obeyed: tuple[str, bytes] | None = None
        self._latest = 0
        """The highest number that was asked; a recorded question does not count again as a sign of the manager."""
        self._is_closed = False
        self._ends, self._waker = Ends(), Waker()
        self._ends.watch(self._waker.socket, self._waker.hear)
        self._sockets: list[socket.socket] = []
        opened = []
        for place, address in sorted((place, _address(place)) for place in places):
            if address is not None and self._open(address):
                opened.append(place)
        self.places = tuple(opened)
        self._thread = threading.Thread(target=self._run, name="cfgplan-heartbeats", daemon=True)
        self._thread.start()

    def obey(self, manager: str, secret: bytes) -> None:
        """Answer the questions that are signed with this secret, and no others. Thread-safe."""
        self._latest, self._obeyed = 0, (manager, secret)

    def close(self) -> None:
        """End the thread."""
        self._is_closed = True
        self._waker.wake()
        self._thread.join()
        for end in self._sockets:
            end.close()
        self._waker.close()
        self._ends.close()

    def _open(self, address: tuple[str, int]) -> bool:
        end = _socket_for(address)
        try:
            end.bind(address)
        except OSError:
            end.close()
            return False
        self._sockets.append(end)
        self._ends.watch(end, lambda: self._answer_next(end))
        return True

    def _run(self) -> None:
        while not self._is_closed:
            self._ends.wait(None)

    def _answer_next(self, end: socket.socket) -> None:
        with suppress(OSError):  # nothing came, or there is no way back
            self._answer(end, *end.recvfrom(_MOST_BYTES))

    def _answer(self, end: socket.socket, datagram: bytes, address: tuple[Any, ...]) -> None:
        known, obeyed = _read(datagram), self._obeyed
        if known is None or obeyed is None:
            return
        (number, kind), (manager, secret) = known, obeyed
        if kind != _QUESTION or not hmac.compare_digest(datagram, _signed(secret, number, _QUESTION)):
            return
        if number > self._latest:
            self._latest = number
            self._heard(manager)
        end.sendto(_signed(secret, number, _ANSWER), address)


@dataclass(slots=True)
class _Asked:
    """An agent that is asked at some addresses; the one that answered last is asked alone."""

    name: str
    secret: bytes
    addresses: tuple[tuple[str, int], ...]
    answered_s: float
    due_s: float
    chosen: tuple[str, int] | None = None
    round_trip_s: float | None = None
    """The seconds from the last answered question to its answer."""
    urgent_until_s: float = -inf
    """Until then it is asked once a round trip, as long as it is silent."""
    open: dict[int, float] = field(default_factory=dict)
    """The questions without an answer, with their times."""

    @property
    def least_pause_s(self) -> float:
        """From one urgent question to the next."""
        return max(_LEAST_PATIENCE_S / _ROUND_TRIPS, self.round_trip_s or 0.0)


class Asking:
    """The manager's end: a thread that asks agents until `close`. `heard` is called with an agent's name, the time of a
    question and that of its answer.
    """

    def __init__(self, heard: Callable[[str, float, float], None]) -> None:
        self._heard = heard
        self._lock = threading.Lock()
        self._agents: dict[str, _Asked] = {}
        self._number = 0
        self._sockets: dict[int, socket.socket] = {}
        """By address family."""
        self._ends, self._waker = Ends(), Waker()
        self._ends.watch(self._waker.socket, self._waker.hear)
        self._is_closed = False
        self._thread = threading.Thread(target=self._run, name="cfgplan-heartbeats", daemon=True)
        self._thread.start()

    def ask(self, name: str, places: Iterable[str], secret: bytes) -> None:
        """Ask an agent from now on, at places written `HOST PORT`. Thread-safe."""
        addresses = tuple(address for place in sorted(places) if (address := _address(place)) is not None)
        now_s = time.monotonic()
        with self._lock:
            self._agents.pop(name, None)
            if addresses:
                self._agents[name] = _Asked(name, secret, addresses, now_s, now_s)
        self._waker.wake()

    def ask_at_once(self, name: str) -> float:
        """Ask an agent at once, and again each round trip until it answers or its time is over. Thread-safe.

        Returns the seconds within which an answer has to come; 0 if it has never answered.
        """
        with self._lock:
            one = self._agents.get(name)
            if one is None or one.round_trip_s is None:
                return 0.0
            now_s, patience_s = time.monotonic(), _ROUND_TRIPS * one.least_pause_s
            one.answered_s, one.due_s, one.urgent_until_s = -inf, now_s, now_s + patience_s
        self._waker.wake()
        return patience_s

    def forget(self, name: str) -> None:
        """Ask an agent no more. Thread-safe."""
        with self._lock:
            self._agents.pop(name, None)

    def close(self) -> None:
        """End the thread."""
        self._is_closed = True
        self._waker.wake()
        self._thread.join()
        for end in self._sockets.values():
            end.close()
        self._waker.close()
        self._ends.close()

    def _run(self) -> None:
        while not self._is_closed:
            with self._lock:
                due_s = min((one.due_s for one in self._agents.values()), default=None)
            self._ends.wait(None if due_s is None else max(0.0, due_s - time.monotonic()))
            self._ask_due(time.monotonic())

    def _ask_due(self, now_s: float) -> None:
        with self._lock:
            due = [one for one in self._agents.values() if one.due_s <= now_s]
            for one in due:
                is_silent = now_s - one.answered_s > _PATIENT_PERIODS * sign_period_s()
                pause_s = sign_period_s() / (_HASTE if is_silent else 1)
                is_urgent = is_silent and now_s < one.urgent_until_s
                one.due_s = now_s + (min(pause_s, one.least_pause_s) if is_urgent else pause_s)
                one.open = {number: at_s for number, at_s in one.open.items() if now_s - at_s < LEASE_S}
                self._number += 1
                one.open[self._number] = now_s
                addresses = one.addresses if is_silent or one.chosen is None else (one.chosen,)
                for address in addresses:
                    with suppress(OSError):  # the network is not there
                        self._socket_to(address).sendto(_signed(one.secret, self._number, _QUESTION), address)

    def _socket_to(self, address: tuple[str, int]) -> socket.socket:
        family = _family(address)
        if family not in self._sockets:
            end = self._sockets[family] = _socket_for(address)
            self._ends.watch(end, lambda: self._take_next(end))
        return self._sockets[family]

    def _take_next(self, end: socket.socket) -> None:
        with suppress(OSError):  # nothing came, or the agent's port is closed
            self._take(*end.recvfrom(_MOST_BYTES))

    def _take(self, datagram: bytes, address: tuple[str, int]) -> None:
        known, now_s = _read(datagram), time.monotonic()
        if known is None or known[1] != _ANSWER:
            return
        with self._lock:
            one = next((one for one in self._agents.values() if known[0] in one.open), None)
            if one is None or not hmac.compare_digest(datagram, _signed(one.secret, known[0], _ANSWER)):
                return
            asked_s = one.open.pop(known[0])
            one.answered_s, one.round_trip_s = now_s, now_s - asked_s
            one.chosen = next((own for own in one.addresses if own == address[:2]), one.chosen)
        self._heard(one.name, asked_s, now_s)
