"""A fleet as commands reach it from any computer, through one of its agents: its runs and its topics."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import msgspec

from cfgplan.domain import MANAGER
from cfgplan_runtime.errors import NoSuchRunError, NoSuchTopicError
from cfgplan_runtime.fleet.agent import clock_key, topics_key
from cfgplan_runtime.fleet.clocks import CALLS, CALLS_AGAIN, CLOCK_S, HostClock, corrected
from cfgplan_runtime.fleet.links import config
from cfgplan_runtime.fleet.orders import TopicsTold
from cfgplan_runtime.fleet.tunnels import CONTROL, TunnelClient
from cfgplan_runtime.fleet.ways import alive_key, host_of
from cfgplan_runtime.streams.closable import Closable
from cfgplan_runtime.streams.subscription import SubscriptionToTopic
from cfgplan_runtime.streams.zenoh_link import ZenohLink

_REACH_S = 5.0
"""Seconds within which the run that is asked for must be found, and a host tells which run it obeys."""
_ANSWER_S = 1.0
"""Seconds within which all hosts tell their topics, and one answers a question for its clock."""
_TOPIC_LOOK_S, _FIRST_TOPICS_S = 0.02, 0.5
"""Seconds between two looks for a topic, and how long it is looked for where no longer wait is asked for."""


class ReachedFleet(Closable):
    """A fleet, by the endpoints of some of its agents; a context manager. Raises InputError if none can be reached.

    Where agents have certificates, `certificates` is the folder of the manager's.
    """

    def __init__(self, connect: Sequence[str], certificates: Path | None = None) -> None:
        self._alive: set[str] = set()
        """The keys of the agents and managers that are alive."""
        self._offsets_ns: dict[str, int] = {}
        """By host whose topics are heard: how far the clock of its run is ahead of the monotonic one here."""
        self._is_closed = threading.Event()
        self._link = ZenohLink(config(connect=connect, certificates=certificates, mode="client"))
        self._client = TunnelClient(self._link)
        self._link.watch(f"{alive_key(None)}/*", self._note_life)
        known = self._link.alive(f"{alive_key(None)}/*")
        _until(lambda: known <= self._alive, _ANSWER_S)

    @property
    def hosts(self) -> list[str]:
        """The hosts whose agents are alive."""
        return sorted({host_of(key) for key in self._alive.copy()} - {MANAGER})

    @property
    def runs(self) -> list[str]:
        """The ids of the runs that are alive."""
        return self._lives(MANAGER)

    def control(self, run: str | None = None) -> tuple[str, socket.socket]:
        """A run, and a socket that is connected to its control socket; the id is needed only if there are several.

        Raises NoSuchRunError, which names the live runs.
        """
        _until(lambda: bool(self.runs) if run is None else run in self.runs, _REACH_S)
        runs = self.runs
        if not runs:
            mend = "start one with `cfgplan run ENV`; with certificates, --connect an agent that may pass on"
            raise NoSuchRunError(f"no run is seen that has the hosts {', '.join(self.hosts)}: {mend}")
        if run is None and len(runs) > 1:
            raise NoSuchRunError(f"several runs are live: name one by --run: {', '.join(runs)}")
        if run is not None and run not in runs:
            raise NoSuchRunError(f"no run {run!r} is live; there is {', '.join(runs)}")
        return run or runs[0], self._client.connect(MANAGER, run or runs[0], CONTROL)

    def subscribe(
        self, topic: str, *, run: str | None = None, timeout_s: float | None = None, wait_s: float = 0.0
    ) -> SubscriptionToTopic:
        """Subscribe to a topic of any host; see `cfgplan_runtime.subscribe`. Raises NoSuchTopicError."""
        end_s = time.monotonic() + max(wait_s, _FIRST_TOPICS_S)
        while True:
            found = self.places(topic, run)
            if len(runs := sorted({told for told, _ in found})) > 1:
                raise NoSuchTopicError(f"several runs have topic {topic!r}: name one of {', '.join(runs)} (--run)")
            with suppress(NoSuchTopicError):  # its host has just come, or gone
                if found:
                    return SubscriptionToTopic(topic, _FleetPlace(self, run), timeout_s=timeout_s)
            if time.monotonic() > end_s:
                raise NoSuchTopicError(self._why_not(topic, [host for _, host in found]))
            time.sleep(_TOPIC_LOOK_S)

    def places(self, topic: str, run: str | None) -> list[tuple[str, str]]:
        """The runs, with the hosts, that have a topic."""
        return [
            (told.run, host)
            for host, told in sorted(self._told().items())
            if topic in told.topics and run in (None, told.run)
        ]

    def connect(self, host: str, topic: str) -> socket.socket | None:
        """A socket that gives a topic of a host; None if the host is gone."""
        lives = self._lives(host)
        return self._client.connect(host, lives[0], topic) if lives else None

    def now_ns(self, host: str) -> int:
        """The time by the clock of the run that a host has, which is measured, again and again from the first call."""
        if host not in self._offsets_ns:
            is_first = not self._offsets_ns
            self._measure(host, CALLS)
            if is_first:
                threading.Thread(target=self._measure_again, name="cfgplan-clocks", daemon=True).start()
        return time.monotonic_ns() + self._offsets_ns[host]

    def close(self) -> None:
        """Close all that is connected."""
        self._is_closed.set()
        self._client.close()
        self._link.close()

    def _measure_again(self) -> None:
        while not self._is_closed.wait(CLOCK_S):
            for host in list(self._offsets_ns):
                self._measure(host, CALLS_AGAIN)

    def _measure(self, host: str, calls: int) -> None:
        """Note how far the clock of a host's run is ahead; by the time of day if the host does not answer."""
        known_ns = self._offsets_ns.get(host)
        clock = HostClock(time.monotonic_ns)
        reading = clock.read(lambda: (answer for _, answer in self._link.ask(clock_key(host), _ANSWER_S)), calls)
        told = self._told(host).get(host)
        if reading is not None and told is not None:
            measured_ns = reading.ahead_ns - told.ahead_ns
            known_ns = measured_ns if known_ns is None else corrected(known_ns, measured_ns, reading.doubt_ns)
        self._offsets_ns[host] = time.time_ns() - time.monotonic_ns() if known_ns is None else known_ns

    def _told(self, host: str | None = None) -> dict[str, TopicsTold]:
        """What each host, or one of them, tells of its topics."""
        return {
            host_of(key): msgspec.json.decode(answer, type=TopicsTold)
            for key, answer in self._link.ask(topics_key(host), _ANSWER_S if host is None else _REACH_S)
        }

    def _why_not(self, topic: str, hosts: Sequence[str]) -> str:
        """Why a topic can't be had that these hosts tell of."""
        if hosts:
            return f"topic {topic!r} is on {', '.join(hosts)}, which can't be connected to"
        there = ", ".join(sorted({name for told in self._told().values() for name in told.topics}))
        return f"nothing publishes topic {topic!r}; there is {there or 'no topic at all'}"

    def _lives(self, name: str) -> list[str]:
        """What tells the agents of a host that are alive from one another; of MANAGER, the runs."""
        return sorted(key.rpartition("/")[2] for key in self._alive.copy() if host_of(key) == name)

    def _note_life(self, key: str, is_alive: bool) -> None:
        """Called by threads of the link."""
        (self._alive.add if is_alive else self._alive.discard)(key)
        if not is_alive:
            self._client.lose(key.rpartition("/")[2])


@dataclass(slots=True)
class _FleetPlace:
    """The hosts of a fleet that obey a run, or any."""

    fleet: ReachedFleet
    run: str | None
    host: str = ""
    """Where the topic was found last."""

    @property
    def name(self) -> str:
        return self.run or "of the fleet"

    def connect(self, topic: str) -> socket.socket | None:
        found = self.fleet.places(topic, self.run)
        if not found:
            return None
        self.host = found[0][1]
        return self.fleet.connect(self.host, topic)

    def is_alive(self) -> bool:
        return bool(self.fleet.runs)

    def now_ns(self) -> int:
        return self.fleet.now_ns(self.host)


def _until(is_so: Callable[[], bool], patience_s: float) -> bool:
    """Wait until something is so. Returns whether it is."""
    end_s = time.monotonic() + patience_s
    while not is_so():
        if time.monotonic() > end_s:
            return False
        time.sleep(_TOPIC_LOOK_S)
    return True
