"""Bound and plan brought together: missed landmarks raise the one, repairs lower the other, in turn."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from cfgplan.planners.bounding.bounds import Bound
from cfgplan.planners.bounding.landmarks import Landmark, landmark_of
from cfgplan.planners.closing.neighbourhoods import Neighbourhoods
from cfgplan.planners.closing.program import LandmarkProgram, label_kinds
from cfgplan.planners.closing.separation import Separator
from cfgplan.planners.networks.core import Core, Floats, Ints
from cfgplan.planners.networks.greedy import FREE, cost_of, plan_at
from cfgplan.planners.networks.network import Network
from cfgplan.planners.solving.arrays import np
from cfgplan.planners.solving.clock import Clock
from cfgplan.planners.tuning import USUAL, Close, Tuning


class GapClosing:
    """Closes the optimality gap: improves a plan, and the bound for plans that cost no more, until they meet.

    `cost` holds the costs of all labels of the network, multiples of `step`.
    """

    def __init__(
        self, network: Network, bound: Bound, cost: Ints, plan: Ints, step: int, tuning: Tuning = USUAL
    ) -> None:
        self.bound = bound
        self._tuning = own = tuning.close
        self._near = tuning.near
        self._solving = tuning.rise.last_patience
        self._network = network
        self._cost = cost
        self._step = step
        self._repair_steps = own.repair + own.repair_need * len(network.core.needs.items)
        self._repair_steps += tuning.rise.link * network.core.deep_links
        self._repairs = Repairs(network, cost, set(plan.tolist()), own)
        self._kinds = label_kinds(network, cost)
        self._draw = np.random.default_rng(bound.core.goal)
        self._built: tuple[LandmarkProgram, list[Landmark], Separator] | None = None
        self._fractions: Floats = np.zeros(len(cost))

    @property
    def plan(self) -> Ints:
        return np.array(sorted(self._repairs.best), np.int64)

    @property
    def limit(self) -> int:
        """The plan's cost."""
        return int(self._cost[self.plan].sum())

    @property
    def is_closed(self) -> bool:
        """True if the bound proves that no plan is cheaper."""
        return self.bound.value > self.limit - self._step

    @property
    def _is_far(self) -> bool:
        """Whether the gap is so large that the solver has little hope, however few labels are left."""
        return self._gap > self._tuning.far

    def _is_beyond_the_solver(self, clock: Clock) -> bool:
        """Whether the solver has little hope: the gap is large, or labels are too many for the time that is left.

        If targets are replanned next, which takes most of the time, only the gap counts.
        """
        return self._is_far or not (self._is_near_next or clock.has_steps(self._solving * self._left**1.5))

    def go_on(self, clock: Clock, tell: Callable[[], None] = lambda: None) -> None:
        """Raise the bound and look for a cheaper plan until they meet or hardly move, or the work is used up.

        After the first linear program, cheaper plans are left to `look_near` if that gets most of the time. Calls
        `tell` after each round.
        """
        own = self._tuning
        took = self._begin(clock)
        tell()
        steps = own.work * self._left**1.5
        while not self.is_closed and self._can_be_built(clock):
            is_patient = self._is_beyond_the_solver(clock)
            if took >= steps * (1 + own.patience * is_patient):
                break
            before = self.bound.value
            rounds = min(own.rounds, max(own.fewest_rounds, own.round_labels // self.bound.core.goal))
            these = self._round(steps, rounds, clock)
            if not self._is_left_to_neighbourhoods:
                self._repair(own.repairs * these, clock)
            tell()
            least = 0.0 if is_patient else own.pace / own.rounds * rounds * (self.limit - before)
            if self.bound.value - before <= least:
                break
            took += (1 + own.repairs) * these

    def look_near(self, clock: Clock, tell: Callable[[], None] = lambda: None) -> None:
        """Replan related targets and look for missed landmarks in turns, if targets are many and the gap is large.

        Both get the same work, and most of the time, while the gap is so large that the solver has little hope. Below
        that, no more landmarks are looked for. Calls `tell` after each turn. Nothing is done if distinct or feedback
        inputs make a plan more than its labels.
        """
        near = self._near
        if not self._is_near_next or not self._can_be_built(clock):
            return
        usual, most = _part(clock, near.share), _part(clock, near.hopeless_share)
        share, search, begun = near.promising, self._neighbourhoods(near.promising), self.limit
        near_s, raised_s = 0.0, 0.0
        while not self.is_closed and not (most if self._is_hopeless else usual).is_over():
            if self._is_hopeless and raised_s < near_s:
                took = self._search_landmarks(most)
                raised_s += np.inf if took is None else took * clock.tuning.seconds_per_step
            elif not search.are_in_vain(near.in_vain if self._is_hopeless else near.soon):
                before_s = search.took_s
                search.go_on(most)
                near_s += search.took_s - before_s
                self._repairs.take(set(search.labels.tolist()).union(self._network.pinned))
            elif self._is_hopeless and share < 1:
                share *= 1 if self.limit < begun else near.wider
                search, begun = self._neighbourhoods(share), self.limit
            elif self._is_hopeless and raised_s < np.inf:
                near_s = np.inf  # landmarks only
            else:
                break
            tell()

    @property
    def _is_hopeless(self) -> bool:
        """Whether the gap is so large, and so many labels are left, that the solver has little hope of closing it."""
        return self._gap >= self._near.hopeless and self._left >= self._near.many

    def _neighbourhoods(self, share: float) -> Neighbourhoods:
        """Neighbourhoods of the plan among its labels and those of plans in the lower part of the gap."""
        bound = self._promising(share)
        labels = bound.core.labels
        plan = np.flatnonzero(np.isin(labels, self.plan)).tolist()
        near = self._near if self._is_hopeless else replace(self._near, kernels=self._near.kernels[-1:])
        return Neighbourhoods(bound, plan, self._fractions[labels], self._step, near)

    def _promising(self, share: float) -> Bound:
        """Return the bound for the labels of the plan and of all plans in the lowest `share` of the gap."""
        labels = self.bound.core.labels
        within = self.bound.value + int(min(share, 1.0) * (self.limit - self.bound.value))
        return self.bound.restricted(self.bound.may_be_used(within) | np.isin(labels, self.plan))

    @property
    def _is_near_next(self) -> bool:
        """Whether related targets are replanned: the gap is large, targets are many, a plan is only its labels."""
        core = self._network.core
        is_plain = core.multi_facts is None and not self._network.special
        return is_plain and len(core.needs[core.goal]) >= self._near.targets and self._gap >= self._near.gap

    @property
    def _is_left_to_neighbourhoods(self) -> bool:
        """Whether related targets are replanned next, for most of the time: they soon give cheaper plans than repairs,
        and gain less from a higher bound.
        """
        return self._is_near_next and self._is_hopeless

    @property
    def _gap(self) -> float:
        """The gap between bound and plan, as a share of the plan's cost."""
        return 1 - self.bound.value / max(1, self.limit)

    def _search_landmarks(self, clock: Clock) -> float | None:
        """Solve a linear program and look everywhere for landmarks that it misses.

        Returns about how many steps this took, None if none was found or the time was over.
        """
        program, landmarks, separator = self._restricted()
        fractions = program.solve(clock.left_s())
        if fractions is None or clock.is_over():
            return None
        self._use(fractions)
        took, missed = self._steps_of(program, landmarks, self.bound.core), list[Landmark]()
        if program.value <= self.limit - self._step:
            for times in (1, self._near.times):
                took += times * separator.steps
                found = separator.missed(fractions, self._draw, times, clock.is_over, everywhere=True)
                missed = [one for one in found if program.add(one)]
                if missed:
                    break
        self._charge(program, landmarks)
        landmarks += missed
        return took if missed else None

    @property
    def _left(self) -> int:
        """The number of labels that reduced costs have not ruled out."""
        return int(self.bound.may_be_used(self.limit).sum())

    def _begin(self, clock: Clock) -> float:
        """Solve a first linear program, then repair the plan at prices from it.

        Returns about how many steps the linear program took.
        """
        own = self._tuning
        steps = own.work * self._left**1.5
        took = self._round(steps, 1, clock) if self._can_be_built(clock) else 0.0
        self._repair(min(own.repairs * steps, min(own.first_repairs, self._left) * self._repair_steps), clock)
        return took

    def _round(self, steps: float, most: int, clock: Clock) -> float:
        """Raise the bound by up to `most` linear programs. Returns about how many steps they took."""
        own, took = self._tuning, 0.0
        program, landmarks, separator = self._restricted()
        has_many, is_next = self.bound.core.goal >= own.many, self._is_left_to_neighbourhoods
        times = own.times if has_many and not is_next else own.far_times if has_many or self._is_far else 1
        is_large = has_many and self._network.core.multi_facts is None
        for _ in range(most):
            fractions = program.solve(clock.left_s())
            if fractions is None or clock.is_over():
                break
            self._use(fractions)
            took += self._steps_of(program, landmarks, self.bound.core)
            if program.value > self.limit - self._step or took >= steps:
                break
            if is_large:
                self._charge(program, landmarks)
            part = self._promising(self._near.promising) if is_large else self.bound
            if part.core.goal < own.part * self.bound.core.goal:
                more, found = self._likely_landmarks(part, clock)
                took += more
            else:
                found = separator.missed(fractions, self._draw, times, clock.is_over)
            missed = [one for one in found if program.add(one)]
            landmarks += missed
            if not missed:
                break
        self._charge(program, landmarks)
        return took

    def _likely_landmarks(self, part: Bound, clock: Clock) -> tuple[float, list[Landmark]]:
        """Return about how many steps this took, and landmarks found by small linear programs over some of the labels.

        Only landmarks that the last program charges are returned, each as the landmark of its zone among all labels.
        """
        own, core, took = self._tuning, part.core, 0.0
        program = LandmarkProgram(core, self._kinds[core.labels], part.cost)
        landmarks = [one for one in part.short() if program.add(one)]
        known, separator = len(landmarks), Separator(core, own)
        for _ in range(own.likely):
            fractions = program.solve(clock.left_s())
            if fractions is None or clock.is_over():
                break
            took += self._steps_of(program, landmarks, core)
            found = separator.missed(fractions, self._draw, own.times, clock.is_over)
            missed = [one for one in found if program.add(one)]
            landmarks += missed
            if not missed:
                break
        whole = self.bound.core
        facts = np.searchsorted(whole.facts, core.facts)
        charged = zip(landmarks[known:], program.weights[known:], strict=False)
        return took, [landmark_of(whole, facts[one.zone].tolist()) for one, weight in charged if weight]

    def _use(self, fractions: Floats) -> None:
        """Remember how much of each label the linear program uses."""
        self._fractions[:] = 0.0
        self._fractions[self.bound.core.labels] = fractions

    def _steps_of(self, program: LandmarkProgram, landmarks: Sequence[Landmark], core: Core) -> float:
        """About how many steps a solution of the linear program over a core takes."""
        own = self._tuning
        steps = own.need * len(core.needs.items) + own.label * core.goal**2
        return steps + own.member * program.members * len(landmarks)

    def _charge(self, program: LandmarkProgram, landmarks: Sequence[Landmark]) -> None:
        """Take the bound of the program's last solution, unless it is lower."""
        bound = program.bound([*landmarks])
        if bound.value >= self.bound.value:
            self.bound = bound

    def _restricted(self) -> tuple[LandmarkProgram, list[Landmark], Separator]:
        """The linear program over the labels left, the landmarks in it, and what finds more.

        It is a new one, without labels that are not left and landmarks without a charge, if much less is left.
        """
        keep = self.bound.may_be_used(self.limit)
        counting = sum(weight > 0 for weight in self.bound.weights)
        is_less = keep.sum() < 0.75 * len(keep) or 2 * counting < len(self.bound.landmarks)
        if self._built is None or is_less:
            self.bound = self.bound.restricted(keep) if is_less else self.bound
            core = self.bound.core
            program = LandmarkProgram(core, self._kinds[core.labels], self.bound.cost)
            landmarks = [one for one in self.bound.short() if program.add(one)]
            self._built = program, landmarks, Separator(core, self._tuning)
        return self._built

    def _repair(self, steps: float, clock: Clock) -> None:
        """Look for a cheaper plan for about `steps` steps, unless there is none."""
        if self.is_closed:
            return
        is_left = np.zeros(len(self._cost), np.bool_)
        is_left[self.bound.core.labels] = True
        guide = (self._cost + 1.0) * (1.0 - self._tuning.trust * np.minimum(1.0, self._fractions))
        self._repairs.attempt(int(steps / self._repair_steps), np.where(is_left, guide, np.inf), clock.is_over)

    def _can_be_built(self, clock: Clock) -> bool:
        """Whether there is time for a linear program."""
        return clock.has_steps(clock.tuning.rise.building * self._tuning.entries * self.bound.core.links)


class Repairs:
    """Looks for a cheaper plan: members are torn out at random, and the plan is repaired at perturbed prices.

    Iterated local search (Lourenço, Martin and Stützle 2003): where repairs no longer pay, a plan made at perturbed
    prices is the next start. The random numbers are seeded. `best` is the best plan so far, a set of labels.
    """

    def __init__(self, network: Network, cost: Ints, plan: set[int], tuning: Close = USUAL.close) -> None:
        self._tuning = tuning
        self.best = plan
        self._network = network
        self._cost = cost
        self._draw = np.random.default_rng(len(cost))
        self._plan: set[int] | None = None
        self._in_vain = 0

    def attempt(self, attempts: int, guide: Floats, is_over: Callable[[], bool]) -> None:
        """Try `attempts` random repairs or restarts.

        A label's price is drawn around `guide`; a forbidden label costs infinity.
        """
        for _ in range(attempts):
            if is_over():
                return
            price = guide * np.exp(self._draw.normal(0.0, self._tuning.noise, len(guide)))
            if self._plan is None:
                self._plan = plan_at(self._network, self._cost, price)
            else:
                self._repair(self._plan, price)
            if self._plan is not None:
                self.take(self._plan)
            if self._in_vain >= self._tuning.in_vain:
                self._plan, self._in_vain = None, 0

    def take(self, plan: set[int]) -> None:
        """Make a plan the best one if it is cheaper."""
        if self._cost_of(plan) < self._cost_of(self.best):
            self.best = plan

    def _repair(self, plan: set[int], price: Floats) -> None:
        members = sorted(label for label in plan if self._cost[label])
        if not members:
            self._in_vain = self._tuning.in_vain
            return
        most = int(self._draw.integers(1, self._tuning.torn + 1))
        torn = self._draw.choice(members, size=min(most, len(members)), replace=False)
        price[list(plan)] = FREE
        price[torn] = np.inf
        other = plan_at(self._network, self._cost, price)
        if other is not None and self._cost_of(other) < self._cost_of(plan):
            self._plan, self._in_vain = other, 0
        else:
            self._in_vain += 1

    def _cost_of(self, plan: set[int]) -> int:
        return cost_of(self._cost, plan)


def _part(clock: Clock, share: float) -> Clock:
    """A clock for this share of the time that is left."""
    left_s = clock.left_s()
    return clock if left_s is None else clock.with_limit(clock.elapsed_s() + share * left_s, clock.tuning)
