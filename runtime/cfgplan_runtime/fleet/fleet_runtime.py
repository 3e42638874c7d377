"""A runtime over the hosts of a fleet, whose agents run already or are started on this computer."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

from cfgplan.domain import Environment
from cfgplan.errors import InputError
from cfgplan_runtime.errors import RuntimeFaultError
from cfgplan_runtime.fleet.adoption import adopt, failures_kept
from cfgplan_runtime.fleet.fleet_backend import WAIT_S, FleetBackend
from cfgplan_runtime.fleet.links import config
from cfgplan_runtime.fleet.local import LocalAgents
from cfgplan_runtime.fleet.reached import ReachedFleet
from cfgplan_runtime.processes.cpu_group import CpuGroup, cpu_groups
from cfgplan_runtime.runtime import Runtime
from cfgplan_runtime.streams.run_folder import RunFolder
from cfgplan_runtime.streams.zenoh_link import ZenohLink
from cfgplan_runtime.supervision.events import FailuresKept

LOCAL_WAIT_S = 30.0
"""Seconds that agents on this computer may take to start, even if it is busy."""


@dataclass(frozen=True)
class Fleet:
    """The access to hosts: by the endpoints of agents, or by agents that are started here for all hosts
    (`is_local`).
    """

    connect: Sequence[str] = ()
    certificates: Path | None = None
    is_local: bool = False
    takes_over: bool = False


@dataclass(frozen=True)
class LeftUnits:
    """The units that an earlier run has left on a fleet's hosts: those that a new run adopts, as `running`, and the ids
    of those that it ends, since the file would not start them as they were started. `failures` are those that the hosts
    have kept for the next run.
    """

    running: Environment = field(default_factory=Environment)
    ended: tuple[str, ...] = ()
    failures: tuple[FailuresKept, ...] = ()


def left_units(fleet: Fleet, environment: Environment, folder: Path) -> LeftUnits:
    """Find the units on the hosts of an environment, and change nothing. Hosts that do not answer have none.

    Sources such as `units.py:Class` are relative to `folder`.
    """
    if fleet.is_local:
        return LeftUnits()
    try:
        with ReachedFleet(fleet.connect, fleet.certificates) as reached:
            held = {host: one for host, one in reached.held().items() if host in environment.host}
    except InputError:  # the run says so, when it waits for its hosts
        return LeftUnits()
    adoption = adopt("", held, environment.transformation)
    found = adoption.found
    running = Environment() if found is None else Environment(found.units, found.library, hosts=found.hosts)
    failures = [one for host, here in held.items() for one in failures_kept(host, here, folder)]
    known = tuple(one for one in failures if one.is_of(environment.transformation.get(one.transformation)))
    return LeftUnits(running, tuple(adoption.ended), known)


@contextmanager
def fleet_runtime(
    fleet: Fleet,
    environment: Environment,
    folder: Path,
    preload: Sequence[str] = (),
    say: Callable[[str], None] = lambda _: None,
) -> Iterator[Runtime]:
    """A runtime whose units are on the environment's hosts. Running units that are in the library are kept.

    Sources such as `units.py:Class` are relative to `folder`. If all hosts are on this computer, the CPU time of each
    is limited by its `cpu`; `say` gets a message if the system can't do that. Raises InputError.
    """
    hosts = tuple(environment.host)
    with ExitStack() as stack:
        run = RunFolder()
        stack.callback(run.close)
        connect, wait_s = fleet.connect, WAIT_S
        if fleet.is_local:
            cpu = _cpu_groups(environment, say)
            for group in cpu.values():
                stack.callback(group.close)
            agents = stack.enter_context(LocalAgents(hosts, run.path, folder=folder, preload=preload, cpu=cpu))
            connect, wait_s = agents.endpoints, LOCAL_WAIT_S

        link = linked(connect, fleet.certificates, wait_s)
        # Also if the run is interrupted while it waits for hosts: Zenoh's threads must have ended when Python does.
        stack.callback(link.close)

        def backend() -> FleetBackend:
            return FleetBackend(
                hosts,
                run,
                link,
                folder=folder,
                library=environment.transformation,
                wait_s=wait_s,
                takes_over=fleet.takes_over,
                certificates=fleet.certificates,
            )

        yield stack.enter_context(Runtime(backend=backend))


def linked(connect: Sequence[str], certificates: Path | None, wait_s: float) -> ZenohLink:
    """A link with the agents at these endpoints. If a single agent answers within `wait_s` seconds, the link goes
    through it.
    """
    if len(connect) == 1:
        with suppress(InputError):
            return ZenohLink(config(connect=connect, certificates=certificates, mode="client", reach_s=wait_s))
    return ZenohLink(config(connect=connect, certificates=certificates))


def _cpu_groups(environment: Environment, say: Callable[[str], None]) -> Mapping[str, CpuGroup]:
    """The CPU group of each host that has a limit; empty if the system has no such groups."""
    limits_us = {host.name: host.cpu_us for host in environment.hosts if host.cpu_us is not None}
    try:
        return cpu_groups(limits_us) if limits_us else {}
    except RuntimeFaultError as error:
        say(f"`cpu` of hosts limits plans, but not running units: {error}")
        return {}
