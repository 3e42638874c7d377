"""Large neighbourhood search over related targets (Shaw 1998): some targets are replanned, all others stay fixed.

In a plan for many targets, the labels that only a few of them need are given up, and the solver looks for cheaper ones;
all other labels are there for nothing. Targets that share little seldom gain together, so they are drawn by the cost
that they share: in the plan, or in the fractions of the linear program of closing.
"""

from __future__ import annotations

from collections.abc import Container, Iterable, Iterator, Mapping

from cfgplan.planners.bounding.bounds import Bound, tightened
from cfgplan.planners.networks.core import Core, Flags, Floats, Ints, Rows
from cfgplan.planners.networks.reach import Reach
from cfgplan.planners.solving.arrays import np
from cfgplan.planners.solving.clock import Clock
from cfgplan.planners.tuning import Near

Labels = frozenset[int]


class Neighbourhoods:
    """Improves a plan: a set of labels of a core that meets its goal. `best` is the best one so far.

    `bound` is one for all plans of the core. The costs of its labels are multiples of `step`; `fractions` say how much
    of each the linear program uses. The random numbers are seeded, and the solver's work is limited by its own measure,
    so that a search can be repeated.
    """

    def __init__(self, bound: Bound, plan: Iterable[int], fractions: Floats, step: int, tuning: Near) -> None:
        self._bound, self._step, self._tuning = bound, step, tuning
        self._core, self._cost = core, cost = bound.core, bound.cost
        self._wanted = core.needs.lists[core.goal]
        self._draw = np.random.default_rng(core.goal)
        self._size: float = tuning.fewest
        self._took: float = 0.0  # of the engine's seconds
        self._in_vain: float = 0.0
        self._look = tuning.look + tuning.link * core.links
        self._scale = core.goal**1.5 / 1e6
        self._fractions = fractions
        use = cost * np.minimum(1.0, fractions)
        self._used = self._flags(self._reached(fact, fractions) for fact in self._wanted) * use
        self.best = self._lean(frozenset(plan))

    @property
    def limit(self) -> int:
        """The cost of the best plan."""
        return self._cost_of(self.best)

    @property
    def labels(self) -> Ints:
        """The labels of the best plan, as the network numbers them."""
        return self._core.labels[[*self.best]]

    @property
    def took_s(self) -> float:
        """The work so far, in the engine's seconds."""
        return self._took

    def are_in_vain(self, work: float) -> bool:
        """Whether the last cheaper plan was `work` ago or more, in the engine's microseconds per label^1.5."""
        return bool(self._in_vain >= work * self._scale)

    def go_on(self, clock: Clock) -> None:
        """Look for a cheaper plan: first among the labels in use, the most used first, then near changing targets."""
        before, limit = self._took, self.limit
        if before:
            self._near(self._related(), clock)
        else:
            for fraction in self._tuning.kernels:
                if not clock.is_over():
                    self._from_likely_labels(fraction, clock)
        if self.limit < limit:
            self._in_vain = 0.0
        elif before:
            self._in_vain += self._took - before

    def _related(self) -> set[int]:
        """Draw some targets that share cost."""
        most = min(round(self._size), len(self._wanted))
        number = int(self._draw.integers((most + 1) // 2, most + 1))
        is_of_plan = self._draw.random() < self._tuning.planned
        price = self._flags(self._supports()) * self._cost if is_of_plan else self._used
        first = int(self._draw.integers(len(self._wanted)))
        free, pool = [first], price[first] > 0
        while len(free) < number:
            shared = price @ pool
            if not is_of_plan:
                shared /= 1 + price.sum(axis=1)
            shared[free] = 0.0
            weight = (shared / max(shared.max(), 1e-9) + 1e-3) ** 2
            weight[free] = 0.0
            free.append(int(self._draw.choice(len(weight), p=weight / weight.sum())))
            pool |= price[free[-1]] > 0
        return {self._wanted[i] for i in free}

    def _near(self, free: set[int], clock: Clock) -> None:
        """Replan these targets.

        The next neighbourhoods are larger if this one was searched soon, smaller if the solver could not finish.
        """
        others = [fact for fact in self._wanted if fact not in free]
        kept = _support(self._core, _first_givers(self._core, self.best), others)
        limit = self.limit - self._cost_of(kept) - self._step
        cost = self._cost.copy()
        cost[list(kept)] = 0
        bound = tightened(self._bound_for(free, cost), limit + 1, limit, clock, greedily=True)
        before, self._took = self._took, self._took + self._look
        if bound.value <= limit and not clock.is_over():
            found = self._cheapest(bound.restricted(bound.may_be_used(limit)), limit, clock, self._tuning.work)
            self._take(kept | found)
        share = (self._took - before) / self._tuning.work
        self._size *= self._tuning.growth if share < 0.5 else 1 / self._tuning.growth if share >= 1 else 1
        self._size = min(max(self._size, self._tuning.fewest), len(self._wanted))

    def _from_likely_labels(self, least: float, clock: Clock) -> None:
        """Look for a plan among the labels of the plan and those whose fraction in the linear program exceeds `least`
        (kernel search: Angelelli, Mansini and Speranza 2010).
        """
        limit = self.limit - self._step
        self._took += self._look
        likely = {int(label) for label in np.flatnonzero(self._fractions > least)} | self.best
        first = _first_givers(self._core, likely)
        fed = [label for label in likely if first.keys() >= set(self._core.needs.lists[label])]
        keep = np.isin(np.arange(self._core.goal), fed)
        bound = tightened(Bound(self._core, self._cost).restricted(keep), limit + 1, limit, clock, greedily=True)
        self._take(
            self._cheapest(bound.restricted(bound.may_be_used(limit)), limit, clock, self._tuning.kernel * self._scale)
        )

    def _take(self, labels: Labels) -> None:
        """Take the labels without what they can do without, if they are a plan and cheaper."""
        if _first_givers(self._core, labels).keys() >= set(self._wanted):
            self.best = min(self.best, self._lean(labels), key=self._cost_of)

    def _bound_for(self, free: set[int], cost: Ints) -> Bound:
        """A bound for these targets only, at these costs, from the landmarks that they need."""
        core, known = self._core, self._bound
        needs = core.needs.starts[core.goal]
        starts = np.append(core.needs.starts[:-1], needs + len(free))
        rows = Rows((starts, np.append(core.needs.items[:needs], sorted(free))))
        needed = [i for i, one in enumerate(known.landmarks) if not free.isdisjoint(one.zone.tolist())]
        part = Core(rows, core.providers, core.numbers)
        bound = Bound(part, cost, [known.landmarks[i] for i in needed])
        bound.recharge([known.weights[i] for i in needed])
        return bound

    def _cheapest(self, bound: Bound, limit: int, clock: Clock, work: float) -> Labels:
        """Return labels that meet a bound's goal at a cost within `limit`, by the solver; none if it finds none."""
        from ortools.sat.python.cp_model import FEASIBLE, OPTIMAL

        from cfgplan.planners.closing.fed_model import FedModel
        from cfgplan.planners.solving.engine import repeatable_solver, solve

        core = bound.core
        model = FedModel(core, bound.cost // self._step, bound.short())
        model.add(model.cost <= limit // self._step)
        model.minimize(model.cost)
        labels = np.searchsorted(self._core.labels, core.labels)
        for label, use in zip(labels.tolist(), model.uses, strict=True):
            model.add_hint(use, label in self.best)
        end = self._took + work
        while self._took < end and not clock.is_over():
            solver = repeatable_solver(small=core.goal < self._tuning.small, time_limit_s=clock.left_s())
            solver.parameters.max_deterministic_time = end - self._took
            status = solve(solver, model, clock)
            self._took += solver.response_proto.deterministic_time + self._look
            if status not in (OPTIMAL, FEASIBLE):
                break
            used = [label for label, use in enumerate(model.uses) if solver.boolean_value(use)]
            first = _first_givers(core, used)
            if first.keys() >= set(core.needs.lists[core.goal]):
                return frozenset(labels[used].tolist())
            model.add_bool_or([model.uses[label] for label in _ways_on(core, first)])
        return frozenset()

    def _supports(self) -> Iterator[Labels]:
        """For each target, the labels of the best plan that it rests on."""
        first = _first_givers(self._core, self.best)
        return (_support(self._core, first, [fact]) for fact in self._wanted)

    def _flags(self, labels: Iterable[Labels]) -> Flags:
        """Flags of the labels in each row; shape (targets, labels)."""
        flags = np.zeros((len(self._wanted), self._core.goal), np.bool_)
        for row, these in zip(flags, labels, strict=True):
            row[list(these)] = True
        return flags

    def _reached(self, target: int, fractions: Floats) -> Labels:
        """The labels that the linear program uses, as far as they may feed a target."""
        core, seen, ahead, found = self._core, {target}, [target], set[int]()
        for fact in ahead:
            for label in core.providers.lists[fact]:
                if label not in found and fractions[label] > self._tuning.used:
                    found.add(label)
                    new = [one for one in core.needs.lists[label] if one not in seen]
                    seen.update(new)
                    ahead += new
        return frozenset(found)

    def _lean(self, plan: Labels) -> Labels:
        """A plan without labels that it can do without; the most expensive are tried first."""
        plan = _support(self._core, _first_givers(self._core, plan), self._wanted)
        for label in sorted(plan, key=lambda one: (-self._cost[one], one)):
            first = _first_givers(self._core, plan - {label}) if label in plan else {}
            if first.keys() >= set(self._wanted):
                plan = _support(self._core, first, self._wanted)
        return plan

    def _cost_of(self, labels: Labels) -> int:
        return int(self._cost[list(labels)].sum())


def _first_givers(core: Core, labels: Iterable[int]) -> dict[int, int]:
    """For each fact that these labels give, grounded among themselves, the label that gives it first."""
    first: dict[int, int] = {}
    for label in Reach(core, labels).order:
        for fact in core.gives.lists[label]:
            first.setdefault(fact, label)
    return first


def _support(core: Core, first: Mapping[int, int], facts: Iterable[int]) -> Labels:
    """The labels that feed these facts, directly or through others, each fact by its first provider."""
    ahead, found = [*facts], set[int]()
    for fact in ahead:
        if first[fact] not in found:
            found.add(first[fact])
            ahead += core.needs.lists[first[fact]]
    return frozenset(found)


def _ways_on(core: Core, reached: Container[int]) -> Iterator[int]:
    """The labels that can be fed by the facts reached, and give another one."""
    for label in range(core.goal):
        gives = core.gives.lists[label]
        if any(fact not in reached for fact in gives) and all(fact in reached for fact in core.needs.lists[label]):
            yield label
