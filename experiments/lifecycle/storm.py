"""Storms: sequences of random perturbations, with a check after each that the running configuration is optimal.

    python experiments/lifecycle/storm.py [--perturbations 200] [--seeds 10] [--seed 0] [--real | --hosts]

Units are simulated on a virtual clock; with --real they are processes. With --hosts they are placed on three hosts,
which are lost and come back. If the seed is even, starts are free, and the configuration must cost exactly as much as
a fresh plan. Otherwise it must cost exactly as much as the plan that a planner without memory finds from the running
units. The met targets must be the same, the judge must accept the plan, and the topics of processes must have elements.
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from cfgplan_runtime import Manager, Runtime, SimulatedRuntime, subscribe
from cfgplan_runtime.lifecycle.changes import (
    Add,
    Change,
    KillUnit,
    LoseHost,
    RegainHost,
    Remove,
    ReviewNow,
)
from cfgplan_runtime.lifecycle.inbox import Outcome
from cfgplan_runtime.lifecycle.reports import Reviewed
from cfgplan_runtime.lifecycle.seams import DeclaredCosts

from cfgplan import api
from cfgplan.domain import Environment, Host, InputPort, OutputPort, Target, Transformation
from cfgplan.errors import InputError
from cfgplan.explaining import best_effort
from cfgplan.matching import Matcher
from cfgplan.planners import PLANNERS
from cfgplan.planning import Problem, Status
from cfgplan.validity import Rule, violations

LAYERS = "ABCD"
HOSTS = (Host("r1", cpu_us=2000), Host("r2", cpu_us=3000), Host("base"))
PLACES: tuple[tuple[str, ...], ...] = ((), (), ("r1",), ("r2",))
CHOICES: tuple[tuple[str, ...], ...] = ((), ("r1", "r2"), ("r1", "base"), ("r2", "base"), ("base",))
TRANSFER_US = 1000
PATIENCE_S = 60.0
HORIZON_S = 300
UNITS = Path(__file__).parent / "storm_units.py"


def library(
    randoms: random.Random, *, is_free_to_start: bool, places: tuple[tuple[str, ...], ...] = PLACES
) -> list[Transformation]:
    """Return sources of the tag A, and for each further layer transformations that need one or two tags of the layer
    before.
    """
    made = []
    for layer, letter in enumerate(LAYERS):
        for number in range(4):
            width = 0 if layer == 0 else randoms.choice((1, 1, 2))
            hosts = randoms.choice(places)
            made.append(
                Transformation(
                    f"{letter.lower()}{number}",
                    tuple(InputPort(f"x{port}", f"{LAYERS[layer - 1]}{randoms.randrange(2)}") for port in range(width)),
                    (OutputPort("y", f"{letter}{number % 2}", rate_uhz=10_000_000, size_bytes=1000 * number),),
                    0 if is_free_to_start else randoms.randrange(1, 1000) * 1000,
                    randoms.randrange(1, 1000),
                    source=f"{UNITS}:give{width}",
                    host=hosts[0] if len(hosts) == 1 else None,
                    hosts=hosts if len(hosts) > 1 else (),
                )
            )
    return made


def targets() -> list[Target]:
    """Return a target for each tag of the last two layers, some more important than others."""
    return [
        Target(f"{letter}{number}", f"{letter}{number}", f"/{letter}{number}", priority=number)
        for letter in LAYERS[2:]
        for number in range(2)
    ]


class Storm:
    """Draws random perturbations for a manager, and may restore removed items later."""

    def __init__(self, seed: int, known: list[Transformation], wanted: list[Target]) -> None:
        self.randoms = random.Random(seed)
        self._known = {transformation.label: transformation for transformation in known}
        self._wanted = {target.label: target for target in wanted}

    def change(self, manager: Manager) -> Change:
        """Return a random change that is possible in the manager's state."""
        world, randoms, seen = manager.world.environment, self.randoms, manager.snapshot()
        gone = sorted(set(self._known) - set(world.transformation))
        unwanted = sorted(set(self._wanted) - set(world.target))
        choices: list[Change] = [ReviewNow()]
        choices += [KillUnit(randoms.choice(seen.units).unit.id)] * 4 if seen.units else []
        if len(world.library) > 8:
            choices += [Remove(transformations=(randoms.choice(world.library).label,))] * 2
        if gone:
            choices += [Add(transformations=(self._known[randoms.choice(gone)],))] * 2
        if len(world.targets) > 1:
            choices.append(Remove(targets=(randoms.choice(world.targets).label,)))
        if unwanted:
            choices.append(Add(targets=(self._wanted[randoms.choice(unwanted)],)))
        changed = randoms.choice(world.library)
        choices.append(Add(transformations=(replace(changed, upkeep_us=randoms.randrange(1, 1000)),)))
        choices.append(Add(transformations=(replace(changed, params={"seed": randoms.random()}),)))
        lost = seen.lost_hosts
        choices.append(RegainHost(lost[0]) if lost else LoseHost(randoms.choice(("r1", "r2"))))
        return randoms.choice(choices)


