"""Landmarks that fractions of labels do not hit, by minimum cuts.

Let every label be fed through only one of its needs: the one that the fractions support least. Then the core is a
directed graph, and a cheapest set of labels that cuts the goal off is a minimum cut (Ford and Fulkerson 1956). The side
of the cut with the goal is a zone. The labels that enter this zone, all their needs considered, are a landmark and no
more than the cut.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

from cfgplan.planners.bounding.landmarks import Landmark, landmark_of
from cfgplan.planners.networks.core import Core, Floats, Ints
from cfgplan.planners.solving.arrays import np
from cfgplan.planners.tuning import USUAL, Close

WHOLE = 1_000_000
"""The capacity of a label that is used as a whole."""
CREEP = 50
"""Added to each capacity, so that among equal cuts one with few labels is the smallest."""


class Separator:
    """Finds landmarks of a core that fractions miss."""

    def __init__(self, core: Core, tuning: Close = USUAL.close) -> None:
        self._core, self._tuning = core, tuning
        labels, facts = core.goal, len(core.providers)
        self._source = facts + 2 * labels
        entering = facts + np.arange(labels)
        self._tails = np.concatenate([entering, entering[core.providers.items] + labels])
        self._heads = np.concatenate([entering, entering + labels, core.providers.row_of_item])

    def missed(
        self,
        fractions: Floats,
        draw: np.random.Generator,
        times: int = 1,
        is_over: Callable[[], bool] = lambda: False,
        *,
        everywhere: bool = False,
    ) -> list[Landmark]:
        """Landmarks that the fractions miss, as many as there is time for.

        Needs are chosen `times` times: by their support, then with noise on it. Each choice gives landmarks for some
        wanted facts. With `everywhere` it gives them for all, and each choice is one with noise.
        """
        support = self._support(fractions)
        wanted = self._core.needs[self._core.goal]
        goals = len(wanted) if everywhere else self._tuning.goals
        found: dict[bytes, Landmark] = {}
        for time in range(times):
            noise = draw.random(len(support)) * self._tuning.need_noise if time or everywhere else 0.0
            feeding = self._least_of_needs(support + noise)
            for goal in draw.permutation(wanted)[:goals].tolist():
                if is_over():
                    return list(found.values())
                found |= {one.members.tobytes(): one for one in self._nested(fractions, feeding, goal)}
        return list(found.values())

    @property
    def steps(self) -> float:
        """About how many steps a look for landmarks everywhere takes, with one choice of needs."""
        return self._tuning.cut * (len(self._tails) + self._core.goal) * len(self._core.needs[self._core.goal])

    def _nested(self, fractions: Floats, feeding: Ints, goal: int) -> Iterable[Landmark]:
        """Missed landmarks one behind the other: the members of one count as used for the next."""
        left = fractions.copy()
        for _ in range(self._tuning.nested):
            flow, zone = self._cut(left, feeding, goal)
            landmark = landmark_of(self._core, zone.tolist())
            if max(flow, landmark.hit_by(fractions)) >= 1 - self._tuning.missed:
                return
            yield landmark
            left[landmark.members] = 1.0

    def _support(self, fractions: Floats) -> Floats:
        """An upper bound on how much of each fact the fractions support."""
        core = self._core
        facts = np.zeros(len(core.providers))
        for _ in range(self._tuning.followed):
            before = facts
            facts = np.minimum(1.0, core.share_of_givers(np.minimum(core.least_of_needs(facts)[:-1], fractions)))
            if np.abs(facts - before).max() < 1e-6:
                break
        return facts

    def _least_of_needs(self, support: Floats) -> Ints:
        """For each label the need with the least support; for sources the source of the graph."""
        core = self._core
        labels, needs = core.needs_with(support, core.least_of_needs(support))
        feeding = np.full(core.goal + 1, self._source)
        feeding[labels] = needs
        return feeding[:-1]

    def _cut(self, fractions: Floats, feeding: Ints, goal: int) -> tuple[float, Ints]:
        """The value of a minimum cut that separates `goal`, and the smallest zone behind such a cut."""
        from ortools.graph.python.max_flow import SimpleMaxFlow

        core, facts = self._core, len(self._core.providers)
        unlimited = np.full(core.goal, 10 * WHOLE)
        limited = np.rint(fractions * WHOLE).astype(np.int64) + CREEP
        flow = SimpleMaxFlow()
        flow.add_arcs_with_capacity(
            np.concatenate([feeding, self._tails]).astype(np.int32),
            self._heads.astype(np.int32),
            np.concatenate([unlimited, limited, np.full(len(core.providers.items), 10 * WHOLE)]),
        )
        flow.solve(self._source, goal)
        replaceable_by = np.sort(np.array(flow.get_sink_side_min_cut(), np.int64))
        return flow.optimal_flow() / WHOLE, replaceable_by[replaceable_by < facts]
