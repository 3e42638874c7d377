"""The units that a configuration of a fleet may have, and who may feed whom."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass
from functools import cached_property

from cfgplan.costs import keep_cost_us, standby_cost_us, start_cost_us
from cfgplan.domain import ComputationUnit, Environment, Stream, Transformation
from cfgplan.planners.networks.network import Network
from cfgplan.planners.networks.site import may_stay
from cfgplan.planning import Problem, fresh_units
from cfgplan.qualities import QualityAttribute, worst_allowed
from cfgplan.reasons import Givers, startable

Host = str | None
"""Where something is; None where there are no hosts, or on no host in particular."""


@dataclass(frozen=True)
class Candidate:
    """A unit of the environment, or one of the new ones of a transformation; `may_run` or `may_wait` as a cold spare.

    `hosts` are those it may be on: its own if it is there already, only None where there are no hosts.
    """

    id: str
    transformation: Transformation
    running: ComputationUnit | None
    hosts: tuple[Host, ...]
    may_run: bool
    may_wait: bool
    cost_us: int
    waiting_cost_us: int


class Candidates:
    """The candidates by index, in canonical order; the new ones of a transformation stand side by side."""

    def __init__(
        self,
        problem: Problem,
        among: Collection[str] | None = None,
        watch: Callable[[], None] = lambda: None,
        known: Candidates | None = None,
    ) -> None:
        """All candidates, or those of the transformations in `among`.

        `watch` is called again and again, here and in what is made of the candidates, and can end it by an exception.
        Where all candidates are `known`, what can be started is not looked for again.
        """
        self.problem = problem
        self.environment = problem.environment
        self.watch = watch
        if known is None:
            self.givers = Givers(problem.environment.library, problem.similarity)
            self.givers.watch = watch
            self.possible = startable(problem.environment, self.givers)
            self._relevant = _relevant(problem, self.givers, self.possible)
        else:
            self.givers, self.possible, self._relevant = known.givers, known.possible, known._relevant
        labels = self._relevant
        if among is not None:
            labels = labels.intersection(among)
        found: list[Candidate] = []
        for candidate in (*_present(problem), *_new(problem, labels, watch)):
            watch()
            if candidate.transformation.label in labels:
                found.append(candidate)
        self.all = tuple(found)
        self.index_of = {candidate.id: i for i, candidate in enumerate(self.all)}
        self._streams: dict[str, tuple[Stream, ...]] = {}
        self._useless: set[tuple[str, Stream]] = set()
        self.bounds = {
            (target.label, wish.attribute): worst_allowed(problem.environment.quality[wish.attribute], wish)
            for target in problem.environment.targets
            for wish in target.quality
            if wish.bound is not None
        }
        """The worst value that a target may get of an attribute, as far as is known."""
        self.best: dict[QualityAttribute, dict[Stream, int]] = {}
        self.allowed: dict[tuple[object, ...], dict[str, int]] = {}
        """What `best_case` found out: the best value of each stream, and what may be allowed with some bounds."""
        self._by_label: dict[str, list[Candidate]] = defaultdict(list)
        for candidate in self.all:
            watch()
            self._by_label[candidate.transformation.label].append(candidate)
        self._is_closed = among is None and len(self._by_label) == len(labels)

    def among(self, labels: Collection[str]) -> Candidates:
        """Those of some transformations, with what is known of quality."""
        part = Candidates(self.problem, labels, self.watch, self)
        part.bounds, part._useless = dict(self.bounds), set(self._useless)
        return part

    @property
    def labels(self) -> Collection[str]:
        """The transformations that there are candidates of."""
        return self._by_label.keys()

    @cached_property
    def network(self) -> Network:
        """The transformations that candidates are of and that can be started among themselves, whatever the hosts.

        Targets that none of them can meet are left out.
        """
        self.watch()
        library = tuple(self._by_label[label][0].transformation for label in sorted(self._by_label))
        if not self._is_closed:
            left = startable(Environment((), library), self.givers)
            library = tuple(t for t in library if t.label in left)
        self.watch()
        labels = {t.label for t in library}
        asked = {c.transformation.label for i, c in enumerate(self.all) if self.is_asked_for(i)}
        targets = [target.tag for target in self.environment.targets]
        self.watch()
        return Network(
            library,
            [tag for tag in targets if not labels.isdisjoint(self.givers.of(tag))],
            asked & labels,
            self.givers,
        )

    def numbers(self, labels: Iterable[str]) -> list[int]:
        """The numbers that transformations have in the network, sorted."""
        return sorted(self.network.number[label] for label in labels if label in self.network.number)

    def of(self, label: str) -> list[Candidate]:
        """The candidates of a transformation."""
        return self._by_label.get(label, [])

    def streams(self, tag: str) -> tuple[Stream, ...]:
        """The streams of candidates that may run and match the demanded tag."""
        self.watch()
        if tag not in self._streams:
            self._streams[tag] = tuple(
                Stream(candidate.id, port.name)
                for label in self.givers.of(tag)
                for candidate in self._by_label.get(label, ())
                if candidate.may_run
                for port in candidate.transformation.outputs
                if self.problem.similarity.holds(port.tag, tag)
                and (tag, Stream(candidate.id, port.name)) not in self._useless
            )
        return self._streams[tag]

    def leave_out(self, useless: Collection[tuple[str, Stream]]) -> None:
        """Streams that no plan uses where a tag is demanded."""
        self._useless.update(useless)
        for tag, _ in useless:
            self._streams.pop(tag, None)

    def feeders(self, tag: str) -> list[int]:
        """The candidates that have such a stream, each once."""
        return sorted({self.index_of[stream.unit] for stream in self.streams(tag)})

    def may_stay(self, index: int) -> bool:
        """Whether a running unit's wiring is valid as far as it can tell by itself: see `networks.site`."""
        unit = self.all[index].running
        if unit is None or not self.all[index].may_run or not may_stay(self.problem, self._by_label, unit):
            return False
        inputs = self.all[index].transformation.input
        tag_of = {target.topic: target.tag for target in self.environment.targets}
        wanted = [(s.stream, inputs[s.port].tag) for s in unit.subscriptions]
        wanted += [(Stream(unit.id, p.port), tag_of[p.topic]) for p in unit.publications]
        feeds_itself = any(s.stream.unit == unit.id and not inputs[s.port].feedback for s in unit.subscriptions)
        return not feeds_itself and all(stream in self.streams(tag) for stream, tag in wanted)

    def is_asked_for(self, index: int) -> bool:
        """Whether the candidate has to run or its transformation asks for a number of units."""
        return self.is_pinned(index) or self.all[index].transformation.min_instances > 0

    def is_pinned(self, index: int) -> bool:
        """Whether the candidate is a running unit that must be kept."""
        candidate = self.all[index]
        return (
            candidate.transformation.pinned
            and candidate.running is not None
            and candidate.may_run
            and candidate.transformation.label in self.possible
        )


