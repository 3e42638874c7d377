"""The memory of a session: closure and network of the library, landmarks, the last plan, and the proven
running plan.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, fields
from functools import cached_property
from operator import attrgetter
from typing import TYPE_CHECKING

from cfgplan.domain import ComputationUnit, Environment, Similarity, Transformation
from cfgplan.planners.exact.candidates import Candidates
from cfgplan.planners.exact.solve_state import SolveState
from cfgplan.planners.networks.core import Ints
from cfgplan.planners.networks.network import Network, costs
from cfgplan.planners.reducing.closure import Closure
from cfgplan.planners.solving.arrays import np
from cfgplan.planners.solving.clock import Clock
from cfgplan.planning import Problem

if TYPE_CHECKING:
    from cfgplan.planners.bounding.bounds import Bound
    from cfgplan.planners.bounding.landmarks import Landmark
    from cfgplan.planners.exact.warm_start import WarmStart


@dataclass(frozen=True)
class Structure:
    """The part of a problem that library, matching, targets and `pinned` determine, whatever the costs and other units.

    `pinned` are the pinned transformations with running units. `network` is that of the relevant transformations.
    """

    environment: Environment
    similarity: Similarity
    pinned: frozenset[str]
    closure: Closure
    network: Network

    @classmethod
    def of(cls, problem: Problem, old: Structure | None, clock: Clock) -> Structure:
        """The structure of a problem. Parts of an `old` one are reused where they still hold. Raises OutOfTimeError."""
        environment = problem.environment
        is_known = old is not None and old.similarity == problem.similarity and _alike(old.environment, environment)
        closure = Closure.of(problem, clock, old.closure if old is not None and is_known else None)
        network = _network(environment, closure, closure.relevant, frozenset(), clock)
        return cls(environment, problem.similarity, _pinned(environment), closure, network)

    def candidates(self, problem: Problem, labels: Iterable[str], clock: Clock | None = None) -> Candidates:
        """The units that a plan may have of some labels; the problem must be one that this serves."""
        return Candidates(problem, self.closure, frozenset(labels), clock)

    def counts(self) -> dict[str, int]:
        """The numbers of remaining transformations and demands, step by step."""
        return {
            "transformations": len(self.environment.library),
            "startable": len(self.closure.possible),
            "relevant": len(self.network.labels),
            "demands": len(self.network.fact_of_tag),
            "merged demands": len(self.network.core.providers),
        }

    def network_with(self, problem: Problem, wanted: frozenset[str], clock: Clock) -> Network:
        """The network with some labels that have to run, as pinned ones do; raises OutOfTimeError."""
        return _network(problem.environment, self.closure, frozenset(self.network.labels), wanted, clock)

    @cached_property
    def has_required(self) -> bool:
        """Whether some transformation that may be of use is required to be used."""
        return any(t.required for t in self.network.transformations)

    @cached_property
    def unusable_required(self) -> int:
        """How many required transformations can never be used, whatever is planned."""
        return len(self.environment.required) - sum(t.required for t in self.network.transformations)

    def serves(self, problem: Problem) -> bool:
        """Whether a problem differs in nothing but costs and running units that are not pinned."""
        return (
            (self.similarity is problem.similarity or self.similarity == problem.similarity)
            and _alike(self.environment, problem.environment)
            and self.environment.targets == problem.environment.targets
            and self.pinned == _pinned(problem.environment)
        )


class Memory:
    """The memory of all problems with one matching. Each stage of a plan may add to it."""

    def __init__(
        self, structure: Structure, last: Mapping[str, ComputationUnit] | None = None, aside: Memory | None = None
    ) -> None:
        """`last` has a unit of each transformation in the last plan. `aside` is the memory of another matching.

        Where pairs are open, problems come by turns: as if none, and as if all of them matched.
        """
        self.structure, self.last, self._aside = structure, last or {}, aside
        self.warm_start: WarmStart | None = None
        self._landmarks: list[Landmark] = []
        self._weights: list[int] = []
        self._found: tuple[Callable[[], Bound], int] | None = None

    @classmethod
    def of(cls, problem: Problem, known: Memory | None, clock: Clock) -> Memory:
        """The memory for a problem, with the parts of `known` that still hold. Raises OutOfTimeError."""
        last, aside = (None, None) if known is None else (known.last, known._aside)
        if known is not None and known.structure.similarity != problem.similarity:
            known._aside = None
            if aside is None or aside.structure.similarity != problem.similarity:
                return cls(Structure.of(problem, None, clock), last, known)
            known, last, aside = aside, aside.last, known
            known._aside = aside
        if known is not None and known.structure.serves(problem):
            return known
        return cls(Structure.of(problem, None if known is None else known.structure, clock), last, aside)

    def keep_plan(self, state: SolveState) -> None:
        """Keep the best plan so far: a unit of each transformation that runs."""
        if state.best is not None:
            self.last = {unit.transformation: unit for unit in state.best.units if not unit.standby}

    def keep_landmarks(self, bound: Callable[[], Bound], scale: int) -> None:
        """Keep the charged landmarks of a bound, which is computed once they are needed.

        In the bound a microsecond weighs `scale`.
        """
        self._found = bound, scale

    @property
    def has_landmarks(self) -> bool:
        return self._found is not None or bool(self._landmarks)

    def bound(self, weight: Ints, scale: int = 1) -> Bound:
        """The bound by the landmarks that are kept, charged as before as far as residual costs allow."""
        from cfgplan.planners.bounding.bounds import Bound

        core = self.structure.network.core
        if self._found is not None:
            (found, old_scale), self._found = self._found, None
            old = found()
            known = {landmark.key: landmark for landmark in self._landmarks}
            counted = [
                (landmark.outside(old.core), charge // old_scale)
                for landmark, charge in zip(old.landmarks, old.weights, strict=True)
                if charge
            ]
            self._landmarks = [known.get(one.key) or one.made_again(core) for one, _ in counted]
            self._weights = [charge for _, charge in counted]
        bound = Bound(core, weight, list(self._landmarks))
        bound.recharge([charge * scale for charge in self._weights])
        return bound

    def settle(self, problem: Problem, clock: Clock) -> None:
        """After a proven plan that changes nothing, prepare for the next one: keep its `WarmStart`."""
        from cfgplan.planners.bounding.bounds import tightened
        from cfgplan.planners.exact.warm_start import WarmStart

        network = self.structure.network
        cost = np.array(costs(problem, network)[1], np.int64)
        plan = np.array(sorted({network.number[label] for label in self.last} | set(network.pinned)), np.int64)
        if (
            self.warm_start is not None
            and np.array_equal(self.warm_start.cost, cost)
            and np.array_equal(self.warm_start.plan, plan)
        ):
            return
        library = problem.environment.transformation
        max_need = max((library[network.labels[i]].labor_us for i in plan.tolist()), default=0)
        value = int(cost[plan].sum())
        limit = value + max_need
        self.warm_start = self.warm_start and self.warm_start.moved(plan, cost, limit, clock)
        if self.warm_start is None:
            close = tightened(self.bound(cost), value, value, clock)
            self.keep_landmarks(lambda: close, 1)
            self.warm_start = WarmStart.of(plan, cost, int(clock.tuning.replan.room * limit), self.bound(cost), clock)


def _network(
    environment: Environment, closure: Closure, labels: frozenset[str], wanted: frozenset[str], clock: Clock
) -> Network:
    providers, possible = closure.providers, closure.possible
    return Network(
        [t for t in environment.library if t.label in labels],
        [target.tag for target in environment.targets if not possible.isdisjoint(providers.of(target.tag))],
        (_pinned(environment) & possible) | wanted,
        providers,
        clock.each,
    )


def _pinned(environment: Environment) -> frozenset[str]:
    """The labels of pinned transformations that have running units."""
    library = environment.transformation
    return frozenset(
        unit.transformation
        for unit in environment.units
        if unit.transformation in library and library[unit.transformation].pinned
    )


def _alike(one: Environment, other: Environment) -> bool:
    """Return whether the libraries are equal except for costs."""
    return one.library == other.library or (
        len(one.library) == len(other.library)
        and all(
            a is b or _all_but_costs(a) == _all_but_costs(b) for a, b in zip(one.library, other.library, strict=True)
        )
    )


_all_but_costs = attrgetter(
    *(one.name for one in fields(Transformation) if one.name not in {"labor_us", "upkeep_us", "standby_us", "seen_us"})
)
