"""The links between the computers of a fleet: Zenoh's configuration, and the addresses that are allowed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from ipaddress import ip_address
from math import inf
from pathlib import Path
from typing import Any, Literal

from cfgplan.errors import InputError
from cfgplan_runtime.fleet.certificates import access_control, tls
from cfgplan_runtime.streams.zenoh_link import LOSSY

LEASE_S = 2.0
"""Seconds of silence after which a host counts as lost. With 1 s a stalled machine was once lost by mistake."""
_SIGNS_PER_LEASE = 8
_LINK_LEASES = 2
"""A link that is silent for half a lease is replaced, because the kernel's attempts become rare. Links that lose
packets are silent at times though they work, and last LOSSY times as long.
"""
_LATE_SIGNS, MISSED_SIGNS = 2, 4
"""A sign of life is late after two periods. A process that was stalled for four may have missed some itself."""
_OPEN_MS, _OPEN_PRIVATE_MS = 3000, 10_000
"""The milliseconds that an attempt to open a link may take. It needs eight messages in turn, which is 0.8 s at a delay
of 100 ms, and more if some are lost. An attempt from before the end of a cut may end only then. Links within one
computer are never cut.
"""
STALLED_S = 20.0
"""The most seconds for which heartbeats keep a host whose link passes nothing. A link that loses 20 % of all packets,
with a delay of 100 ms, was silent for 8.2 s at most in 400 s.
"""
REACH_S = 5.0
_LANES = {"interactive_high": 16, "data_high": 16, "data_low": 16}
"""The batches of 64 kB that may wait in each of Zenoh's lanes for a full link: the most that Zenoh allows. Its default,
2, has no room for an image, nor for 3 small elements. Frames without room are dropped, and sent again 0.25 s later.
"""
_SEND_BUFFER = 1 << 18
"""Half of the bytes that may wait in a link's socket, since Linux allows twice as many. At 80 Mbit/s they take 52 ms,
and no message overtakes them. With half as many, 3 of 8 streams of images at 147 Mbit/s fell behind on a busy computer.
"""
PRIVATE = "unixsock-stream"
"""The protocol of links within one computer: a socket in a folder that only its user can enter."""

Config = dict[str, Any]


def config(
    listen: Sequence[str] = (),
    connect: Sequence[str] = (),
    certificates: Path | None = None,
    *,
    mode: Literal["peer", "client"] = "peer",
    reach_s: float = REACH_S,
) -> Config:
    """Zenoh's configuration of one session; endpoints are written `tcp/192.168.1.5:7447` or `unixsock-stream/PATH`.

    In mode "peer" every computer needs a link with every other. A "client" goes through the first of the others that it
    reaches, and fails if it reaches none within `reach_s` seconds. (Routers are not used: when computers come and go at
    the same moment, Zenoh's routers overlook some for good, in 2 of 60 trials, and at times they panic when a link
    between two of them is closed. A peer forwards for clients only, and did so in 60 of 60 trials.) With
    `certificates`, a host's folder, all links to other computers are written `tls/192.168.1.5:7447`. Raises InputError
    for an endpoint that other computers could reach without certificates.
    """
    for endpoint in listen if certificates is None else ():
        _refuse_strangers(endpoint)
    secured = {} if certificates is None else {"access_control": access_control(certificates)}
    socket_options = {"so_sndbuf": _SEND_BUFFER}
    is_private = all(endpoint.startswith(f"{PRIVATE}/") for endpoint in (*listen, *connect))
    link: Config = {
        "tx": {
            "lease": round(LEASE_S * 1000) // _LINK_LEASES * LOSSY,
            "keep_alive": _SIGNS_PER_LEASE // _LINK_LEASES * LOSSY,
            "queue": {"size": _LANES},
        },
        "tcp": socket_options,
    }
    if certificates is not None:
        link |= {"protocols": ["tls"], "tls": tls(certificates) | socket_options}
    return {
        "mode": mode,
        "listen": {"endpoints": list(listen)},
        "connect": {
            "endpoints": list(connect),
            "timeout_ms": round(reach_s * 1000) if mode == "client" else -1,
            "exit_on_failure": mode == "client",
            "retry": {"period_init_ms": 100, "period_max_ms": 200, "period_increase_factor": 1.5},
        },
        "scouting": {"delay": 0, "multicast": {"enabled": False}, "gossip": {"enabled": False}},
        "transport": {
            "link": link,
            "unicast": {"open_timeout": _OPEN_PRIVATE_MS if is_private else _OPEN_MS},
            # Containers of one computer share memory, but not always the files that are needed to read it.
            "shared_memory": {"enabled": False},
        },
        **secured,
    }


def sign_period_s() -> float:
    """Seconds from one of an agent's signs of life to the next."""
    return LEASE_S / _SIGNS_PER_LEASE


