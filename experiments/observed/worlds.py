"""Check plans with facts, facts of hosts and observed qualities in random worlds.

A world has facts of the world and of hosts, transformations that require them, and outputs that report their quality,
which differs between hosts.
A run (the real manager, with simulated units) gets values of facts and elements of streams. Its next review is
compared with `solve --observed` of the file that `ctl observed --out` writes, with the plan of the same world without
facts, in which each transformation lists the hosts that the present facts allow, and with the oracle. The judge
checks the plan.

    python experiments/observed/worlds.py --worlds 1000
"""

from __future__ import annotations

import argparse
import random
import tempfile
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from cfgplan_runtime import Manager, Policy, SimulatedRuntime
from cfgplan_runtime.children.messages import Qualities, Quality
from cfgplan_runtime.lifecycle.changes import SetFact
from cfgplan_runtime.operating.records import snapshot_record
from cfgplan_runtime.supervision.simulated_backend import Behaviour

from cfgplan import api
from cfgplan.domain import Environment, Host, InputPort, OutputPort, Target, Transformation
from cfgplan.facts import Fact, why_left_out
from cfgplan.formats.observed_file import observed_text, read_observed
from cfgplan.planners import PLANNERS
from cfgplan.planning import Plan, Problem, Status
from cfgplan.qualities import MICRO, Better, Contribution, QualityAttribute, QualityRule, Wish
from cfgplan.validity import plan_violations

HORIZON_S = 60
MOST_TOLD = 3
REQUIREMENTS = (
    None,
    None,
    "v >= 2",
    "night",
    "battery > 20",
    "battery > 20 or night",
    "not (battery > 60) and v < 3",
    "v >= 1 and battery > 40",
)
VALUES = {"v": ("0", "1.5", "2", "4"), "night": ("true", "false"), "battery": ("5", "30", "50", "90")}


