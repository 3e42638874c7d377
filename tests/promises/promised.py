"""Plans of environments that are written as in a file, for the promises of the manual."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cfgplan
from cfgplan.domain import ComputationUnit, Environment
from cfgplan.planning import Plan, Problem


@dataclass(frozen=True)
class Solved:
    """An environment's problem, and the planner's answer."""

    problem: Problem
    plan: Plan

    @property
    def after(self) -> Environment:
        return self.problem.after(self.plan)

    @property
    def started(self) -> list[str]:
        assert self.plan.change_set is not None, self.plan
        return [unit.id for unit in self.plan.change_set.started]

    @property
    def runs(self) -> list[str]:
        """The transformations of the units that run, spares left out."""
        return sorted(unit.transformation for unit in self.after.units if not unit.standby)

    @property
    def cost_s(self) -> float:
        assert self.plan.cost_us is not None, self.plan
        return self.plan.cost_us / 1e6

    def unit(self, name: str) -> ComputationUnit:
        return self.after.unit[name]

    def hosts_of(self, label: str) -> list[str | None]:
        return sorted(unit.host or "" for unit in self.after.units if unit.transformation == label)


def solved(folder: Path, text: str, **how: Any) -> Solved:
    """What the planner answers to a file; `format`, and a horizon of 10 s unless it says one, are added."""
    path = folder / "env.yaml"
    horizon = "" if "horizon:" in text else "horizon: 10\n"
    path.write_text(f"format: cfgplan/1\n{horizon}{text}")
    problem = cfgplan.match(cfgplan.load(path))
    return Solved(problem, cfgplan.plan(problem, **how))
