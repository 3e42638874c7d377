"""What a session knows of a problem before it looks at what runs: closure, network, landmarks."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import cached_property

from cfgplan.domain import Environment, Similarity, Transformation
from cfgplan.planners.bounding.bounds import Bound
from cfgplan.planners.bounding.landmarks import Landmark
from cfgplan.planners.exact.candidates import Candidates, Closure
from cfgplan.planners.networks.network import Network
from cfgplan.planners.solving.clock import Clock
from cfgplan.planning import Problem


@dataclass
class Structure:
    """What depends on library, matching and targets alone, whatever runs and whatever it costs.

    `network` is that of what is relevant.
    """

    environment: Environment
    similarity: Similarity
    pinned: frozenset[str]
    closure: Closure
    network: Network
    _landmarks: list[Landmark] = field(default_factory=list)
    _weights: list[int] = field(default_factory=list)
    _found: tuple[Callable[[], Bound], int] | None = None

    @classmethod
    def of(cls, problem: Problem, old: Structure | None, clock: Clock) -> Structure:
        """The structure of a problem; what still holds is taken from an `old` one. Raises OutOfTimeError."""
        environment = problem.environment
        is_known = old is not None and old.similarity == problem.similarity and _alike(old.environment, environment)
        closure = Closure.of(problem, clock, old.closure if old is not None and is_known else None)
        network = _network(environment, closure, closure.relevant, frozenset(), clock)
        return cls(environment, problem.similarity, _pinned(environment), closure, network)

    @property
    def meets_targets(self) -> bool:
        """Whether each target by itself can be met."""
        return len(self.network.targets) == len(self.environment.targets)

    def candidates(self, problem: Problem, labels: Iterable[str], clock: Clock | None = None) -> Candidates:
        """The units that a plan may have of some labels; the problem must be one that this serves."""
        return Candidates(problem, self.closure, frozenset(labels), clock)

    def counts(self) -> dict[str, int]:
        """How many transformations and demands are left, step by step."""
        return {
            "transformations": len(self.environment.library),
            "startable": len(self.closure.possible),
            "relevant": len(self.network.labels),
            "demands": len(self.network.fact_of_tag),
            "merged demands": len(self.network.core.givers),
        }

    def network_with(self, problem: Problem, wanted: frozenset[str], clock: Clock) -> Network:
        """The network with some labels that have to run, as pinned ones do; raises OutOfTimeError."""
        return _network(problem.environment, self.closure, frozenset(self.network.labels), wanted, clock)

    @cached_property
    def has_required(self) -> bool:
        """Whether some transformation that may be of use is required to be used."""
        return any(t.required for t in self.network.transformations)

    @cached_property
    def hopeless_required(self) -> int:
        """How many required transformations can never be used, whatever is planned."""
        return len(self.environment.required) - sum(t.required for t in self.network.transformations)

    def remember(self, bound: Callable[[], Bound], scale: int) -> None:
        """Keep a bound's landmarks that have a charge for the next plan. In the bound a microsecond weighs `scale`."""
        self._found = bound, scale

    @property
    def has_landmarks(self) -> bool:
        """Whether landmarks are remembered."""
        return self._found is not None or bool(self._landmarks)

    def landmarks(self) -> tuple[list[Landmark], list[int]]:
        """The remembered landmarks in the whole network's numbering, and how much each was charged."""
        if self._found is not None:
            (found, scale), self._found = self._found, None
            bound = found()
            known = {landmark.key: landmark for landmark in self._landmarks}
            counted = [
                (landmark.outside(bound.core), weight // scale)
                for landmark, weight in zip(bound.landmarks, bound.weights, strict=True)
                if weight
            ]
            self._landmarks = [known.get(one.key) or one.made_again(self.network.core) for one, _ in counted]
            self._weights = [weight for _, weight in counted]
        return list(self._landmarks), list(self._weights)

    def serves(self, problem: Problem) -> bool:
        """Whether the problem differs in nothing but running units and costs."""
        return (
            (self.similarity is problem.similarity or self.similarity == problem.similarity)
            and _alike(self.environment, problem.environment)
            and self.environment.targets == problem.environment.targets
            and self.pinned == _pinned(problem.environment)
        )


def _network(
    environment: Environment, closure: Closure, labels: frozenset[str], wanted: frozenset[str], clock: Clock
) -> Network:
    givers, possible = closure.givers, closure.possible
    return Network(
        [t for t in environment.library if t.label in labels],
        [target.tag for target in environment.targets if not possible.isdisjoint(givers.of(target.tag))],
        (_pinned(environment) & possible) | wanted,
        givers,
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
    """Whether the libraries differ in nothing but costs."""
    return one.library == other.library or (
        len(one.library) == len(other.library)
        and all(a is b or _ports(a) == _ports(b) for a, b in zip(one.library, other.library, strict=True))
    )


def _ports(transformation: Transformation) -> tuple[object, ...]:
    t = transformation
    return t.label, t.inputs, t.outputs, t.pinned, t.required, t.min_instances