def drawn(chance: random.Random) -> Environment:
    """Return a random world of three or four transformations in three layers, on two or three hosts or none."""
    has_hosts, stated = chance.random() < 0.7, chance.random() < 0.6
    library = []
    for number in range(chance.randint(3, 4)):
        layer = 0 if number == 0 else chance.randrange(3)
        inputs = (InputPort("i", "ABC"[layer - 1]),) if layer else ()
        rule = QualityRule.ADD if layer else QualityRule.SET
        quality = (Contribution("e", rule, chance.randrange(1, 5) * MICRO // 10, observe="e"),) if stated else ()
        requires = chance.choice([one for one in REQUIREMENTS if has_hosts or "battery" not in (one or "")])
        port = OutputPort("o", "ABC"[layer], quality, 10 * MICRO, chance.choice((0, 10_000)))
        costs = chance.randrange(1, 5) * 100_000, chance.randrange(1, 9) * 1000
        library.append(Transformation(f"t{number}", inputs, (port,), *costs, requires=requires, source="units.py:t"))
    wish = (Wish("e", weight_us=chance.randrange(1, 4) * MICRO),) if stated else ()
    facts = (Fact("v", 2 * MICRO), Fact("night", False))
    hosts = tuple(
        Host(name, cpu_us=MICRO, speed=chance.choice((MICRO, 2 * MICRO))) for name in chance.choice(("ab", "abc"))
    )
    return Environment(
        (),
        tuple(library),
        (Target("g", chance.choice("ABC"), "/g", quality=wish),),
        hosts if has_hosts else (),
        (QualityAttribute("e", Better.LOWER, worst=5 * MICRO),) if stated else (),
        1000 if has_hosts else 0,
        facts=(*facts, Fact("battery", 50 * MICRO, of="host", hosts={"b": 10 * MICRO})) if has_hosts else facts,
    )


def _holds(environment: Environment, requires: str | None, host: str) -> bool:
    facts = {one.name: one for one in environment.variable.values() if one.host in (None, host)}
    return requires is None or why_left_out(requires, facts) is None


def written_out(environment: Environment) -> Environment:
    """Return the same world without facts: each transformation lists the hosts where its requirement holds."""
    library = []
    for t in environment.library:
        hosts = [
            host for host in environment.host or [""] if t.requires is None or _holds(environment, t.requires, host)
        ]
        if hosts:
            library.append(replace(t, requires=None, hosts=tuple(hosts) if environment.hosts else ()))
    return replace(environment, library=tuple(library), facts=())


def outcome(plan: Plan) -> tuple[Status, int | None]:
    """Return the status and the cost of a plan, which must be the same for all planners."""
    return plan.status, plan.cost_us


class Lived:
    """A run of one world."""

    def __init__(self, seed: int) -> None:
        self.chance = random.Random(seed)
        self.world = api.world(drawn(self.chance), horizon_s=HORIZON_S)
        hosts, labels = self.world.environment.host, [t.label for t in self.world.environment.library]
        units = [f"{label} on {host}" for label in labels for host in hosts] or labels
        errors = {unit: self.chance.uniform(0.05, 1.0) for unit in units}
        says = any(t.outputs[0].quality for t in self.world.environment.library)
        behaviours = {unit: self._saying(error) if says else Behaviour() for unit, error in errors.items()}
        self.runtime = SimulatedRuntime(behaviours=behaviours)
        policy = Policy(look_every_s=None)
        self.manager = Manager(self.world, self.runtime, clock=self.runtime.clock, policy=policy)
        self._settle()

    def _saying(self, error: float) -> Behaviour:
        def says(_: float) -> Qualities:
            values = [error * (1 + 0.05 * self.chance.gauss(0, 1)) for _ in range(5)]
            mean = sum(values) / len(values)
            return {"o": {"e": Quality(len(values), mean, sum((one - mean) ** 2 for one in values))}}

        return Behaviour(says=says)

    def _settle(self) -> None:
        self.manager.step()
        while not self.manager.is_settled:
            self.manager.step(5.0)

    def told(self) -> None:
        """Give the run new values of one to three facts, and new elements of streams."""
        for _ in range(self.chance.randint(1, MOST_TOLD)):
            key = self.chance.choice(sorted(self.world.environment.variable))
            self.manager.request(SetFact(key, self.chance.choice(VALUES[key.rpartition(".")[2]])))
            self._settle()
            self.manager.run(self.chance.uniform(0, 20))
            self._settle()

    def observed(self, file: Path) -> Environment:
        """Return the running configuration in the world as `--observed` reads it from `file`."""
        snapshot = self.manager.snapshot()
        state = snapshot_record(snapshot)
        file.write_text(observed_text(state["facts"], state["qualities"]), encoding="utf-8")
        return replace(read_observed(file, self.world.environment), units=self.runtime.environment.units)


def problem_of(environment: Environment) -> Problem:
    """Return the problem of an environment with atomic tags."""
    return api.match(api.world(environment, horizon_s=HORIZON_S))


def differences(run: Lived, file: Path) -> Iterator[str]:
    """Yield each difference between the present plans for a run."""
    environment = run.observed(file)
    problem, plain = problem_of(environment), problem_of(written_out(environment))
    plan = PLANNERS["cpsat"](problem)
    if found := plan_violations(problem, plan):
        yield f"the judge refuses the plan: {found[0]}"
    for name, other in (("written out", PLANNERS["cpsat"](plain)), ("oracle", PLANNERS["exhaustive"](problem))):
        if outcome(plan) != outcome(other):
            yield f"{outcome(plan)}, but {name} {outcome(other)}"
    future = run.manager.preview()
    run._settle()
    review = future.result(0).findings
    reviewed = (review.change_set is not None and not review.unmet, review.cost_us if not review.unmet else None)
    if reviewed != (plan.change_set is not None, plan.cost_us):
        yield f"{outcome(plan)} with --observed, but the review {reviewed}"


def compared(worlds: range) -> tuple[Counter[str], list[str]]:
    """Return the number of worlds of each kind, such as `with units`, and all differences."""
    counts: Counter[str] = Counter()
    found = []
    with tempfile.TemporaryDirectory() as folder:
        for seed in worlds:
            run = Lived(seed)
            run.told()
            found += [f"world {seed}: {one}" for one in differences(run, Path(folder, "now.json"))]
            snapshot = run.manager.snapshot()
            kinds = {
                "worlds": True,
                "with units": snapshot.units,
                "with some left out": snapshot.left_out,
                "with some barred from hosts": snapshot.barred,
                "with other qualities": any(each.planned != each.stated for each in snapshot.qualities),
                "with qualities of hosts": any(each.host is not None for each in snapshot.qualities),
            }
            counts.update(kind for kind, is_so in kinds.items() if is_so)
    return counts, found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--worlds", type=int, default=1000)
    parser.add_argument("--first", type=int, default=0, help="the seed of the first world")
    options = parser.parse_args()
    counts, found = compared(range(options.first, options.first + options.worlds))
    print(*found, f"{dict(counts)}: {len(found)} differences", sep="\n")


if __name__ == "__main__":
    main()
