"""A manager's view of the hosts of its fleet: their agents, whether these are alive and obey, their messages and
clocks.
"""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from math import inf
from pathlib import Path
from typing import TypeAlias
from urllib.parse import unquote

import msgspec

from cfgplan import __version__
from cfgplan.domain import MANAGER
from cfgplan.errors import InputError
from cfgplan_runtime.fleet import orders
from cfgplan_runtime.fleet.clocks import CALLS, CALLS_AGAIN, CLOCK_S, HostClock, Reading, corrected, has_moved
from cfgplan_runtime.fleet.heartbeats import Asking, new_secret
from cfgplan_runtime.fleet.links import LEASE_S, MISSED_SIGNS, Pulse, sign_period_s
from cfgplan_runtime.fleet.ways import alive_key, reach_key
from cfgplan_runtime.streams.crossing import crossing_key
from cfgplan_runtime.streams.run_folder import is_alive
from cfgplan_runtime.streams.zenoh_link import ZenohLink

_LEAVE_S = 2.0
_MARGIN_S = 1.0
"""Seconds by which the answers of hosts that were noticed in time may be late."""


@dataclass(slots=True, eq=False)
class HostState:
    """A host whose agent is alive. It has joined (`is_there`) once its clock is known."""

    name: str
    life: str
    """The id of this agent's process; a later agent of the same name has another."""
    channel: orders.ReliableChannel[orders.FromAgent]
    pulse: Pulse
    secret: bytes
    """Signs the heartbeats of this session."""
    is_there: bool = False
    reading: Reading | None = None
    """The last reading of its clock."""
    ahead_ns: int | None = None
    """The difference of its clock from the run's, as last sent to the agent."""
    shown_ns: int = 0
    """The difference of its time of day from the local one, as last reported."""
    run: Path | None = None
    """The folder with the sockets of its topics, if it is on this computer."""
    held: orders.Held = field(default_factory=orders.Held)
    """The units and wires that it had when it sent Welcome."""
    states: dict[str, orders.HeldState] = field(default_factory=dict)
    """The last states of its units by name, when it sent Welcome."""


class AgentNews(msgspec.Struct, frozen=True):
    """A change of a host's agent; each kind has a class."""

    host: HostState


class AgentJoined(AgentNews, frozen=True):
    """A host has joined."""

    day_ahead_ns: int


class AgentClockSet(AgentNews, frozen=True):
    """A host's time of day has changed since the last report."""

    day_ahead_ns: int


class AgentGone(AgentNews, frozen=True):
    """A host's agent is dead, or does not obey. The host may not have joined yet."""

    cause: str


class AgentMessage(AgentNews, frozen=True):
    """An agent has sent a message."""

    message: orders.FromAgent


@dataclass(frozen=True, slots=True)
class _Beat:
    """A heartbeat of a host."""

    name: str
    asked_s: float
    at_s: float


@dataclass(frozen=True, slots=True)
class _Measured:
    """A reading of a host's clock; None if it does not answer."""

    host: HostState
    reading: Reading | None


_Arrival: TypeAlias = "tuple[str, bytes, bytes] | tuple[str, bool] | tuple[str, float] | _Measured | _Beat | None"


