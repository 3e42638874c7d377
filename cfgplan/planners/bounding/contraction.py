"""The cheapest choice of labels, where labels that are used only together count as one.

A label forces the providers of a fact that takes all of them. If nothing else may need a forced label, a cheapest plan
uses both or neither, so they become one *part* with the sum of their costs: a robot's pipeline is a part, and so is a
camera that several robots share. The solver chooses among the parts in milliseconds, since they are few. A choice that
is not grounded misses a landmark, which is added before the solver chooses again.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from typing import NamedTuple

from cfgplan.onward import reached
from cfgplan.planners.networks.core import Core
from cfgplan.planners.networks.reach import Reach
from cfgplan.planners.solving.clock import Clock


class Need(NamedTuple):
    """A need of a part: if it is chosen, so are at least `takes` of its providers.

    A provider is the number of a part, and counts as often as it is named.
    """

    part: int
    takes: int
    providers: list[int]


class Contraction:
    """The `parts` of a core, each a list of labels, and what each costs.

    The last part is the goal with the labels of `certain`, which every plan uses.
    """

    def __init__(self, core: Core, cost: Sequence[int], certain: Collection[int]) -> None:
        needs, self._providers = core.needs.lists, core.providers.lists
        self._takes, self._goal = core.multi_takes, core.goal
        wanted = reached([core.goal], lambda label: (one for fact in needs[label] for one in self._providers[fact]))
        self._labels = {label: [label] for label in dict.fromkeys([*wanted, *certain])}
        self._part = {label: label for label in self._labels}
        self._needs = {label: set(needs[label]) for label in self._labels}
        self._needed_by: dict[int, set[int]] = {}
        for label, facts in self._needs.items():
            for fact in facts:
                self._needed_by.setdefault(fact, set()).add(label)
        gives = core.gives.lists
        self._gives = {label: {fact for fact in gives[label] if fact in self._needed_by} for label in self._labels}
        self._contract(certain)
        leaders = [label for label in self._labels if label != core.goal]
        self._number = {label: number for number, label in enumerate([*leaders, core.goal])}
        self.parts = [*(self._labels[label] for label in leaders), self._labels[core.goal][1:]]
        self.costs = [sum([cost[label] for label in labels]) for labels in self.parts]

    def needs(self) -> Iterator[Need]:
        """Yield the needs of each part that its own labels and those of every plan do not meet."""
        goal = self._number[self._goal]
        for leader, part in self._number.items():
            for fact in sorted(self._needs[leader]):
                providers = [self._number[self._part[one]] for one in self._providers[fact]]
                others = [one for one in providers if one not in (part, goal)]
                takes = self._takes.get(fact, 1) - (len(providers) - len(others))
                if takes > 0:
                    yield Need(part, takes, others)

    def _contract(self, certain: Collection[int]) -> None:
        """Join labels until no part forces another that it alone needs."""
        for label in certain:
            self._join(label, self._goal)
        ahead = list(self._labels)
        while ahead:
            leader = ahead.pop()
            if self._part[leader] != leader:
                continue
            forced = [
                self._part[one]
                for fact in sorted(self._needs[leader])
                if len(self._providers[fact]) <= self._takes.get(fact, 1)
                for one in self._providers[fact]
            ]
            joining = [one for one in dict.fromkeys(forced) if self._is_needed_only_with(one, leader)]
            for one in joining:
                self._join(one, leader)
            if joining:
                ahead.append(leader)

    def _is_needed_only_with(self, part: int, leader: int) -> bool:
        """Whether a part that the leader's part forces is of no use without it."""
        if part in (leader, self._goal):
            return False
        both = {part, leader}
        return leader == self._goal or all(self._needed_by[fact] <= both for fact in self._gives[part])

    def _join(self, part: int, leader: int) -> None:
        labels = self._labels.pop(part)
        self._labels[leader] += labels
        self._part |= dict.fromkeys(labels, leader)
        facts = self._needs.pop(part)
        for fact in facts:
            self._needed_by[fact].discard(part)
            self._needed_by[fact].add(leader)
        self._needs[leader] |= facts
        self._gives[leader] |= self._gives.pop(part)


def cheapest_choice(core: Core, cost: Sequence[int], certain: Collection[int], clock: Clock) -> set[int] | None:
    """Return the cheapest labels that meet the core's goal and can be started one after the other.

    `certain` has labels that every plan uses; the goal must need all that they need. Returns None if no such labels
    exist, if they are not proven cheapest within the clock and `tuning.decide.choosing`, or if too many parts are left.
    """
    contraction, tuning = Contraction(core, cost, certain), clock.tuning.decide
    if len(contraction.parts) > max(tuning.parts, tuning.contracted * core.goal):
        return None
    from ortools.sat.python.cp_model import OPTIMAL, LinearExpr

    from cfgplan.planners.solving.engine import ExactModel, repeatable_solver, solve

    model, left_s = ExactModel(), tuning.choosing
    uses = [model.new_bool_var("") for _ in contraction.parts]
    model.add_bool_or([uses[-1]])
    for part, takes, providers in contraction.needs():
        model.add(LinearExpr.sum([uses[one] for one in providers]) >= takes * uses[part])
    model.minimize(LinearExpr.weighted_sum(uses[:-1], contraction.costs[:-1]))
    of_label = {label: use for labels, use in zip(contraction.parts, uses, strict=True) for label in labels}
    while left_s > 0:
        solver = repeatable_solver(small=True, tiny=True, time_limit_s=clock.left_s())
        solver.parameters.max_deterministic_time = left_s
        if solve(solver, model, clock) != OPTIMAL:
            return None
        left_s -= tuning.round + solver.response_proto.deterministic_time
        used = {label: solver.boolean_value(use) for label, use in of_label.items()}
        reach = Reach(core, [core.goal, *(label for label, is_used in used.items() if is_used)])
        if reach.runs(core.goal):
            return set(reach.order) - {core.goal}
        unused = [label for label, is_used in used.items() if not is_used]
        unused.sort(key=lambda label: (cost[label], label))
        model.add_bool_or([of_label[label] for label in _missed(core.goal, reach, unused)])
    return None


def _missed(goal: int, reach: Reach, unused: Iterable[int]) -> list[int]:
    """Return a landmark that the labels of `reach` miss: every plan uses one of its labels.

    Unused labels are added in turn, except those with which the goal could be started: these are the landmark.
    """
    missed = []
    for label in unused:
        reach.add(label)
        if reach.runs(goal):
            reach.take_back()
            missed.append(label)
    return missed
