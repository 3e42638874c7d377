"""Cuts on chains of streams, chosen because the linear relaxation violates them.

The relaxation has landmarks, what units need and the cuts so far. Its solution runs each unit to some share. Potentials
are chosen by a chain that takes the best streams first, as far as their shares reach.
"""

from __future__ import annotations

from collections.abc import Iterable

from cfgplan.domain import Target
from cfgplan.planners.closing.program import FROM_THE_LAST_BASIS
from cfgplan.planners.exact.candidates import Candidates
from cfgplan.planners.exact.quality_chains import ChainCut, Chains, Root
from cfgplan.planners.networks.core import Floats, Ints
from cfgplan.planners.solving.arrays import np
from cfgplan.planners.solving.clock import Clock
from cfgplan.qualities import MICRO, Wish

ChainLandmarks = Iterable[tuple[Iterable[str], int]]


def chain_cuts(candidates: Candidates, landmarks: ChainLandmarks, clock: Clock) -> tuple[list[ChainCut], Floats]:
    """Return cuts for all wishes of targets, and each candidate's share in the relaxation; no cuts if that is too
    large.

    The wishes must be about one attribute. Every plan runs at least one label of each of the `landmarks`.
    """
    tuning, network = clock.tuning.quality, candidates.network
    is_met = len(network.targets) == len(candidates.environment.targets)
    if not is_met or int(np.diff(network.core.providers.starts)[network.core.needs.items].sum()) > tuning.largest:
        return [], np.zeros(len(candidates.all))
    relaxation = _Relaxation(candidates, landmarks)
    values: list[float] = []
    while len(values) < tuning.rounds and not clock.is_over() and relaxation.solve(clock.left_s()):
        values.append(relaxation.value_us)
        if not relaxation.cut() or (
            len(values) > tuning.wait and values[-1] - values[-1 - tuning.wait] < tuning.rise * values[-1]
        ):
            break
    return relaxation.cuts, relaxation.share


class _Asked:
    """The wish of a target, and its badness in the relaxation: between `least` and `most`, in units of `unit`."""

    def __init__(self, candidates: Candidates, chains: Chains, target: Target, wish: Wish) -> None:
        self.target, self.wish = target.label, wish
        self.root = Root(chains, target.tag)
        self.least = int(chains.best[self.root.demand])
        self.most = max(self.least, candidates.bounds.get((target.label, wish.attribute), chains.scale))
        self.unit = float(max(1, self.least, self.most - self.least))


class _Relaxation:
    """The linear relaxation of the running labels, with one unit each.

    `value_us` is the solver's bound on the cost, with the precision of its floats.
    """

    def __init__(self, candidates: Candidates, landmarks: ChainLandmarks) -> None:
        from ortools.linear_solver import pywraplp  # type: ignore[import-untyped]

        self._candidates, self._tuning = candidates, candidates.clock.tuning.quality
        self._optimal = pywraplp.Solver.OPTIMAL
        self.lp = pywraplp.Solver.CreateSolver("GLOP")
        self.lp.SuppressOutput()
        self.lp.SetSolverSpecificParametersAsString(FROM_THE_LAST_BASIS)
        self.cuts: list[ChainCut] = []
        self.value_us = 0.0
        self.share = np.zeros(len(candidates.all))
        cost_us = candidates.least_us.tolist()
        self._unit_us = float(max(1, *cost_us))
        firsts = [candidates.units_of(label)[0] for label in candidates.network.labels]
        self._uses = {unit: self.lp.NumVar(0.0, 1.0, "") for unit in candidates.clock.each(firsts)}
        self._variables = list(self._uses.values())
        objective = self.lp.Objective()
        objective.SetMinimization()
        for uses, us in zip(self._uses.values(), cost_us, strict=True):
            objective.SetCoefficient(uses, us / self._unit_us)
        wishes = [(target, wish) for target in candidates.environment.targets for wish in target.quality]
        chains = Chains(candidates, candidates.environment.quality[wishes[0][1].attribute])
        self._asked = [_Asked(candidates, chains, target, wish) for target, wish in wishes]
        self._badness = [self.lp.NumVar(asked.least / asked.unit, asked.most / asked.unit, "") for asked in self._asked]
        for asked, badness in zip(self._asked, self._badness, strict=True):
            objective.SetCoefficient(badness, asked.unit * asked.wish.weight_us / MICRO / self._unit_us)
        self._need(landmarks)

    def _need(self, landmarks: ChainLandmarks) -> None:
        core, clock = self._candidates.network.core, self._candidates.clock
        for labels, _ in clock.each(landmarks):
            self._any_of(self._candidates.numbers(set(labels)))
        for label in clock.each(range(core.goal + 1)):
            for fact in core.needs.lists[label]:
                first = [provider for provider in core.providers.lists[fact] if fact not in core.needs.lists[provider]]
                self._any_of(first, label if label < core.goal else None)

    def _any_of(self, labels: list[int], unless_without: int | None = None) -> None:
        """Demand that one of `labels` is used; if `unless_without` is a label, only where that is used."""
        uses = self._variables
        row = self.lp.Constraint(1.0 if unless_without is None else 0.0, self.lp.infinity())
        for label in labels:
            row.SetCoefficient(uses[label], 1.0)
        if unless_without is not None and unless_without not in labels:
            row.SetCoefficient(uses[unless_without], -1.0)

    def solve(self, time_limit_s: float | None) -> bool:
        if time_limit_s is not None:
            self.lp.SetTimeLimit(1 + int(900 * time_limit_s))
        if self.lp.Solve() != self._optimal:
            return False
        self.value_us = self.lp.Objective().Value() * self._unit_us
        return True

    def cut(self) -> bool:
        """Add the cuts that are violated; False if there are none."""
        share = self.share
        for unit, uses in self._uses.items():
            share[unit] = uses.solution_value()
        now = [badness.solution_value() * asked.unit for asked, badness in zip(self._asked, self._badness, strict=True)]
        before = len(self.cuts)
        for asked, badness, known in zip(self._asked, self._badness, now, strict=True):
            potential, bounded = _best_potential(asked.root, share)
            if bounded - known > self._tuning.least * max(1.0, known):
                potential = asked.root.lifted(potential)
                ahead, least = asked.root.ahead(potential), int(potential[asked.root.demand])
                units = self._candidates.all
                cut = {units[i].id: int(ahead[i]) for i in np.flatnonzero(ahead).tolist()}
                self.cuts.append(ChainCut(asked.target, asked.wish.attribute, least, cut))
                row = self.lp.Constraint(least / asked.unit, self.lp.infinity())
                row.SetCoefficient(badness, 1.0)
                for unit, uses in self._uses.items():
                    if ahead[unit]:
                        row.SetCoefficient(uses, float(ahead[unit]) / asked.unit)
        return len(self.cuts) > before


