"""A runtime over the hosts of a fleet: agents that are there, or one for each host on this computer."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from cfgplan.domain import Environment
from cfgplan_runtime.fleet.fleet_backend import WAIT_S, FleetBackend
from cfgplan_runtime.fleet.local import LocalAgents
from cfgplan_runtime.runtime import Runtime
from cfgplan_runtime.streams.run_folder import RunFolder

LOCAL_WAIT_S = 30.0
"""Seconds that agents on this computer may take to start: it may be busy."""


@dataclass(frozen=True)
class Fleet:
    """How hosts are reached: by the endpoints of agents; or an agent for each is started here (`is_local`)."""

    connect: Sequence[str] = ()
    certificates: Path | None = None
    is_local: bool = False
    takes_over: bool = False


@contextmanager
def fleet_runtime(
    fleet: Fleet, environment: Environment, folder: Path, preload: Sequence[str] = ()
) -> Iterator[Runtime]:
    """A runtime whose units are on the environment's hosts; what runs there by its library goes on.

    `folder` is what `units.py:Class` is relative to. Raises InputError.
    """
    hosts = tuple(environment.host)
    with ExitStack() as stack:
        run = RunFolder()
        stack.callback(run.close)
        connect, wait_s = fleet.connect, WAIT_S
        if fleet.is_local:
            agents = stack.enter_context(LocalAgents(hosts, run.path, folder=folder, preload=preload))
            connect, wait_s = agents.endpoints, LOCAL_WAIT_S

        def backend() -> FleetBackend:
            return FleetBackend(
                hosts,
                run,
                connect=connect,
                certificates=fleet.certificates,
                folder=folder,
                library=environment.transformation,
                wait_s=wait_s,
                takes_over=fleet.takes_over,
            )

        yield stack.enter_context(Runtime(backend=backend))
