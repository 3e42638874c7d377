"""A run that a test kills. Arguments: a file where its worker notes each failure on r1, and the agents' endpoints.

It says `met` once the worker runs on r2.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from pathlib import Path

from cfgplan_runtime.fleet.fleet_backend import FleetBackend
from cfgplan_runtime.fleet.fleet_runtime import linked
from cfgplan_runtime.lifecycle.back_off import BackOffRules
from cfgplan_runtime.lifecycle.manager import Manager
from cfgplan_runtime.lifecycle.policy import Policy
from cfgplan_runtime.runtime import Runtime
from cfgplan_runtime.streams.run_folder import RunFolder
from small_fleet import FOLDER, PATIENCE_S, RESULT, eventually, source, worker

from cfgplan import api
from cfgplan.domain import Environment, Host

HOSTS = ("r1", "r2")
FIRST_S = 300.0
"""Seconds of the back-off after the first failed start: longer than any test."""


def world(note: Path, **params: object) -> api.World:
    """A worker that is planned for r1 first, and fails there."""
    work = worker("work", "FailsOn")
    work = replace(work, params={"host": "r1", "note": str(note), **params}, hosts=HOSTS)
    count = replace(source(), host="r1")
    return api.world(Environment((), (count, work), (RESULT,), tuple(map(Host, HOSTS))), horizon_s=60)


def main() -> None:
    known = world(Path(sys.argv[1]))
    run = RunFolder()
    link = linked(sys.argv[2:], None, PATIENCE_S)
    more = {"folder": FOLDER, "library": known.environment.transformation, "wait_s": PATIENCE_S}
    policy = Policy(back_off=BackOffRules(first_s=FIRST_S), hosts_s=PATIENCE_S)
    runtime = Runtime(backend=lambda: FleetBackend(HOSTS, run, link, **more))
    with runtime, Manager(known, runtime, policy=policy) as manager:
        eventually(lambda: all(target.is_met for target in manager.targets))
        sys.stdout.write("met\n")
        sys.stdout.flush()
        time.sleep(PATIENCE_S)
