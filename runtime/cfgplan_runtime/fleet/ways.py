"""An agent's way to the others: directly, or through one of them that is linked with more of them."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from ipaddress import ip_address
from pathlib import Path
from urllib.parse import unquote

import msgspec

from cfgplan.domain import MANAGER
from cfgplan.errors import InputError
from cfgplan_runtime.fleet.certificates import passing_on
from cfgplan_runtime.fleet.links import LEASE_S, PRIVATE, config, host_and_port
from cfgplan_runtime.streams.crossing import host_key
from cfgplan_runtime.streams.zenoh_link import ZenohLink

_WAY_LOOK_S = LEASE_S / 2
_REACH_ANSWER_S = 1.0
"""Seconds within which another agent must answer with its addresses."""


def alive_key(host: str | None) -> str:
    """The key below which a host's agent is alive, and gives signs of life; None means any host."""
    return f"{host_key(host)}/alive"


def reach_key(host: str | None) -> str:
    """The key at which an agent answers with its addresses; None means any host. A manager's answer is empty."""
    return f"{host_key(host)}/reach"


class ReachedAt(msgspec.Struct, frozen=True):
    """The addresses of an agent and of its connections, each with a port, or the path of a socket."""

    listens: frozenset[str] = frozenset()
    connects: frozenset[str] = frozenset()
    hears: frozenset[str] = frozenset()
    """The keys of agents and managers that are alive."""
    id: str = ""
    """Zenoh's id of its session."""
    is_through: bool = False
    """Whether it reaches the others through one of them."""

    def is_mutual(self, other: ReachedAt) -> bool:
        """Whether two agents connect to each other: Zenoh may then mix up the names of their streams."""
        return bool(self.connects & other.listens and other.connects & self.listens)


def reach(listen: Sequence[str], connect: Sequence[str]) -> ReachedAt:
    """The places of these endpoints. An endpoint for all addresses of this computer becomes all of them but
    loopback.
    """
    listens, connects = (frozenset(place for one in ends for place in _places(one)) for ends in (listen, connect))
    return ReachedAt(listens, connects)


def _places(endpoint: str) -> Iterator[str]:
    protocol, _, address = endpoint.partition("/")
    host, port = host_and_port(address)
    if protocol == PRIVATE:
        yield address
    elif host in ("0.0.0.0", "::"):
        import psutil

        for card in psutil.net_if_addrs().values():
            yield from (f"{one.address} {port}" for one in card if not one.address.startswith(("127.", "::1")))
    else:
        with suppress(OSError):  # the name is not known yet
            yield from {f"{found[4][0]} {port}" for found in socket.getaddrinfo(host, None)}


def _endpoint(place: str, protocol: str) -> str | None:
    """The endpoint of a place where an agent listens; None if others can't connect to it."""
    host, _, port = place.rpartition(" ")
    if not host:
        return f"{PRIVATE}/{place}"
    with suppress(ValueError):
        address = ip_address(host)
        if not address.is_link_local:
            return f"{protocol}/{f'[{host}]' if address.version == 6 else host}:{port}"
    return None


