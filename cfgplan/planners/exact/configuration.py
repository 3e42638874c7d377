"""A configuration made of chosen units: placed, wired, and with spares for the failures that it has to survive.

For each failure, the units that then meet the targets most cheaply are added to those left, as cold spares if that is
enough.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from functools import partial

from cfgplan.domain import ComputationUnit, Stream, Subscription, Target
from cfgplan.planners.exact.candidates import Candidate, Candidates, HostName, Placement
from cfgplan.planners.exact.grounded import Grounded
from cfgplan.planners.exact.places import Places
from cfgplan.planners.exact.pruning import lean, needed_units
from cfgplan.planners.exact.survivors import Failure, placement_of, unmet
from cfgplan.planners.exact.wiring import named
from cfgplan.planners.networks.core import Floats
from cfgplan.planners.networks.greedy import FREE, plan_at
from cfgplan.planners.networks.reach import Reach
from cfgplan.planners.solving.arrays import np
from cfgplan.planning import Failures
from cfgplan.qualities import QualityAttribute


def spare_prices(candidates: Candidates) -> Floats:
    """The price of a spare of each transformation in the network; all 0 if no failure has to be survived."""
    if candidates.problem.survive is None:
        return np.zeros(len(candidates.network.labels))
    units = [candidates.of(label) for label in candidates.network.labels]
    return np.array([min(map(_spare_us, these), default=np.inf) for these in units], np.float64)


def _spare_us(candidate: Candidate) -> int:
    return candidate.waiting_cost_us if candidate.may_wait else candidate.cost_us


def wire(candidates: Candidates, chosen: Collection[int]) -> list[ComputationUnit] | None:
    """The chosen candidates wired, running ones on their hosts, and as they are where they can stay so.

    None if they do not ground each other. Where nothing is asked beyond the paper, those that nothing needs are left
    out. Raises OutOfTimeError by the candidates' clock.
    """
    grounded, places = Grounded(candidates, chosen, None), Places(candidates, {})
    if len(grounded.order) < len(chosen) or not places.put_all(grounded):
        return None
    units = places.units(grounded)
    if units is None or not candidates.problem.is_plain:
        return units
    roots = [u for u in units if u.publications or candidates.is_pinned(candidates.index_of[u.id])]
    needed = needed_units(candidates.environment, units, roots)
    return [unit for unit in units if unit.id in needed]


def wired_as_before(
    candidates: Candidates, chosen: Collection[int], before: Mapping[str, ComputationUnit]
) -> list[ComputationUnit] | None:
    """The chosen candidates, each wired as the unit of its transformation was before; running ones that may stay stay.

    None if some transformation had no unit `before`, or has two now. Whether the wiring is valid has to be checked.
    """
    all_of = candidates.all
    id_of = {all_of[i].transformation.label: all_of[i].id for i in chosen}
    if len(id_of) < len(chosen) or not before.keys() >= id_of.keys():
        return None
    now = {before[label].id: id_ for label, id_ in id_of.items()}
    units = []
    for i in sorted(chosen):
        running, was = all_of[i].running, before[all_of[i].transformation.label]
        if running is not None and candidates.may_stay(i):
            units.append(running)
            continue
        if any(s.stream.unit not in now for s in was.subscriptions):
            return None
        fed = tuple(Subscription(s.port, Stream(now[s.stream.unit], s.stream.port)) for s in was.subscriptions)
        units.append(ComputationUnit(all_of[i].id, was.transformation, fed, was.publications))
    return units


class Configuration:
    """Makes a valid configuration of chosen units: `hot` ones run, `cold` ones wait as spares."""

    def __init__(
        self,
        candidates: Candidates,
        hot: Collection[int],
        attribute: QualityAttribute | None,
        spare_us: Floats,
        wished: Mapping[int, HostName],
    ) -> None:
        """Inputs take the streams whose `attribute` is best; `spare_us` are the `spare_prices`. Candidates are placed
        on the hosts `wished` for them, if these have room.
        """
        self.candidates = candidates
        self._spare_us = spare_us
        self.hot = set(hot)
        self.cold: set[int] = set()
        self._attribute = attribute
        self._places = Places(candidates, wished)
        self._grounded = Grounded(candidates, (), attribute)

    def units(self) -> list[ComputationUnit] | None:
        """The lean configuration; None if hosts have no room, or a target can't be met or a failure be survived."""
        if not (self._survives_lost_units() and self._place(None)):
            return None
        if self.candidates.problem.survive is Failures.HOSTS and not self._survives_lost_hosts():
            return None
        running = self._places.units(self._grounded)
        if running is None:
            return None
        cold = [self.candidates.all[i].spare_on(self._places.host_of[i]) for i in sorted(self.cold)]
        each = partial(self.candidates.clock.each, at_once=1)
        return named(self.candidates, lean(self.candidates, [*running, *cold], each))

    def _place(self, but_on: HostName) -> bool:
        self._grounded = Grounded(self.candidates, self.hot, self._attribute)
        self.hot &= set(self._grounded.order)
        places, all_of = self._places, self.candidates.all
        return places.put_all(self._grounded, but_on) and all(
            places.put(i, [host for host in all_of[i].hosts if but_on is None or host != but_on])
            for i in sorted(self.cold)
            if i not in places.host_of
        )

    def _survives_lost_units(self) -> bool:
        all_of, targets = self.candidates.all, self.candidates.environment.targets
        if self.candidates.problem.survive is None:
            return True
        for i in self.candidates.clock.each(sorted(self.hot, key=lambda i: (-all_of[i].cost_us, i)), 1):
            label = all_of[i].transformation.label
            left = [one for one in self.hot | self.cold if one != i]
            if label not in self._labels(left) and not self._survives(None, left, targets):
                return False
        return True

    def _survives_lost_hosts(self) -> bool:
        environment, host_of = self.candidates.environment, self._places.host_of
        for host in self.candidates.clock.each(environment.hosts, 1):
            left = [i for i in self.hot | self.cold if host_of[i] != host.name]
            targets = tuple(target for target in environment.targets if target.host != host.name)
            if not (self._survives(host.name, left, targets) and self._place(host.name)):
                return False
        return True

    def _labels(self, units: Collection[int]) -> frozenset[str]:
        return frozenset(self.candidates.all[i].transformation.label for i in units)

    def _sites(self, units: Collection[int]) -> frozenset[Placement]:
        all_of, host_of = self.candidates.all, self._places.host_of
        labels = {i: all_of[i].transformation.label for i in units}
        return frozenset(
            placement_of(self.candidates.environment, label, host_of.get(i)) for i, label in labels.items()
        )

    def _survives(self, host: str | None, left: Collection[int], targets: tuple[Target, ...]) -> bool:
        """Add spares that meet the targets together with the units `left` after a failure. False if there are none."""
        candidates, labels = self.candidates, self._labels(left)
        if not unmet(candidates, Failure(host, dict.fromkeys(self._sites(left), 1), targets)):
            return True
        network = candidates.network
        there = candidates.numbers(labels)
        price = self._spare_us + 1
        lost = self._labels(self.hot | self.cold) - labels
        bound = {c.transformation.label for c in candidates.all if c.hosts == (host,)} if host is not None else set()
        for label in (lost | bound) & network.number.keys():
            one = self._spare(label, host)
            price[network.number[label]] = np.inf if one is None else _spare_us(candidates.all[one]) + 1
        price[there] = FREE
        support = plan_at(network, np.where(np.isfinite(price), price, 0).astype(np.int64), price)
        more = [] if support is None else [self._spare(network.labels[n], host) for n in sorted(support - set(there))]
        self._add([one for one in more if one is not None])
        return support is not None

    def _spare(self, label: str, host: str | None) -> int | None:
        """The cheapest further candidate of a transformation that may be on another host; None if there is none."""
        all_of, chosen = self.candidates.all, self.hot | self.cold
        further = [i for i in self.candidates.units_of(label) if i not in chosen]
        further = [i for i in further if host is None or all_of[i].hosts != (host,)]
        return min(further, key=lambda i: (_spare_us(all_of[i]), i), default=None)

    def _add(self, spares: Collection[int]) -> None:
        """Mark as running the spares that can't wait, or all if those are not fed otherwise. The others wait."""
        all_of, network = self.candidates.all, self.candidates.network
        hot = {i for i in spares if not all_of[i].may_wait}
        if hot:
            reach = Reach(network.core, self.candidates.numbers(self._labels(self.hot | hot)))
            if not all(reach.runs(network.number[label]) for label in self._labels(hot)):
                hot = {i for i in spares if all_of[i].may_run}
        self.hot |= hot
        self.cold |= set(spares) - hot
