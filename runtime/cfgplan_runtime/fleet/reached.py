"""Access to a fleet for commands, from any computer through one of its agents: its runs and its topics."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import msgspec

from cfgplan.domain import MANAGER
from cfgplan_runtime.errors import NoSuchRunError, NoSuchTopicError
from cfgplan_runtime.fleet.clocks import CALLS, CALLS_AGAIN, CLOCK_S, HostClock, corrected
from cfgplan_runtime.fleet.links import config
from cfgplan_runtime.fleet.orders import Held, TopicsReport, held_key, topics_key
from cfgplan_runtime.fleet.tunnels import CONTROL, TunnelClient
from cfgplan_runtime.fleet.ways import alive_key, host_of
from cfgplan_runtime.streams.closable import Closable
from cfgplan_runtime.streams.subscription import SubscriptionToTopic
from cfgplan_runtime.streams.topic_names import not_published
from cfgplan_runtime.streams.zenoh_link import ZenohLink

_REACH_S = 5.0
"""Seconds within which the wanted run must be found, and each host must have reported its topics."""
_ANSWER_S = 1.0
"""Seconds that one question for the topics of all hosts may take."""
_REACH_LOOK_S = 0.02


class ReachedFleet(Closable):
    """A fleet that is reached through the first agent that answers at `connect`; a context manager.

    If agents have certificates, `certificates` is the manager's folder. Raises InputError if no agent answers.
    """

    def __init__(self, connect: Sequence[str], certificates: Path | None = None) -> None:
        self._alive: set[str] = set()
        """The keys of the agents and managers that are alive."""
        self._offsets_ns: dict[str, int] = {}
        """For each host with subscribed topics: the difference of its run's clock from the monotonic clock here."""
        self._is_closed = threading.Event()
        self._link = ZenohLink(config(connect=connect, certificates=certificates, mode="client"))
        try:
            self._client = TunnelClient(self._link)
            self._link.watch(f"{alive_key(None)}/*", self._note_life)
            known = self._link.alive(f"{alive_key(None)}/*")
            _until(lambda: known <= self._alive, _ANSWER_S)
        except BaseException:
            self._link.close()
            raise

    @property
    def hosts(self) -> list[str]:
        """The hosts whose agents are alive."""
        return sorted({host_of(key) for key in self._alive.copy()} - {MANAGER})

    @property
    def runs(self) -> list[str]:
        """The ids of the runs that are alive."""
        return self._lives(MANAGER)

    def control(self, run: str | None = None) -> tuple[str, socket.socket]:
        """Reach a run's control socket. `run` is its id, needed only if several are alive.

        Returns the id and a connected socket. Raises NoSuchRunError, which names the live runs.
        """
        _until(lambda: bool(self.runs) if run is None else run in self.runs, _REACH_S)
        runs = self.runs
        if not runs:
            mend = "start one with `cfgplan run ENV`; with certificates, --connect an agent that may pass on"
            raise NoSuchRunError(f"no live run has the hosts {', '.join(self.hosts)}: {mend}")
        if run is None and len(runs) > 1:
            raise NoSuchRunError(f"several runs are live: name one by --run: {', '.join(runs)}")
        if run is not None and run not in runs:
            raise NoSuchRunError(f"no run {run!r} is live; live runs: {', '.join(runs)}")
        return run or runs[0], self._client.connect(MANAGER, run or runs[0], CONTROL)

    def subscribe(
        self, topic: str, *, run: str | None = None, timeout_s: float | None = None, wait_s: float = 0.0
    ) -> SubscriptionToTopic:
        """Subscribe to a topic of any host; see `cfgplan_runtime.subscribe`. Raises NoSuchTopicError.

        Waits for living hosts that have not reported their topics yet, whatever `wait_s` is.
        """
        end_s, patience_s = time.monotonic() + wait_s, max(0.0, _REACH_S - wait_s)
        while True:
            told = self._told()
            found = _places(told, topic, run)
            if len(runs := sorted({one for one, _ in found})) > 1:
                raise NoSuchTopicError(f"several runs have topic {topic!r}: name one of {', '.join(runs)} (--run)")
            with suppress(NoSuchTopicError):  # the host has just come or gone
                if found:
                    return SubscriptionToTopic(topic, _FleetPlace(self, run), timeout_s=timeout_s)
            is_whole = not found and told.keys() >= set(self.hosts)
            if time.monotonic() > (end_s if is_whole else end_s + patience_s):
                raise NoSuchTopicError(_why_not(topic, found, told))
            time.sleep(_REACH_LOOK_S)

    def held(self) -> dict[str, Held]:
        """What each host that answers holds; nothing is changed by asking."""
        return {
            host_of(key): msgspec.json.decode(answer, type=Held)
            for key, answer in self._link.ask(held_key(None), _ANSWER_S)
        }

    def places(self, topic: str, run: str | None) -> list[tuple[str, str]]:
        """The (run, host) pairs that have a topic."""
        return _places(self._told(), topic, run)

    def connect(self, host: str, topic: str) -> socket.socket | None:
        """A socket that gives a topic of a host; None if the host is gone."""
        lives = self._lives(host)
        return self._client.connect(host, lives[0], topic) if lives else None

    def now_ns(self, host: str) -> int:
        """The present time on the clock of a host's run. From the first call on, the clock is read repeatedly."""
        if host not in self._offsets_ns:
            is_first = not self._offsets_ns
            self._measure(host, CALLS)
            if is_first:
                threading.Thread(target=self._measure_again, name="cfgplan-clocks", daemon=True).start()
        return time.monotonic_ns() + self._offsets_ns[host]

    def close(self) -> None:
        """Close all connections."""
        self._is_closed.set()
        self._client.close()
        self._link.close()

    def _measure_again(self) -> None:
        while not self._is_closed.wait(CLOCK_S):
            for host in list(self._offsets_ns):
                self._measure(host, CALLS_AGAIN)

    def _measure(self, host: str, calls: int) -> None:
        """Record the difference of the clock of a host's run. If the host has never answered, the time of
        day is used.
        """
        known_ns, clock = self._offsets_ns.get(host), HostClock(time.monotonic_ns)
        reading = next((clock.read_host(self._link, host, life, calls) for life in self._lives(host)), None)
        told = self._told(host).get(host)
        if reading is not None and told is not None:
            measured_ns = reading.ahead_ns - told.ahead_ns
            known_ns = measured_ns if known_ns is None else corrected(known_ns, measured_ns, reading.doubt_ns)
        self._offsets_ns[host] = time.time_ns() - time.monotonic_ns() if known_ns is None else known_ns

    def _told(self, host: str | None = None) -> dict[str, TopicsReport]:
        """Return the topic status that a host reported; of all hosts if None."""
        return {
            host_of(key): msgspec.json.decode(answer, type=TopicsReport)
            for key, answer in self._link.ask(topics_key(host), _ANSWER_S if host is None else _REACH_S)
        }

    def _lives(self, name: str) -> list[str]:
        """The ids of a host's agents that are alive, normally one; for MANAGER those of the runs."""
        return sorted(key.rpartition("/")[2] for key in self._alive.copy() if host_of(key) == name)

    def _note_life(self, key: str, is_alive: bool) -> None:
        """Called by threads of the link."""
        (self._alive.add if is_alive else self._alive.discard)(key)
        if not is_alive:
            self._client.lose(key.rpartition("/")[2])


def _places(told: Mapping[str, TopicsReport], topic: str, run: str | None) -> list[tuple[str, str]]:
    return [(of.run, host) for host, of in sorted(told.items()) if topic in of.topics and run in (None, of.run)]


def _why_not(topic: str, found: Sequence[tuple[str, str]], told: Mapping[str, TopicsReport]) -> str:
    """Why a topic can't be had that was `found` there, or nowhere."""
    if found:
        return f"topic {topic!r} is on {', '.join(host for _, host in found)}, which can't be connected to"
    return not_published(topic, (name for of in told.values() for name in of.topics))


@dataclass(slots=True)
class _FleetPlace:
    """The hosts of a run, or all hosts if that is None."""

    fleet: ReachedFleet
    run: str | None
    host: str = ""
    """The host where the topic was found last."""

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
    """Wait until `is_so()` is true, at most `patience_s` seconds. Returns whether it is."""
    end_s = time.monotonic() + patience_s
    while not is_so():
        if time.monotonic() > end_s:
            return False
        time.sleep(_REACH_LOOK_S)
    return True
