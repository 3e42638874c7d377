"""A manager to be killed: arguments are how far its clock is behind, its hosts with commas, and the endpoints.

It says `applied`, and the cause when it has lost a host.
"""

from __future__ import annotations

import sys
import time

from cfgplan_runtime import Runtime
from cfgplan_runtime.fleet.fleet_backend import FleetBackend
from cfgplan_runtime.fleet.fleet_runtime import linked
from cfgplan_runtime.streams.run_folder import RunFolder
from cfgplan_runtime.supervision.events import HostLost, SparePrepared
from small_fleet import FOLDER, PATIENCE_S, RESULT, cold, eventually, seen, source, unit, worker

from cfgplan.domain import ChangeSet, Host


def main() -> None:
    behind_ns, time_ns = int(sys.argv[1]), time.time_ns
    time.time_ns = lambda: time_ns() - behind_ns
    hosts = sys.argv[2].split(",")
    run = RunFolder()
    link = linked(sys.argv[3:], None, PATIENCE_S)
    backend = lambda: FleetBackend(hosts, run, link, folder=FOLDER, wait_s=PATIENCE_S)  # noqa: E731
    with Runtime(backend=backend) as runtime:
        work = unit("work.1", hosts[-1], topic="/result", x="count.1/n")
        units = (unit("count.1", "r1"), work, cold("work.9", "r1"))
        everywhere = tuple(Host(name) for name in hosts)
        library = (source(), worker())
        runtime.apply(ChangeSet(units, added_transformations=library, added_targets=(RESULT,), added_hosts=everywhere))
        eventually(lambda: bool(seen(runtime, SparePrepared)))
        sys.stdout.write("applied\n")
        sys.stdout.flush()
        eventually(lambda: bool(seen(runtime, HostLost)))
        sys.stdout.write(f"{seen(runtime, HostLost)[0].cause}\n")
        sys.stdout.flush()
        time.sleep(PATIENCE_S)