class Presence:
    """The hosts of the manager `run` that are linked with it. Call all methods but `wake` from the thread that made it.

    Other hosts of the network are ignored: they may belong to another run. An agent is greeted only if no other agent
    of its name gives signs of life.

    `tell_clock` is called with the nanoseconds by which the run's clock is ahead of the monotonic clock of this
    computer. The run's clock may be an earlier manager's.
    """

    def __init__(self, link: ZenohLink, run: str, tell_clock: Callable[[int], None]) -> None:
        self._link, self._run, self._tell_clock = link, run, tell_clock
        self._inbox: queue.SimpleQueue[_Arrival] = queue.SimpleQueue()
        self._happened: list[AgentNews] = []
        self._hosts: dict[str, HostState] = {}
        self._clock_offset_ns = time.time_ns() - time.monotonic_ns()
        self._clock = HostClock(lambda: time.monotonic_ns() + self._clock_offset_ns)
        self._run_ahead_ns = 0
        """The difference of this process's clock from the run's, in nanoseconds."""
        self._serial = 0
        self._term = 1
        self._is_beginning = True
        """True until the wait for all hosts is over. Units of a host that joins before are adopted; later ones are
        ended.
        """
        self._takes_over = False
        """Whether hosts are taken from a living manager: only at the beginning, or two managers would take turns."""
        self._own: set[str] = set()
        """The hosts that this manager uses."""
        self._seen: dict[str, str] = {}
        """Hosts that are alive and were not greeted, with the ids of their agents; they may belong to other runs."""
        self._is_greeting = False
        self._has_left = threading.Event()
        self._round_s = inf
        """When this process last handled what had arrived."""
        self._left_alone: dict[str, str] = {}
        """The hosts of agents that are alive but can't be given orders, by the agents' ids."""
        self._refusing: list[HostState] = []
        """Hosts that were found to obey another manager, at the beginning."""
        for kind in (orders.SAY, orders.HEARD, orders.REFUSE):
            link.hear(crossing_key(None, kind, MANAGER, "*"), lambda *came: self._inbox.put(came))
        link.watch(f"{alive_key(None)}/*", lambda *came: self._inbox.put(came))
        link.hear(f"{alive_key(None)}/*", lambda key, *_: self._inbox.put((key, time.monotonic())))
        self._heartbeats = Asking(lambda *beat: self._inbox.put(_Beat(*beat)))
        link.answer(reach_key(MANAGER), lambda: b"{}")
        link.live(f"{alive_key(MANAGER)}/{run}")
        link.give_signs(f"{alive_key(MANAGER)}/{run}", sign_period_s())
        threading.Thread(target=self._measure_again, name="cfgplan-clocks", daemon=True).start()

    @property
    def there(self) -> Mapping[str, HostState]:
        """The hosts that have joined."""
        return {name: host for name, host in self._hosts.items() if host.is_there}

    def find(self, host: str | None) -> HostState | None:
        """The host of this name, or the first one for None. None if it has not joined."""
        if host is None:
            host = min((name for name, one in self._hosts.items() if one.is_there), default="")
        found = self._hosts.get(host)
        return found if found is not None and found.is_there else None

    def greets(self, host: str) -> bool:
        """Whether a host has joined, or was greeted and may still answer."""
        return host in self._hosts

    def say(self, host: str | None, order: orders.Order) -> None:
        """Give an order to a host with the next `wait`. Does nothing if the host is None or has not joined."""
        found = None if host is None else self.find(host)
        if found is not None:
            found.channel.say(order)

    def wake(self) -> None:
        """Make `wait` return. Thread-safe."""
        self._inbox.put(None)

    def wait(self, end_s: float) -> tuple[list[AgentNews], bool]:
        """Wait for changes, until `end_s`. Returns them, and whether `wake` was called."""
        is_awake = self._hear_all()
        while not (is_awake or self._happened or time.monotonic() >= end_s):
            is_awake = self._hear_once(end_s)
        happened, self._happened = self._happened, []
        return happened, is_awake

    def await_all(self, hosts: Sequence[str], wait_s: float, *, takes_over: bool) -> list[AgentNews]:
        """Wait until all hosts have joined, at most `wait_s` seconds. Returns the changes.

        Raises InputError if another manager has a host and this one does not take over (`takes_over`), or reaches fewer
        than half of the hosts. A manager that was just killed seems alive for a lease.
        """
        self._takes_over = takes_over
        self._own |= set(hosts)
        end_s = time.monotonic() + wait_s
        while not self._seen.keys() >= self._own and time.monotonic() < end_s:
            self._hear_once(end_s)
        few = [host for host in hosts if host in self._seen]
        if takes_over and 2 * len(few) < len(hosts):
            message = (
                f"{len(few)} of {len(hosts)} hosts can be reached: a run takes over only if it reaches at least half"
            )
            raise InputError.of(message, mend="run it where more hosts can be reached")
        self._is_greeting = True
        for name in few:
            self._greet(name, self._seen.pop(name), "")
        refused_s = time.monotonic() + LEASE_S + sign_period_s()
        while set(few) - self.there.keys() - set(self._left_alone.values()) and (
            time.monotonic() < max(end_s, refused_s) + _MARGIN_S
        ):
            self._hear_once(end_s + _MARGIN_S)
            if self._refusing and time.monotonic() > refused_s:
                mend = "stop the other run first, or add --take-over"
                raise InputError.of(f"another run has host {self._refusing[0].name!r}", mend=mend)
            if self._refusing:
                time.sleep(sign_period_s())
            while self._refusing:
                host = self._refusing.pop()
                self._greet(host.name, host.life, "another manager had it")
        self._is_beginning = self._takes_over = False
        self._begin_clocks()
        happened, self._happened = self._happened, []
        return happened

    def take(self, hosts: Collection[str]) -> tuple[list[str], list[str]]:
        """Use these hosts too. Returns the new ones: those with an agent, which is greeted, and those without."""
        self._hear_all()
        new = sorted(set(hosts) - self._own)
        self._own |= set(new)
        greeted = [host for host in new if host in self._seen]
        for host in greeted:
            self._greet(host, self._seen.pop(host), "")
        return greeted, [host for host in new if host not in greeted]

    def leave(self, hosts: Collection[str] | None = None) -> None:
        """Tell these hosts, or all, that their run is over, and wait until they have received it, at most _LEAVE_S
        seconds.

        Other changes meanwhile are returned by the next `wait`.
        """
        if hosts is None:
            self._has_left.set()
            self._heartbeats.close()
            left = list(self._hosts.values())
        else:
            self._own -= set(hosts)
            left = [self._hosts[host] for host in sorted(hosts) if host in self._hosts]
        for host in left:
            self.say(host.name, orders.LeaveOrder())
        end_s = time.monotonic() + _LEAVE_S
        while time.monotonic() < end_s:
            if all(host.channel.is_done or self._hosts.get(host.name) is not host for host in left):
                break
            self._hear_once(min(end_s, time.monotonic() + 0.05))
        if hosts is not None:
            for host in left:
                if self._hosts.pop(host.name, None) is host:
                    self._heartbeats.forget(host.name)
                    self._seen[host.name] = host.life

    def _hear_once(self, end_s: float) -> bool:
        """Wait until something arrives or is due to be sent, and handle it. Returns whether `wake` was called."""
        is_awake = False
        with suppress(queue.Empty):
            is_awake = self._hear(self._inbox.get(timeout=self._patience_s(end_s)))
        return self._hear_all() or is_awake

    def _patience_s(self, end_s: float) -> float:
        """Seconds until something is due to be sent, at most until `end_s` and at most a sign's period."""
        due_s = min((min(host.channel.due_s(), host.pulse.gone_s) for host in self._hosts.values()), default=inf)
        return max(0.0, min(min(end_s, due_s) - time.monotonic(), sign_period_s()))

    def _hear_all(self) -> bool:
        """Handle arrived messages, then send the orders that are due. Returns whether `wake` was called."""
        is_awake = False
        with suppress(queue.Empty):
            while True:
                is_awake = self._hear(self._inbox.get_nowait()) or is_awake
        for host in list(self._hosts.values()):
            host.channel.pump(time.monotonic())
            if host.channel.is_broken:
                self._greet(host.name, host.life, "messages were lost")
        self._lose_silent()
        return is_awake

    def _lose_silent(self) -> None:
        """Lose hosts that were silent for a lease, unless this process was stalled meanwhile."""
        now_s = time.monotonic()
        before_s, self._round_s = self._round_s, now_s
        for host in list(self._hosts.values()):
            if now_s - before_s >= MISSED_SIGNS * sign_period_s():
                host.pulse.note(now_s)
            elif host.pulse.is_gone(now_s):
                self._lose(host, "its agent is gone")
            elif host.pulse.is_lost(now_s):
                self._lose(host, f"nothing was heard of it for {host.pulse.silent_s(now_s):.1f} s")

    def _hear(self, arrival: _Arrival) -> bool:
        match arrival:
            case None:
                return True
            case _Beat(name, asked_s, at_s) if name in self._hosts:
                self._hosts[name].pulse.note_beat(asked_s, at_s)
            case _Measured(host, Reading() as reading) if self._hosts.get(host.name) is host:
                self._note_clock(host, reading)
            case _Measured(host, None) if self._hosts.get(host.name) is host and not host.is_there:
                self._greet(host.name, host.life, "its clock does not answer")
            case (str(key), bool(is_alive)):
                self._note_life(key, is_alive)
            case (str(key), float(at_s)):
                self._note_sign(key, at_s)
            case (str(key), bytes(head), bytes(payload)):
                self._hear_agent(key, head, payload)
        return False

    def _note_life(self, key: str, is_alive: bool) -> None:
        _, name, _, life = key.split("/")
        if name == MANAGER:
            return
        host = self._hosts.get(unquote(name))
        if not self._is_greeting or unquote(name) not in self._own:
            if is_alive:
                self._seen[unquote(name)] = life
            elif self._seen.get(unquote(name)) == life:
                del self._seen[unquote(name)]
        elif is_alive and host is None:
            self._greet(unquote(name), life, "")
        elif is_alive and host is not None and host.life == life:
            host.pulse.note(time.monotonic())
        elif not is_alive and host is not None and host.life == life and host.pulse.is_steady(time.monotonic()):
            host.pulse.note_end(time.monotonic(), self._heartbeats.ask_at_once(host.name))

    def _note_sign(self, key: str, at_s: float) -> None:
        """Record a sign of life. Zenoh reports living keys too, but after a cut not all of them."""
        _, name, _, life = key.split("/")
        if life not in self._left_alone:
            self._note_life(key, is_alive=True)
        host = self._hosts.get(unquote(name))
        if host is not None and host.life == life:
            host.pulse.note(at_s)

    def _greet(self, name: str, life: str, cause: str) -> None:
        """Begin a new session with a host, and lose the one before."""
        if name in self._hosts:
            self._lose(self._hosts[name], cause)
        self._serial += 1
        session = orders.Session(self._term, self._run, self._serial, life)
        channel: orders.ReliableChannel[orders.FromAgent] = orders.ReliableChannel(
            self._link, MANAGER, name, session, orders.FromAgent
        )
        now_s = time.monotonic()
        host = self._hosts[name] = HostState(name, life, channel, Pulse(now_s, now_s), new_secret())
        channel.say(orders.GreetOrder(self._is_beginning, host.secret, __version__, orders.digest_of_fields()))

    def _lose(self, host: HostState, cause: str) -> None:
        del self._hosts[host.name]
        self._heartbeats.forget(host.name)
        self._happened.append(AgentGone(host, cause))

    def _hear_agent(self, key: str, head: bytes, payload: bytes) -> None:
        _, name, kind, _, session = key.split("/")
        host = self._hosts.get(unquote(name))
        if host is None or host.channel.session != orders.read_session(session):
            return
        if kind == orders.REFUSE:
            self._heed(host, payload)
            return
        try:
            for message in host.channel.hear(kind, head, payload, time.monotonic()):
                if isinstance(message, orders.Welcome):
                    self._welcome(host, message)
                else:
                    self._happened.append(AgentMessage(host, message))
        except orders.OtherVersionError as error:
            self.leave_alone(host, orders.other_version(error.theirs, error))

    def leave_alone(self, host: HostState, cause: str) -> None:
        """Lose a host whose agent is alive but can't be given orders, and do not greet that agent again."""
        self._left_alone[host.life] = host.name
        if self._hosts.get(host.name) is host:
            self._lose(host, cause)

    def _heed(self, host: HostState, refusal: bytes) -> None:
        """Handle a refusal: leave the host to a later manager if that one is alive, unless this one takes over. If the
        host's agent can't read the orders, leave the host alone.
        """
        word, _, version_and_cause = refusal.decode(errors="replace").partition(" ")
        if word == orders.OTHER_VERSION:
            theirs, _, cause = version_and_cause.partition(" ")
            self.leave_alone(host, orders.other_version(theirs, cause))
            return
        try:
            term, is_obeyed = map(int, refusal.split())
        except ValueError:
            return  # it is no refusal
        if is_obeyed and self._is_beginning and not self._takes_over:
            self._refusing.append(host)
        elif is_obeyed and not self._takes_over:
            self.leave_alone(host, "it obeys another manager")
        else:
            self._term = max(self._term, term + 1)
            self._greet(host.name, host.life, "it obeyed a manager that is gone")

    def _welcome(self, host: HostState, welcome: orders.Welcome) -> None:
        host.held, host.states, host.ahead_ns = welcome.held, welcome.states, welcome.held.ahead_ns
        path = Path(welcome.run)
        host.run = path if is_alive(path) else None
        self._heartbeats.ask(host.name, welcome.beats, host.secret)
        threading.Thread(target=self._measure, args=(host, CALLS), daemon=True).start()

    def _measure(self, host: HostState, calls: int) -> None:
        """Read a host's clock. The first reading has a thread of its own, so that a silent host delays no other."""
        self._inbox.put(_Measured(host, self._clock.read_host(self._link, host.name, host.life, calls)))

    def _measure_again(self) -> None:
        """Read the clocks of all hosts that are there again and again, in a thread of its own."""
        while not self._has_left.wait(CLOCK_S):
            for host in [host for host in list(self._hosts.values()) if host.is_there]:
                self._measure(host, CALLS_AGAIN)

    def _note_clock(self, host: HostState, reading: Reading) -> None:
        """Record a reading of a host's clock; the host has then joined."""
        host.reading, was_there, host.is_there = reading, host.is_there, True
        if not self._is_beginning:
            self._correct(host, reading)
        if not was_there or has_moved(host.shown_ns, reading):
            host.shown_ns = reading.day_ahead_ns
            self._happened.append((AgentClockSet if was_there else AgentJoined)(host, reading.day_ahead_ns))

    def _begin_clocks(self) -> None:
        """Continue with an earlier manager's clock, if a host knows it: the times of elements then rise
        without a step.
        """
        known = {host: host.reading for host in self._hosts.values() if host.reading is not None}
        for host, reading in known.items():
            if host.ahead_ns is not None:
                self._run_ahead_ns = host.ahead_ns - reading.ahead_ns
                break
        self._tell_clock(self._clock_offset_ns - self._run_ahead_ns)
        for host, reading in known.items():
            self._correct(host, reading)

    def _correct(self, host: HostState, reading: Reading) -> None:
        """Correct a host's clock, as far as its reading is certain."""
        before_ns, measured_ns = host.ahead_ns, reading.ahead_ns + self._run_ahead_ns
        host.ahead_ns = measured_ns if before_ns is None else corrected(before_ns, measured_ns, reading.doubt_ns)
        if host.ahead_ns != before_ns:
            self.say(host.name, orders.ClockOrder(host.ahead_ns))
