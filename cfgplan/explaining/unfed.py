"""Why a target can't be met at any cost: the inputs that no stream can feed, as a tree."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, replace

from cfgplan.domain import A_UNIT_OF, Environment, InputPort, Transformation
from cfgplan.matching import Nearest
from cfgplan.planning import Problem
from cfgplan.reasons import Providers, assign_different, forward_closure, startable

NearestOffers = Callable[[str], tuple[Nearest, ...]]
"""The offered tags that come nearest to a demanded one."""


@dataclass(frozen=True)
class Unfed:
    """A demand for `tag` that can't be fed: the input `port` of a transformation, or a target if `port` is None.

    The `providers` are the transformations that would match. All are blocked, except where there are too few of them
    for a distinct group. `undecided` are the providers whose match is not decided yet. `left_out` are transformations
    that would match, but are omitted from the library for now, each with the reason. If there are neither providers nor
    such transformations, `nearest` are the offered tags most similar to `tag`.
    """

    tag: str
    port: str | None = None
    providers: tuple[str, ...] = ()
    nearest: tuple[Nearest, ...] = ()
    undecided: tuple[str, ...] = ()
    left_out: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True)
class Blocked:
    """A transformation that can't run because of its `inputs`: one that nothing can feed, or several of a group.

    The `available` transformations can run and match inputs of such a distinct group, but are too few.
    """

    transformation: str
    inputs: tuple[Unfed, ...]
    available: tuple[str, ...] = ()


@dataclass(frozen=True)
class Unreachable:
    """A minimal reason why no unit can meet `target`: a tree, or a graph if transformations only support each other.

    Its root is `wanted`; `blocked` holds each transformation once, depth first from the root; the providers of an input
    lead on. The named inputs alone rule out every plan for the target, even if all other inputs of all transformations
    are removed. If any one of the named inputs is removed as well, a plan exists.
    """

    target: str
    wanted: Unfed
    blocked: tuple[Blocked, ...]

    @property
    def named(self) -> frozenset[tuple[str, str]]:
        """The inputs that the reason names, as transformation and port."""
        return frozenset(
            (blocked.transformation, unfed.port or "") for blocked in self.blocked for unfed in blocked.inputs
        )


def unreachable(problem: Problem, nearest: NearestOffers | None = None) -> tuple[Unreachable, ...]:
    """A minimal reason for each target that no wiring can reach, whatever it costs."""
    environment = problem.environment
    providers = Providers(environment.library, problem.similarity.optimistic)
    dead = DeadEnds(environment, providers, Providers(environment.library, problem.similarity), nearest)
    return tuple(
        dead.reason(target.label, target.tag)
        for target in environment.targets
        if dead.possible.isdisjoint(providers.of(target.tag))
    )


class DeadEnds:
    """The transformations that can't run, each with the inputs that are the reason.

    If several inputs are reasons, the one with the shortest chain to a missing output is chosen. A cycle is given only
    if no chain ends at a missing output.
    """

    def __init__(
        self, environment: Environment, providers: Providers, decided: Providers, nearest: NearestOffers | None
    ) -> None:
        self.possible = startable(environment, providers)
        self._environment = environment
        self._givers = providers
        self._decided = decided
        self._omitted = {transformation.label: why for transformation, why in environment.omitted}
        self._omitted_givers = providers.of_others([transformation for transformation, _ in environment.omitted])
        self._nearest = nearest
        self._cause: dict[str, tuple[InputPort, ...]] = {}
        self._find_dead_ends()
        self._find_rings()

    def reason(self, target: str, tag: str) -> Unreachable:
        """Return the reason why no unit can meet `tag`."""
        kept = self._blocked(tag, self._cause)
        if any(len(ports) > 1 for ports in kept.values()):
            kept = self._blocked(tag, self._minimal(tag, kept))
        return Unreachable(
            target, self._unfed(tag, None), tuple(self._told(label, ports, kept) for label, ports in kept.items())
        )

    def _find_dead_ends(self) -> None:
        """Round by round: a transformation fails if everything that would feed one of its inputs has failed, or if
        too few feeders of a distinct group are left.
        """
        waiting = {t.label: t for t in self._environment.library if t.label not in self.possible}
        users: dict[str, set[str]] = defaultdict(set)
        for transformation in waiting.values():
            for port in transformation.needed_inputs:
                for provider in self._givers.of(port.tag):
                    users[provider].add(transformation.label)
        ahead = set(waiting)
        while ahead:
            ends = {}
            for label in sorted(ahead):
                for ports in self._failures(waiting[label], self.possible, self.possible):
                    if all(g in self.possible or g in self._cause for p in ports for g in self._givers.of(p.tag)):
                        ends[label] = ports
                        break
            self._cause |= ends
            ahead = {user for label in ends for user in users[label] if user not in self._cause}

    def _find_rings(self) -> None:
        """In each stage, a remaining transformation fails if the forward closure does not reach it.

        Feedback inputs may be fed by any transformation that has not failed in an earlier stage.
        """
        alive = frozenset(self._environment.transformation) - self._cause.keys()
        while alive != self.possible:
            reached = forward_closure(self._environment, self._givers, alive)
            for label in sorted(alive - reached):
                transformation = self._environment.transformation[label]
                self._cause[label] = next(self._failures(transformation, reached, alive))
            alive = reached

    def _failures(
        self, transformation: Transformation, before: Collection[str], anywhere: Collection[str]
    ) -> Iterator[tuple[InputPort, ...]]:
        """The inputs that `before` (for feedback inputs: `anywhere`) can't feed: one input alone, or several of a
        distinct group together.
        """
        groups = transformation.distinct_groups
        feeders = {
            port.name: [g for g in self._givers.of(port.tag) if g in (anywhere if port.feedback else before)]
            for port in [*transformation.needed_inputs, *(port for group in groups for port in group)]
        }
        yield from ((port,) for port in transformation.needed_inputs if not feeders[port.name])
        for group in groups:
            part = {port.name: feeders[port.name] for port in group if feeders[port.name]}
            if assign_different(part) is None:
                for name in list(part):
                    rest = {port: choices for port, choices in part.items() if port != name}
                    part = rest if assign_different(rest) is None else part
                yield tuple(port for port in group if port.name in part)

    def _blocked(self, tag: str, cause: Mapping[str, tuple[InputPort, ...]]) -> dict[str, tuple[InputPort, ...]]:
        """The causes that explain why nothing gives `tag`, depth first."""
        blocked: dict[str, tuple[InputPort, ...]] = {}
        ahead = [*reversed(self._givers.of(tag))]
        while ahead:
            label = ahead.pop()
            if label in cause and label not in blocked:
                blocked[label] = cause[label]
                ahead += [
                    provider for port in reversed(cause[label]) for provider in reversed(self._givers.of(port.tag))
                ]
        return blocked

    def _minimal(self, tag: str, kept: Mapping[str, tuple[InputPort, ...]]) -> dict[str, tuple[InputPort, ...]]:
        """The causes without dispensable inputs.

        Only a distinct group can have one: its few feeders may be blocked for another reason.
        """
        cause = dict(kept)
        for label, ports in kept.items():
            for port in ports:
                less = cause | {label: tuple(other for other in cause[label] if other != port)}
                if startable(self._with_only(less), self._givers).isdisjoint(self._givers.of(tag)):
                    cause = less
        return {label: ports for label, ports in cause.items() if ports}

    def _with_only(self, inputs: Mapping[str, tuple[InputPort, ...]]) -> Environment:
        library = (replace(t, inputs=inputs.get(t.label, ())) for t in self._environment.library)
        return Environment((), tuple(library))

    def _told(self, label: str, ports: tuple[InputPort, ...], kept: Collection[str]) -> Blocked:
        inputs = tuple(self._unfed(port.tag, port.name) for port in ports)
        available = {provider for unfed in inputs for provider in unfed.providers if provider not in kept}
        return Blocked(label, inputs, tuple(sorted(available)))

    def _unfed(self, tag: str, port: str | None) -> Unfed:
        providers = self._givers.of(tag)
        left_out = tuple((label, self._omitted[label]) for label in self._omitted_givers.of(tag))
        is_unknown = not (providers or left_out or tag.startswith(A_UNIT_OF))
        nearest = self._nearest(tag) if is_unknown and self._nearest is not None else ()
        undecided = (provider for provider in providers if provider not in self._decided.of(tag))
        return Unfed(tag, port, providers, nearest, tuple(undecided), left_out)