class RouteWatch:
    """Keeps a host's agent connected with all others, through one of them if direct links are missing. Has a thread.

    Each check asks one of the known agents for the agents that it knows. If it knows all agents known here, and for the
    time of a lease one more, the link goes through it, until this host is linked with all again. If two hosts miss each
    other, the one whose name comes earlier waits longer, so that normally the other one acts for both. `failed` is
    called with the error if this agent and another connect to each other, `say` with messages for the user.
    """

    def __init__(
        self,
        link: ZenohLink,
        key: str,
        listen: Sequence[str],
        connect: Sequence[str],
        certificates: Path | None,
        failed: Callable[[InputError], None],
        say: Callable[[str], None],
    ) -> None:
        self._link, self._key, self._host = link, key, host_of(key)
        self._connect, self._certificates = connect, certificates
        self._failed, self._say = failed, say
        self._reach = reach(listen, connect)
        self._heard: set[str] = set()
        """The keys that are alive."""
        self._through: str | None = None
        self._turn = 0
        """Selects the agent that is asked next."""
        self._missed_s: dict[str, float] = {}
        """For each key that is not alive here: the time since which the asked agent reports it."""
        self._linked_looks = 0
        self._refused: set[str] = set()
        self._is_closed = threading.Event()
        link.answer(reach_key(self._host), lambda: msgspec.json.encode(self._told()))
        link.watch(f"{alive_key(None)}/*", self._note)
        threading.Thread(target=self._run, daemon=True).start()

    def close(self) -> None:
        """Tell the thread to end."""
        self._is_closed.set()

    def _told(self) -> ReachedAt:
        return msgspec.structs.replace(
            self._reach, hears=frozenset(self._heard), id=self._link.id, is_through=self._through is not None
        )

    def _note(self, key: str, is_alive: bool) -> None:
        """Called by threads of the link."""
        (self._heard.add if is_alive else self._heard.discard)(key)

    def _asked(self, key: str) -> ReachedAt | None:
        """The answer of another agent; None if it does not answer."""
        return next(self._answers(reach_key(host_of(key))), None)

    def _answers(self, keys: str) -> Iterator[ReachedAt]:
        """The answers of agents. Answers of another version are left out."""
        for _, answer in list(self._link.ask(keys, _REACH_ANSWER_S)):
            with suppress(msgspec.MsgspecError):
                yield msgspec.json.decode(answer, type=ReachedAt)

    def _run(self) -> None:
        while not self._is_closed.wait(_WAY_LOOK_S):
            others = {key for key in self._heard.copy() if host_of(key) != self._host}
            if self._through is not None:
                self._look_back(others)
            elif hosts := sorted(key for key in others if host_of(key) != MANAGER):
                self._look(hosts[self._turn % len(hosts)], others)

    def _look(self, asked: str, others: set[str]) -> None:
        """Ask an agent for the agents that it knows. If two connect to each other, the one whose name comes
        later ends.
        """
        told, name = self._asked(asked), host_of(asked)
        if told is not None and self._reach.is_mutual(told) and name < self._host:
            mend = f"leave out --connect to {name} here, or the one to {self._host} there"
            self._failed(InputError.of(f"{self._host} and {name} connect to each other", mend=mend))
        now_s = time.monotonic()
        missed = set() if told is None else {key for key in told.hears - others if host_of(key) != self._host}
        self._missed_s = {key: self._missed_s.get(key, now_s) for key in missed}
        late = sorted(key for key, since_s in self._missed_s.items() if now_s - since_s >= self._patience_s(key))
        if late or not missed:
            self._turn += 1
            self._missed_s.clear()
        hears_enough = told is not None and not told.is_through and others <= told.hears | {asked}
        if told is not None and hears_enough and any(self._asked(key) is None for key in late):
            self._go_through(asked, told, ", ".join(map(host_of, late)))

    def _patience_s(self, missed: str) -> float:
        is_first = host_of(missed) == MANAGER or host_of(missed) < self._host
        return LEASE_S if is_first else 2 * LEASE_S

    def _go_through(self, key: str, told: ReachedAt, missed: str) -> None:
        name, protocol = host_of(key), "tcp"
        if self._certificates is not None:
            protocol = "tls"
            if name not in passing_on(self._certificates):
                if name not in self._refused:
                    self._say(
                        f"{missed}: can be reached only through {name}, which may not relay (certificates --passes-on)"
                    )
                self._refused.add(name)
                return
        named = [one for one in self._connect if not told.listens.isdisjoint(_places(one))]
        found = (_endpoint(place, protocol) for place in sorted(told.listens - self._reach.listens))
        endpoints = list(dict.fromkeys([*named, *(one for one in found if one is not None)]))
        with suppress(InputError):  # it can't be reached
            self._link.go_through(config(connect=endpoints, certificates=self._certificates, mode="client"))
            self._through, self._linked_looks = key, 0
            self._say(f"{missed}: can be reached only through {name}, and so are all others now")

    def _look_back(self, others: set[str]) -> None:
        """Use direct links again if all known agents were linked for a lease, or the agent in between was lost."""
        told = list(self._answers(reach_key(None)))
        is_heard = others <= self._link.alive(f"{alive_key(None)}/*", directly=True)
        is_linked = is_heard and self._link.linked >= {one.id for one in told} - {self._link.id, ""}
        self._linked_looks = self._linked_looks + 1 if is_linked or self._through not in others else 0
        if self._linked_looks * _WAY_LOOK_S > LEASE_S:
            self._link.go_directly()
            self._through = None
            self._say("others are reached directly again")


def host_of(key: str) -> str:
    """The host whose agent is alive under a key; MANAGER for a manager's."""
    return unquote(key.split("/")[1])