def faults(manager: Manager, running: Environment, *, is_free_to_start: bool) -> list[str]:
    """Return the faults of the running configuration: a higher cost or fewer met targets than a planner without memory
    finds, and the rules that the judge finds broken.
    """
    world, lost = manager.world, manager.snapshot().lost_hosts
    hosts = tuple(host for host in world.environment.hosts if host.name not in lost)
    known = replace(world.environment, hosts=hosts)
    possible = tuple(t for t in known.library if (known.hosts_for(t) if hosts else t.host not in lost))
    now = replace(known, units=running.units, library=possible)
    matcher = Matcher(world.ontology)
    matcher.add(
        offered={port.tag for t in possible for port in t.outputs},
        demanded={port.tag for t in possible for port in t.inputs} | {target.tag for target in now.targets},
    )
    similarity = matcher.matching().similarity
    problem = Problem(now, similarity, world.horizon_s)
    again = best_effort(problem, PLANNERS["cpsat"])
    fresh = best_effort(replace(problem, environment=replace(now, units=())), PLANNERS["cpsat"])
    found = [
        str(violation)
        for violation in violations(now, similarity)
        if not (violation.rule is Rule.MET and violation.target in fresh.unmet)
    ]
    if again.plan.status is not Status.OPTIMAL or again.plan.change_set:
        found.append(f"there is something better: {again.plan}")
    if fresh.unmet != again.unmet:
        found.append(f"a fresh plan leaves {fresh.unmet} unmet, what runs {again.unmet}")
    if is_free_to_start and again.plan.cost_us != fresh.plan.cost_us:
        found.append(f"what runs costs {again.plan.cost_us} us, a fresh plan {fresh.plan.cost_us} us")
    return found


def on_hosts(seed: int, perturbations: int) -> list[str]:
    """Run a storm on a simulated backend with hosts that are lost and come back. Returns the faults."""
    return in_thought(seed, perturbations, hosts=HOSTS)


def in_thought(seed: int, perturbations: int, hosts: tuple[Host, ...] = ()) -> list[str]:
    """Run a storm on a simulated backend, with crashes and cut subscriptions among the perturbations. Returns the
    faults.
    """
    is_free_to_start = seed % 2 == 0
    places = CHOICES if hosts else PLACES
    known = library(random.Random(seed), is_free_to_start=is_free_to_start, places=places)
    environment = Environment((), tuple(known), tuple(targets()), hosts, transfer_us=TRANSFER_US)
    world = api.world(environment, horizon_s=HORIZON_S)
    runtime = SimulatedRuntime()
    decisions: Counter[str] = Counter()
    costs = DeclaredCosts(failure_us=0)  # what crashed is to be as good as before in the end
    manager = Manager(world, runtime, clock=runtime.clock, estimator=costs, report=counting(decisions))
    manager.run(1.0)
    storm = Storm(seed, known, targets())
    for _ in range(perturbations):
        kind = storm.randoms.random()
        inlets = sorted(runtime.supervisor.wiring.feeds)
        if kind < 0.2 and runtime.environment.units:
            runtime.backend.fail(storm.randoms.choice(runtime.environment.units).id)
        elif kind < 0.3 and inlets:
            inlet = storm.randoms.choice(inlets)
            runtime.cut(inlet.unit or None, inlet.port)
        elif kind < 0.5 and hosts:
            host = storm.randoms.choice(hosts).name
            if host in runtime.backend.lost_hosts:
                runtime.backend.join_host(host)
            else:
                runtime.backend.lose_host(host)
        else:
            manager.request(storm.change(manager))
        manager.run(storm.randoms.choice((0.0, 0.0, 0.001, 0.02, 1.0, 30.0)))
    if hosts:
        runtime.backend.join_host("base")  # where nothing is there, a fresh plan has nothing to say
    manager.run(2.0)
    last = manager.request(ReviewNow())
    manager.run(2.0)
    last.result(timeout=0)
    print(f"seed {seed}: {dict(decisions)}")
    return faults(manager, runtime.environment, is_free_to_start=is_free_to_start)


