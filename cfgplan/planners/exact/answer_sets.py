"""Answer sets prove networks with many cycles and few different costs, if the extra `cycles` is installed.

An answer set is grounded by definition, so no cycle has to be cut. If costs are equal, unsatisfiable cores raise the
bound fast; if they differ, landmarks and linear programs are many times faster.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

from cfgplan.extras import is_there
from cfgplan.planners.exact.remaining import Remaining
from cfgplan.planners.exact.solve_run import SolveRun, numbers
from cfgplan.planners.networks.core import Ints
from cfgplan.planners.networks.greedy import first_plan
from cfgplan.planners.networks.network import LexicographicWeights, Network
from cfgplan.planners.solving.arrays import np
from cfgplan.planners.solving.clock import Clock
from cfgplan.planners.tuning import attempts_among

if TYPE_CHECKING:
    from clingo import Model

LARGEST_WEIGHT: Final = 2**31 - 1
"""The largest weight that clingo takes."""


def prove(work: SolveRun) -> bool:
    """Have clingo raise the bound for some conflicts, and for many if that brings it near the first plan."""
    network, clock, tuning = work.structure.network, work.clock, work.clock.tuning.cycles
    weights = LexicographicWeights.with_changes(work.problem, network)
    if weights is None or not _is_fit(weights, tuning.values) or not is_there("clingo"):
        return False
    first = first_plan(network, weights.weight, attempts_among(network.labels, clock.tuning), clock)
    if first is None:
        return False
    plan = numbers(first)
    program = LogicProgram(network, weights, clock)
    room = (1 - tuning.near) * weights.of_plan(plan)
    if not program.run(tuning.first, clock) and program.value >= room:
        program.run(tuning.conflicts, clock)
    plan = min((plan, *program.plans), key=weights.of_plan)
    work.take(Remaining(plan, program.value, is_complete=False), network, weights, plan)
    work.state.counts["conflicts"] = program.conflicts
    clock.end("bounds")
    return work.state.is_over


def _is_fit(weights: LexicographicWeights, most: int) -> bool:
    """Whether clingo can weigh these costs: they have few values, and each is small enough."""
    costs = weights.weight // weights.scale
    return len(set(costs.tolist())) <= most and int(costs.max(initial=0)) // _unit(costs) <= LARGEST_WEIGHT


def _unit(costs: Ints) -> int:
    """The greatest common divisor of the costs."""
    return max(1, int(np.gcd.reduce(costs)))


class LogicProgram:
    """A network as a logic program: a label may run if its needs hold, and a fact holds if one of its providers runs.

    Raises OutOfTimeError.
    """

    def __init__(self, network: Network, weights: LexicographicWeights, clock: Clock) -> None:
        import clingo  # there with the extra only

        weight = weights.weight.copy()
        weight[network.pinned] = 0  # they run in every plan
        core, unit_us = network.core, _unit(weight // weights.scale)
        costs, changes = weight // weights.scale // unit_us, weight % weights.scale
        self._weighing, self._unit = weights, unit_us * weights.scale
        self.plans: list[Ints] = []
        """The plans found so far, each better than the one before."""
        self.value = 0
        """No plan weighs less."""
        self.conflicts = 0
        self._control = clingo.Control(["--opt-strategy=usc,oll,stratify", "--warn=none"])
        with self._control.backend() as backend:
            self._runs = [backend.add_atom() for _ in network.labels]
            holds = [backend.add_atom() for _ in range(len(core.providers))]
            for label, runs in clock.each(enumerate(self._runs)):
                backend.add_rule([runs], [holds[fact] for fact in core.needs.lists[label]], choice=True)
            for fact, atom in clock.each(enumerate(holds)):
                for label in core.providers.lists[fact]:
                    backend.add_rule([atom], [self._runs[label]])
            wanted = [holds[fact] for fact in core.needs.lists[core.goal]]
            for atom in [*wanted, *(self._runs[label] for label in network.pinned)]:
                backend.add_rule([], [-atom])
            backend.add_minimize(1, list(zip(self._runs, costs.tolist(), strict=True)))
            if (
                costs * changes.max(initial=0) != costs.max(initial=0) * changes
            ).any():  # else the least cost has the fewest changes
                backend.add_minimize(0, list(zip(self._runs, changes.tolist(), strict=True)))

    def run(self, conflicts: int, clock: Clock) -> bool:
        """Go on for so many conflicts. Returns whether the last of the plans is proven best."""
        self._control.configuration.solve.solve_limit = str(conflicts)  # type: ignore[union-attr]
        with self._control.solve(on_model=self._keep, on_unsat=self._raise, async_=True) as handle:
            while not handle.wait(0.05):
                if clock.is_over():
                    handle.cancel()
            is_proven = bool(handle.get().exhausted)
        self.conflicts += int(self._control.statistics["solving"]["solvers"]["conflicts"])
        if is_proven:
            self.value = self._weighing.of_plan(self.plans[-1])
        return is_proven

    def _keep(self, model: Model) -> None:
        self.plans.append(numbers(label for label, runs in enumerate(self._runs) if model.is_true(runs)))

    def _raise(self, lower: Sequence[int]) -> None:
        self.value = max([self.value, *(cost * self._unit for cost in lower[:1])])