def _relevant(problem: Problem, givers: Givers, possible: frozenset[str]) -> frozenset[str]:
    """The transformations that can be fed at all and that a target, a pinned unit or a number asks for."""
    environment = problem.environment
    asked = {t.label for t in environment.library if t.min_instances}
    asked |= {u.transformation for u in environment.units if _is_pinned(environment, u)}
    found = asked & possible
    ahead = [target.tag for target in environment.targets]
    ahead += [port.tag for label in sorted(found) for port in environment.transformation[label].inputs]
    seen = set(ahead)
    for tag in ahead:
        givers.watch()
        for label in givers.of(tag):
            if label in possible and label not in found:
                found.add(label)
            new = [p.tag for p in environment.transformation[label].inputs if p.tag not in seen]
            seen.update(new)
            ahead += new
    return frozenset(found)


def _is_pinned(environment: Environment, unit: ComputationUnit) -> bool:
    transformation = environment.transformation.get(unit.transformation)
    return transformation is not None and transformation.pinned


def _present(problem: Problem) -> Iterable[Candidate]:
    environment = problem.environment
    for unit in environment.units:
        transformation = environment.transformation.get(unit.transformation)
        if transformation is None or (environment.hosts and unit.host not in environment.hosts_for(transformation)):
            continue
        if unit.standby and (problem.survive is None or transformation.standby_us is None):
            continue
        yield Candidate(
            unit.id,
            transformation,
            unit,
            (unit.host,),
            not unit.standby,
            unit.standby,
            keep_cost_us(transformation, problem.horizon_s),
            standby_cost_us(transformation, problem.horizon_s),
        )


def _new(problem: Problem, labels: frozenset[str], watch: Callable[[], None]) -> Iterable[Candidate]:
    environment = problem.environment
    numbers = {t.label: problem.most_new(t) for t in environment.library if t.label in labels}
    for label, unit_ids in fresh_units(environment, numbers).items():
        watch()
        transformation = environment.transformation[label]
        hosts = environment.hosts_for(transformation)
        for unit_id in unit_ids if hosts else ():
            yield Candidate(
                unit_id,
                transformation,
                None,
                hosts,
                may_run=True,
                may_wait=problem.survive is not None and transformation.standby_us is not None,
                cost_us=start_cost_us(transformation, problem.horizon_s),
                waiting_cost_us=standby_cost_us(transformation, problem.horizon_s),
            )
