"""Storms: one random perturbation after the other, after which all must be as good as it can be."""

from __future__ import annotations

import random
from dataclasses import replace

from cfgplan_runtime import Manager
from cfgplan_runtime.lifecycle.changes import (
    AddTargets,
    AddTransformations,
    Change,
    KillUnit,
    LoseHost,
    RegainHost,
    RemoveTargets,
    RemoveTransformations,
    ReviewNow,
)

from cfgplan.domain import Environment, InputPort, OutputPort, Target, Transformation
from cfgplan.explaining import best_effort
from cfgplan.matching import Matcher
from cfgplan.planners import PLANNERS
from cfgplan.planning import Problem, Status
from cfgplan.validity import Rule, violations

LAYERS = "ABCD"
HOSTS = (None, None, "near", "far")


def library(randoms: random.Random, *, code: dict[int, str], is_free_to_start: bool = False) -> list[Transformation]:
    """Sources of A, and for each further layer transformations that need one or two tags of the layer before.

    `code` gives the unit code for each number of inputs.
    """
    made = []
    for layer, letter in enumerate(LAYERS):
        for number in range(4):
            width = 0 if layer == 0 else randoms.choice((1, 1, 2))
            made.append(
                Transformation(
                    f"{letter.lower()}{number}",
                    tuple(InputPort(f"x{port}", f"{LAYERS[layer - 1]}{randoms.randrange(2)}") for port in range(width)),
                    (OutputPort("y", f"{letter}{number % 2}"),),
                    0 if is_free_to_start else randoms.randrange(1, 1000) * 1000,
                    randoms.randrange(1, 1000),
                    source=code[width],
                    host=randoms.choice(HOSTS),
                )
            )
    return made


def targets() -> list[Target]:
    """One for each tag of the last two layers, some more important than others."""
    return [
        Target(f"{letter}{number}", f"{letter}{number}", f"/{letter}{number}", priority=number)
        for letter in LAYERS[2:]
        for number in range(2)
    ]


class Storm:
    """Draws perturbations for a manager; what it takes away it may give back."""

    def __init__(self, seed: int, known: list[Transformation], wanted: list[Target]) -> None:
        self.randoms = random.Random(seed)
        self._known = {transformation.label: transformation for transformation in known}
        self._wanted = {target.label: target for target in wanted}

    def change(self, manager: Manager) -> Change:
        """A change that fits the state of the manager."""
        world, randoms, seen = manager.world.environment, self.randoms, manager.snapshot()
        gone = sorted(set(self._known) - set(world.transformation))
        unwanted = sorted(set(self._wanted) - set(world.target))
        choices: list[Change] = [ReviewNow()]
        choices += [KillUnit(randoms.choice(seen.units).unit.id)] * 4 if seen.units else []
        if len(world.library) > 8:
            choices += [RemoveTransformations((randoms.choice(world.library).label,))] * 2
        if gone:
            choices += [AddTransformations((self._known[randoms.choice(gone)],))] * 2
        if len(world.targets) > 1:
            choices.append(RemoveTargets((randoms.choice(world.targets).label,)))
        if unwanted:
            choices.append(AddTargets((self._wanted[randoms.choice(unwanted)],)))
        changed = randoms.choice(world.library)
        choices.append(AddTransformations((replace(changed, upkeep_us=randoms.randrange(1, 1000)),)))
        choices.append(AddTransformations((replace(changed, params={"seed": randoms.random()}),)))
        lost = seen.lost_hosts
        choices.append(RegainHost(lost[0]) if lost else LoseHost(randoms.choice(("near", "far"))))
        return randoms.choice(choices)


def assert_as_good_as_it_can_be(manager: Manager, running: Environment, *, is_free_to_start: bool) -> None:
    """What runs is valid and meets all that can be met at the least cost, by a planner that knows no session."""
    world, lost = manager.world, manager.snapshot().lost_hosts
    possible = tuple(t for t in world.environment.library if t.host not in lost)
    now = Environment(running.units, possible, world.environment.targets)
    matcher = Matcher(world.ontology)
    matcher.add(
        offered={port.tag for t in possible for port in t.outputs},
        demanded={port.tag for t in possible for port in t.inputs} | {target.tag for target in now.targets},
    )
    similarity = matcher.matching().similarity
    problem = Problem(now, similarity, world.horizon_s)
    again = best_effort(problem, PLANNERS["cpsat"])
    assert (again.plan.status, bool(again.plan.change_set)) == (Status.OPTIMAL, False)
    fresh = best_effort(replace(problem, environment=replace(now, units=())), PLANNERS["cpsat"])
    assert fresh.unmet == again.unmet
    broken = [v for v in violations(now, similarity) if not (v.rule is Rule.MET and v.target in fresh.unmet)]
    assert broken == []
    if is_free_to_start:
        assert again.plan.cost_us == fresh.plan.cost_us
