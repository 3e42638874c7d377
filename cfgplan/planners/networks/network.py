"""The problem over transformations as arrays of needs and offers.

For least cost alone one unit of each transformation is enough, so the problem is one of *labels*: choose a set of them,
grounded, that meets the targets. A *fact* is a demand (merged with all demands that the same transformations can meet):
"a label offers this", or "N labels do" for the inputs of a distinct group. Feedback inputs are left out: bounds stay
valid.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

from cfgplan.costs import keep_cost_us, start_cost_us
from cfgplan.domain import InputPort, Transformation
from cfgplan.planners.networks.core import NEVER, Core, Ints, Rows, multi_facts_of_group
from cfgplan.planners.networks.keys import Key, may_stay
from cfgplan.planners.solving.arrays import np
from cfgplan.planning import Problem
from cfgplan.reasons import Each, Providers, assign_different


class Choosable:
    """A core from whose labels plans are chosen. `pinned` labels run in every plan; `special` ones have inputs whose
    needs the core does not fully state.

    Here no label is special.
    """

    core: Core
    pinned: Sequence[int] = ()
    special: frozenset[int] = frozenset()

    def special_feeders(self, label: int, total: Sequence[float]) -> list[int]:  # noqa: ARG002
        """Return feeders, cheap by `total`, for the inputs of a special label that the core does not fully state."""
        return []

    def special_inputs_are_fed(self, label: int, before: set[int], chosen: set[int]) -> bool:  # noqa: ARG002
        """Whether labels `before` a special one, and those chosen, can feed these inputs. In doubt False."""
        return True


class Network(Choosable):
    """The core of a problem with the names of its labels and the facts of its tags.

    `special` are the labels with distinct or feedback inputs, `pinned` those that run in every plan. The only
    feeder of a target or of a pinned label is pinned too.
    """

    def __init__(
        self,
        library: Sequence[Transformation],
        targets: Iterable[str],
        pinned: Iterable[str],
        rows: Providers,
        each: Each = iter,
    ) -> None:
        self.transformations = library
        self.targets = list(targets)
        self.labels = [transformation.label for transformation in library]
        self.number = {label: i for i, label in enumerate(self.labels)}
        self.fact_of_tag: dict[str, int] = {}
        facts: dict[tuple[tuple[int, ...], int], int] = {}
        givers_of_tag: dict[str, tuple[int, ...]] = {}

        def fact(tag: str) -> int:
            if tag not in self.fact_of_tag:
                providers = givers_of_tag[tag] = tuple([self.number[i] for i in rows.of(tag) if i in self.number])
                self.fact_of_tag[tag] = facts.setdefault((providers, 1), len(facts))
            return self.fact_of_tag[tag]

        needs = [{fact(port.tag) for port in t.needed_inputs if not port.feedback} for t in each(library)]
        self.special = frozenset(
            i for i, t in enumerate(library) if any(port.feedback or port.distinct is not None for port in t.inputs)
        )
        for label, group in ((i, group) for i in each(sorted(self.special)) for group in library[i].distinct_groups):
            alike = Counter(givers_of_tag[port.tag] for port in group if not port.feedback)
            for providers, takes in multi_facts_of_group(alike):
                if takes > 1:
                    needs[label] -= {facts.get((providers, 1), -1)}
                    needs[label].add(facts.setdefault((providers, takes), len(facts)))
        for port in (port for t in library for port in t.needed_inputs if port.feedback):
            fact(port.tag)
        certain = {self.number[label] for label in pinned}
        wanted = {fact(tag) for tag in self.targets}.union(*(needs[label] for label in certain))
        all_facts = list(facts)
        ahead = list(wanted)
        for providers, takes in (all_facts[each] for each in ahead):
            for label in set(providers) - certain if len(providers) == takes else ():
                certain.add(label)
                ahead += needs[label] - wanted
                wanted |= needs[label]
        self.pinned = sorted(certain)
        takes_several = any(takes > 1 for _, takes in facts)
        self.core = Core(
            Rows.of([sorted(row) for row in (*needs, wanted)]),
            Rows.of([providers for providers, _ in facts]),
            takes=np.array([takes for _, takes in facts], np.int64) if takes_several else None,
        )

    def special_feeders(self, label: int, total: Sequence[float]) -> list[int]:
        """Different feeders for the inputs of a distinct group, and one for each feedback input."""
        transformation, feeders = self.transformations[label], list[int]()
        for group in transformation.distinct_groups:
            by_price = {
                port.name: [self.labels[i] for i in sorted(self._providers(port), key=lambda i: (total[i], i))]
                for port in group
            }
            feeders += [self.number[one] for one in sorted((assign_different(by_price) or {}).values())]
        feedback = (port for port in transformation.needed_inputs if port.feedback)
        return [*feeders, *(min(self._providers(port), key=total.__getitem__) for port in feedback)]

    def special_inputs_are_fed(self, label: int, before: set[int], chosen: set[int]) -> bool:
        """Whether distinct groups can be filled and feedback inputs fed; in doubt (a later feeder) False."""
        transformation = self.transformations[label]

        def feeders(port: InputPort, among: set[int]) -> list[str]:
            return [self.labels[i] for i in self._providers(port) if i in among]

        return all(feeders(p, chosen) for p in transformation.needed_inputs if p.feedback) and all(
            assign_different({p.name: feeders(p, chosen if p.feedback else before) for p in group}) is not None
            for group in transformation.distinct_groups
        )

    def _providers(self, port: InputPort) -> list[int]:
        return self.core.providers.lists[self.fact_of_tag[port.tag]]


def costs(problem: Problem, network: Network) -> tuple[int, list[int]]:
    """The fixed cost of the network's pinned labels, and what each label costs beyond that, in microseconds.

    All running units of a pinned transformation are kept; other labels need one unit.
    """
    running = Counter(unit.transformation for unit in problem.environment.units)
    library = problem.environment.transformation  # the network may be older than costs are
    kinds = [library[label] for label in network.labels]
    each_us = [(keep_cost_us if t.label in running else start_cost_us)(t, problem.horizon_s) for t in kinds]
    fixed_us = sum(each_us[i] * (running[kinds[i].label] or 1 if kinds[i].pinned else 1) for i in network.pinned)
    for label in network.pinned:
        each_us[label] = 0
    return fixed_us, each_us


@dataclass(frozen=True)
class LexicographicWeights:
    """The weight of each label of a network where plans are compared: `scale` for a microsecond of cost.

    Plans of equal cost compare by rewired units, then by started units; fewer are better. Cost
    and changes are one sum, so that a bound on it may prove a plan best in all of them.

    If `scale` exceeds 1, a start adds 1 and a rewiring that can't be avoided adds `rewiring`. The fixed cost of pinned
    labels is left out: `fixed_us`.
    """

    each: Sequence[int]
    scale: int
    rewiring: int
    fixed_us: int

    @classmethod
    def of(cls, problem: Problem, network: Network) -> LexicographicWeights:
        """Weigh cost and, where nothing runs, starts."""
        fixed_us, cost = costs(problem, network)
        scale = len(cost) + 1
        is_running = any(unit.transformation in network.number for unit in problem.environment.units)
        if is_running or sum(cost) * scale >= NEVER // 4:
            return cls(cost, 1, 1, fixed_us)
        return cls([one * scale + 1 for one in cost], scale, scale, fixed_us)

    @classmethod
    def with_changes(cls, problem: Problem, network: Network) -> LexicographicWeights | None:
        """Weigh cost, rewirings and starts; None if the sum would be too large.

        No change of a pinned transformation with running units counts.
        """
        fixed_us, cost = costs(problem, network)
        rewiring = len(cost) + 1
        scale = rewiring**2
        if sum(cost) * scale >= NEVER // 4:
            return None
        change = [1] * len(cost)
        for unit in problem.environment.units:
            label = network.number.get(unit.transformation, -1)
            if label >= 0 and change[label]:
                kind = problem.environment.transformation[unit.transformation]
                is_unchanged = kind.pinned or may_stay(problem, network.number, unit)
                change[label] = 0 if is_unchanged else 1 if kind.labor_us == 0 else rewiring
        return cls([us * scale + changes for us, changes in zip(cost, change, strict=True)], scale, rewiring, fixed_us)

    @cached_property
    def weight(self) -> Ints:
        """The weight of each label, as an array."""
        return np.array(self.each, np.int64)

    @property
    def counts_starts(self) -> bool:
        return self.scale > 1

    @cached_property
    def step(self) -> int:
        """Every plan's weight is a multiple of this."""
        return max(1, math.gcd(*self.each))

    def of_plan(self, labels: Iterable[int]) -> int:
        return sum(self.each[label] for label in labels)

    def least(self, bound: int) -> int:
        """The least weight that a plan can have: the bound rounded up to a multiple of `step`."""
        return -(-bound // self.step) * self.step

    def cost_us(self, weight: int) -> int:
        """The cost in a weight, `fixed_us` included. A bound on the weight gives a bound on the cost."""
        return weight // self.scale + self.fixed_us

    def of_key(self, key: Key) -> int:
        """The weight of a plan with this key: its cost and its real changes."""
        return (key.cost_us - self.fixed_us) * self.scale + key.rewired * self.rewiring + key.started

    def changes(self, weight: int) -> tuple[int, int] | None:
        """The rewired and the started units in a weight; None if they don't count."""
        return divmod(weight % self.scale, self.rewiring) if self.counts_starts else None
