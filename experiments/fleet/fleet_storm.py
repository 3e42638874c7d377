"""A storm on three computers: links are cut, agents, helpers and units killed, hosts removed, targets changed.

The final configuration must be as good as a fresh optimal plan, and no other process may be left on any host.
"""

from __future__ import annotations

import os
import random
import sys
import time
from collections import Counter
from contextlib import suppress
from pathlib import Path
from typing import Any

from computers import HOSTS, Fleet, eventually

sys.path.append(str(Path(__file__).parents[1] / "lifecycle"))

PAUSES_S = (0.0, 0.0, 0.01, 0.1, 0.5, 2.5)


class Weather:
    """Draws random faults of computers, and may repair them later."""

    def __init__(self, fleet: Fleet, randoms: random.Random) -> None:
        self._fleet, self._randoms = fleet, randoms
        self._cut = set[str]()
        self.happened: Counter[str] = Counter()

    def strike(self) -> bool:
        """Cause a random fault or repair. Returns False if none was drawn."""
        kind = self._randoms.choices(("units", "link", "agent", "helper", ""), (20, 10, 6, 4, 60))[0]
        host = self._randoms.choice(HOSTS)
        match kind:
            case "units":
                units = self._fleet.units(host)
                for unit in self._randoms.sample(sorted(units), min(len(units), self._randoms.choice((1, 1, 2, 4)))):
                    _kill(units[unit])
            case "link" if host != "base":  # where the manager is
                self._fleet.network.mend(host) if host in self._cut else self._fleet.network.cut(host)
                self._cut ^= {host}
            case "agent" if self._fleet.agents[host].poll() is None:
                self._fleet.kill_agent(host)
            case "agent":
                self._fleet.start_agent(host)
            case "helper" if helpers := self._fleet.helpers(host):
                _kill(helpers[self._randoms.choice(sorted(helpers))])
        self.happened[kind or "request"] += 1
        return bool(kind)

    def clear_up(self) -> None:
        """Restore every link, and restart every killed agent."""
        for host in self._cut:
            self._fleet.network.mend(host)
        self._fleet.restart()


def faults_after(fleet: Fleet, seed: int, perturbations: int) -> tuple[str, list[str]]:
    """Return the faults of a storm, and each way in which the final configuration is wrong."""
    import storm
    from cfgplan_runtime import Manager
    from cfgplan_runtime.lifecycle.changes import RegainHost
    from cfgplan_runtime.lifecycle.policy import Policy
    from cfgplan_runtime.lifecycle.seams import DeclaredCosts

    from cfgplan import api
    from cfgplan.domain import Environment

    is_free_to_start = seed % 2 == 0
    known = storm.library(random.Random(seed), is_free_to_start=is_free_to_start, places=storm.CHOICES)
    wanted = storm.targets()
    environment = Environment((), tuple(known), tuple(wanted), storm.HOSTS, transfer_us=storm.TRANSFER_US)
    world = api.world(environment, horizon_s=storm.HORIZON_S)
    decisions: Counter[str] = Counter()
    costs, policy = DeclaredCosts(failure_us=0), Policy(hosts_s=storm.PATIENCE_S)
    requests = storm.Storm(seed, known, wanted)
    weather = Weather(fleet, requests.randoms)
    with (
        fleet.runtime(is_empty=True) as runtime,
        Manager(world, runtime, estimator=costs, policy=policy, report=storm.counting(decisions)) as manager,
    ):
        manager.settle(storm.PATIENCE_S)
        for _ in range(perturbations):
            if not weather.strike():
                patience_s = requests.randoms.choice((0.01, storm.PATIENCE_S))
                storm.await_answer(manager.request(requests.change(manager)), patience_s)
            time.sleep(requests.randoms.choice(PAUSES_S))
        weather.clear_up()
        eventually(lambda: not runtime.supervisor.lost_hosts)
        for host in HOSTS:
            storm.await_answer(manager.request(RegainHost(host)), storm.PATIENCE_S)
        found = storm.faults_at_rest(manager, runtime, is_free_to_start=is_free_to_start)
        found += [fault for host in HOSTS if (fault := _left(fleet, runtime, host))]
    return f"{dict(weather.happened)}, reviews {dict(decisions)}", found


def _left(fleet: Fleet, runtime: Any, host: str) -> str:
    """In what way other units run on a host than should; the empty text if none does."""
    wanted = {unit.id for unit in runtime.environment.units if unit.host == host}
    with suppress(TimeoutError):
        eventually(lambda: fleet.units(host).keys() == wanted)
        return ""
    return f"on {host} run {sorted(fleet.units(host))} instead of {sorted(wanted)}"


def _kill(pid: int) -> None:
    with suppress(ProcessLookupError):
        os.kill(pid, 9)