@dataclass(slots=True)
class Pulse:
    """The arrival of a host's signs of life over its link, and of heartbeats, in seconds of this process's clock."""

    last_s: float
    steady_s: float
    """The time since which no sign was late."""
    beat_s: float = -inf
    """The arrival of the last heartbeat."""
    ended_s: float = -inf
    """The time at which its links ended last."""
    gone_s: float = inf
    """The time at which a host whose links have ended is lost, unless it gives a sign of life or answers before."""

    def note(self, now_s: float) -> None:
        """Note a sign of life."""
        self.gone_s = inf
        if now_s - self.last_s > _LATE_SIGNS * sign_period_s():
            self.steady_s = now_s
        self.last_s = max(self.last_s, now_s)

    def note_beat(self, asked_s: float, now_s: float) -> None:
        """Note a heartbeat: the answer to a question of the time `asked_s`."""
        self.beat_s = now_s
        if asked_s >= self.ended_s:
            self.gone_s = inf

    def note_end(self, now_s: float, patience_s: float) -> None:
        """Note that its links have ended: a living agent answers within `patience_s` seconds."""
        self.ended_s, self.gone_s = now_s, now_s + patience_s

    def is_gone(self, now_s: float) -> bool:
        """Whether its links have ended, and it has neither answered nor given a sign of life in time."""
        return now_s >= self.gone_s

    def is_steady(self, now_s: float) -> bool:
        """Whether no sign is late now, or was within half a lease. If a steady host's links end, its agent has ended,
        or has given the link up because it hears nothing: a link that loses packets may be silent in one direction.
        """
        return now_s - self.last_s <= _LATE_SIGNS * sign_period_s() and now_s - self.steady_s >= LEASE_S / _LINK_LEASES

    def silent_s(self, now_s: float) -> float:
        """Seconds since the last sign or heartbeat. Heartbeats count until the link has been silent for STALLED_S."""
        link_s = now_s - self.last_s
        return link_s if link_s >= STALLED_S else min(link_s, now_s - self.beat_s)

    def is_lost(self, now_s: float) -> bool:
        return self.silent_s(now_s) >= LEASE_S


class Lives:
    """The keys that are alive. A key stays alive while its link is merely replaced, as on a busy computer."""

    def __init__(self) -> None:
        self._pulses: dict[str, Pulse] = {}

    def note(self, key: str, now_s: float, *, is_alive: bool = True) -> None:
        """Record a sign of life, or Zenoh's report about a key."""
        pulse = self._pulses.setdefault(key, Pulse(now_s, now_s))
        if is_alive:
            pulse.note(now_s)
        elif pulse.is_steady(now_s):
            del self._pulses[key]

    def has(self, key: str, now_s: float) -> bool:
        """Whether a key is alive."""
        return key in self._pulses and not self._pulses[key].is_lost(now_s)


def host_and_port(address: str) -> tuple[str, str]:
    """The parts of an address such as 192.168.1.5:7447."""
    host, _, port = address.rpartition(":")
    return host.strip("[]"), port


def _refuse_strangers(endpoint: str) -> None:
    protocol, _, address = endpoint.partition("/")
    if protocol == PRIVATE:
        return
    host, _ = host_and_port(address)
    try:
        is_loopback = host == "localhost" or ip_address(host).is_loopback
    except ValueError:
        is_loopback = False
    if not is_loopback:
        mend = "name a folder of certificates, or listen on tcp/127.0.0.1:7447"
        raise InputError.of(f"{endpoint}: without certificates an agent listens on loopback only", mend=mend)