def _best_potential(root: Root, share: Floats) -> tuple[Ints, float]:
    """Potentials that give a high bound on a target's badness at these shares of units, and that bound."""
    best, most = root.chains.best, -np.inf
    amount = np.where(root.is_before, 1.0, 0.0)
    for _ in range(root.chains.tuning.guesses):
        potential = _reached(root, share, amount)
        bounded = float(potential[root.demand] - root.ahead(potential) @ share)
        if bounded > most:
            best, most = potential, bounded
        amount = _flow(root, share, potential)
    return best, most


def _reached(root: Root, share: Floats, amount: Floats) -> Ints:
    """For each demand the badness of the last stream that its amount takes, the best streams first."""
    chains = root.chains
    potential = chains.best
    for _ in range(chains.tuning.passes):
        met = chains.met(potential)
        order = np.lexsort((met, chains.pair_demand))
        so_far = np.cumsum(share[chains.pair_unit[order]])
        so_far -= np.append(0.0, so_far)[chains.starts][chains.pair_demand]
        is_enough = so_far >= amount[chains.pair_demand] - 1e-6
        last = np.minimum.reduceat(np.where(is_enough, np.arange(len(order)), len(order)), chains.starts)
        found = met[order][np.minimum(last, chains.ends - 1)]
        found = np.where(root.is_before, np.clip(found, chains.best, chains.scale), chains.best)
        if (found == potential).all():
            break
        potential = found
    return potential


def _flow(root: Root, share: Floats, potential: Ints) -> Floats:
    """The amount of each demand that one unit of flow to the root passes, the best streams first."""
    chains = root.chains
    amount = np.zeros(len(chains.demand))
    amount[root.demand] = 1.0
    met, left = chains.met(potential), share.copy()
    ahead, done = {root.demand}, set()
    while ahead:
        demand = max(ahead, key=lambda d: (int(potential[d]), d))
        ahead.remove(demand)
        done.add(demand)
        wanted = amount[demand]
        pairs = np.arange(chains.starts[demand], chains.ends[demand])
        pairs = pairs[left[chains.pair_unit[pairs]] > 1e-7]
        for pair in pairs[np.argsort(met[pairs], kind="stable")].tolist():
            if wanted <= 1e-6:
                break
            unit = chains.pair_unit[pair]
            taken = min(wanted, left[unit])
            wanted -= taken
            left[unit] -= taken
            for before, part in chains.deciding(int(chains.pair_stream[pair]), potential):
                if before not in done:
                    amount[before] += taken * part
                    ahead.add(before)
    return amount