def on_processes(seed: int, perturbations: int) -> list[str]:
    """Run a storm on real processes; some requests come before the last is answered. Returns the faults."""
    is_free_to_start = seed % 2 == 0
    known = library(random.Random(seed), is_free_to_start=is_free_to_start)
    world = api.world(Environment((), tuple(known), tuple(targets())), horizon_s=HORIZON_S)
    storm = Storm(seed, known, targets())
    decisions: Counter[str] = Counter()
    costs = DeclaredCosts(failure_us=0)
    with Runtime() as runtime, Manager(world, runtime, estimator=costs, report=counting(decisions)) as manager:
        manager.settle(PATIENCE_S)
        for _ in range(perturbations):
            if storm.randoms.random() < 0.3:
                _kill(runtime, storm.randoms)
            else:
                await_answer(manager.request(storm.change(manager)), storm.randoms.choice((0.01, PATIENCE_S)))
        print(f"seed {seed}: {dict(decisions)}")
        return faults_at_rest(manager, runtime, is_free_to_start=is_free_to_start)


def faults_at_rest(manager: Manager, runtime: Runtime, *, is_free_to_start: bool) -> list[str]:
    """Return the faults once every request is answered; a met target without elements is a fault."""
    manager.settle(PATIENCE_S)
    await_answer(manager.request(ReviewNow()), PATIENCE_S)
    manager.settle(PATIENCE_S)
    found = faults(manager, runtime.environment, is_free_to_start=is_free_to_start)
    met = [view.topic for view in manager.snapshot().targets if view.is_met]
    return [*found, *(f"nothing comes on {topic}" for topic in met if not _gives(topic, runtime.id))]


def _kill(runtime: Runtime, randoms: random.Random) -> None:
    """Kill some units at about the same time."""
    units = sorted(runtime.environment.unit)
    for unit in randoms.sample(units, min(len(units), randoms.choice((1, 1, 2, 4)))):
        pid = runtime.pid(unit)
        if pid is not None:
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        time.sleep(randoms.choice((0.0, 0.0, 0.003, 0.01)))


def _gives(topic: str, run: str) -> bool:
    """Whether elements come on a topic."""
    received: list[object] = []
    listener = threading.Thread(target=lambda: received.append(next(iter(subscribe(topic, run=run)))), daemon=True)
    listener.start()
    listener.join(PATIENCE_S)
    return bool(received)


def await_answer(outcome: Outcome, patience_s: float) -> None:
    """Wait at most `patience_s` seconds for an answer; ignore that a request that came too late is refused."""
    with suppress(InputError, TimeoutError):
        outcome.result(patience_s)


def counting(decisions: Counter[str]) -> Callable[[object], None]:
    def count(report: object) -> None:
        if isinstance(report, Reviewed):
            decisions[report.review.decision.value] += 1

    return count


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--perturbations", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0, help="the first one")
    parser.add_argument("--seeds", type=int, default=10, help="how many")
    parser.add_argument("--real", action="store_true", help="run units as processes")
    parser.add_argument("--hosts", action="store_true", help="place units on hosts, which are lost and come back")
    options = parser.parse_args()
    blow = on_processes if options.real else on_hosts if options.hosts else in_thought
    is_good = True
    for seed in range(options.seed, options.seed + options.seeds):
        found = blow(seed, options.perturbations)
        for fault in found:
            print(f"seed {seed}: {fault}")
        is_good &= not found
    print("as good as it can be" if is_good else "NOT as good as it can be")
    return 0 if is_good else 1


if __name__ == "__main__":
    sys.exit(main())
