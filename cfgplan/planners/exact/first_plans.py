"""Plans for a fleet before any model is built: cheapest supports by h_add, placed, wired and given spares.

Some rules are not kept on the way: a plan that breaks one is refused when it is offered.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from functools import cached_property
from types import MappingProxyType

from cfgplan.planners.exact.candidates import Candidates, HostName
from cfgplan.planners.exact.configuration import Configuration, spare_prices
from cfgplan.planners.exact.placed import PlacedNetwork
from cfgplan.planners.exact.solve_state import SolveState
from cfgplan.planners.networks.core import Floats
from cfgplan.planners.networks.greedy import FREE, plan_at
from cfgplan.planners.reducing.closure import with_companions
from cfgplan.planners.solving.arrays import np
from cfgplan.qualities import QualityAttribute, QualityRule


class FirstPlans:
    """Offers plans made of chosen transformations or candidates."""

    def __init__(self, candidates: Candidates, state: SolveState) -> None:
        self.candidates, self.state = candidates, state
        self.network = candidates.network
        self._spare_us = spare_prices(candidates)
        labels = candidates.clock.each(self.network.labels)
        units = [[c.cost_us for c in candidates.of(label) if c.may_run] for label in labels]
        self._run_us = np.array([min(these, default=np.inf) for these in units], np.float64)
        self._cost = candidates.least_us
        self._has_looked = False
        self._attribute = _asked(candidates)
        self._is_weighed = any(wish.weight_us for target in candidates.environment.targets for wish in target.quality)

    def look(self, attempts: int) -> None:
        """Offer a plan of cheap transformations, then make up to `attempts` more, each without one of the most
        expensive ones.

        If these are the first plans of all, one that pays for what it carries is offered last: it takes longer than all
        others, so that a short time limit would end before them; to replan takes less time than to look for it.
        """
        candidates, state = self.candidates, self.state
        if len(self.network.targets) < len(candidates.environment.targets):
            return
        is_first = state.best is None and not self._has_looked
        self._has_looked = True
        price = self._price
        tried: set[str] = set()
        while price is not None and state.best is not None and len(tried) < attempts:
            if state.clock.is_over() or state.is_at_bound:
                break
            labels = {unit.transformation for unit in state.best.units if not unit.standby}
            ahead = sorted(candidates.numbers(labels - tried), key=lambda n: (-self._cost[n], n))
            if not ahead:
                break
            tried.add(self.network.labels[ahead[0]])
            around = price.copy()
            around[candidates.numbers(labels)] = FREE
            around[ahead[0]] = np.inf
            self._offer_supports(around)
        if is_first and not state.is_at_bound:
            self._offer_placed()

    @cached_property
    def _price(self) -> Floats | None:
        """Prices at which a first plan was found; None if none was.

        Prices are costs, plus more and more for each `_burden`. Where quality has a price, those with the best plan are
        returned.
        """
        price = self._run_us + 1
        if self.candidates.problem.survive is not None:
            price += np.minimum(self._spare_us, self._run_us)
        burden = self._burden()
        usual = price[np.isfinite(price)].mean() / burden[burden > 0].mean() if (burden > 0).any() else 0.0
        found: Floats | None = None
        shares = self.state.clock.tuning.begin.shares
        for share in shares if usual else shares[:1]:
            priced, before = price + share * usual * burden, self.state.best
            if self._offer_supports(priced) and (found is None or self.state.best is not before):
                found = priced
            if self.state.is_at_bound or (found is not None and not self._is_weighed):
                break
        return found

    def _offer_placed(self) -> None:
        """Offer a plan that pays for the streams between hosts, unless they cost nothing or that takes too long."""
        candidates, environment, clock = self.candidates, self.candidates.environment, self.state.clock
        number, places = len(environment.hosts), sum(len(candidate.places) for candidate in candidates.all)
        size = places * (2 if len(environment.prices_us) == 1 else number)
        if number > 1 and any(environment.prices_us) and clock.has_steps(clock.tuning.begin.placing * size):
            host_of = PlacedNetwork(candidates).cheap_plan(clock.tuning.begin.attempts)
            labels = {candidates.all[i].transformation.label for i in host_of}
            self.offer(self.units_of(self._with_companions(labels, self._run_us + 1)).union(host_of), host_of)

    def _burden(self) -> Floats:
        """Each transformation's burden: badness that it adds or, with no attribute, its share of hosts' resources."""
        attribute, transformations = self._attribute, self.network.transformations
        if attribute is None:
            hosts = self.candidates.environment.hosts
            resources = sorted({resource for t in transformations for resource in t.takes})
            have = {resource: sum(host.room(resource) or 0 for host in hosts) or np.inf for resource in resources}
            shares = [sum(amount / have[resource] for resource, amount in t.takes.items()) for t in transformations]
            return np.array(shares, np.float64)
        stated = [
            [c for port in t.outputs for c in port.quality if c.attribute == attribute.name]
            for t in self.candidates.clock.each(transformations)
        ]
        added = [[attribute.sign * c.value for c in these if c.rule is QualityRule.ADD] for these in stated]
        return np.array([max([0, *values]) for values in added], np.float64)

    def _offer_supports(self, price: Floats) -> bool:
        """Offer the cheapest support at these prices, without the more expensive one of two conflicting
        transformations.
        """
        for _ in self.candidates.environment.library:
            support = plan_at(self.network, self._cost, price)
            if support is None:
                return False
            labels = {self.network.labels[n] for n in support}
            more_expensive = self._more_expensive_in_conflict(labels)
            if more_expensive is None:
                return self.offer(self.units_of(self._with_companions(labels, price)))
            price = price.copy()
            price[more_expensive] = np.inf
        return False

    def _with_companions(self, labels: Collection[str], price: Floats) -> Collection[str]:
        """Some labels, those that they run with, and the cheapest that feed these."""
        environment, number = self.candidates.environment, self.network.number
        found = set(with_companions(environment, labels)) & number.keys()
        ahead = sorted(found.difference(labels))
        for label in ahead:
            for port in environment.transformation[label].inputs:
                providers = [provider for provider in self.candidates.providers.of(port.tag) if provider in number]
                if providers and found.isdisjoint(providers):
                    cheapest = min(providers, key=lambda provider: (price[number[provider]], provider))
                    new = [one for one in with_companions(environment, [cheapest]) if one not in found]
                    found.update(new)
                    ahead += new
        return found & number.keys()

    def _more_expensive_in_conflict(self, labels: Collection[str]) -> int | None:
        number, library = self.network.number, self.candidates.environment.transformation
        for label in sorted(labels):
            for other in library[label].conflicts:
                if other in labels and other != label:
                    return max(number[label], number[other], key=lambda n: (self._cost[n], n))
        return None

    def units_of(self, labels: Iterable[str]) -> set[int]:
        """As many candidates of each transformation as have to run, the cheapest first."""
        candidates = self.candidates
        chosen: set[int] = set()
        for label in sorted(labels):
            numbers = [i for i in candidates.units_of(label) if candidates.all[i].may_run]
            numbers.sort(key=lambda i: (not candidates.is_pinned(i), candidates.all[i].cost_us, i))
            pinned = sum(map(candidates.is_pinned, numbers))
            chosen.update(numbers[: max(1, pinned, candidates.environment.transformation[label].min_instances)])
        return chosen

    def offer(self, hot: Collection[int], wished: Mapping[int, HostName] = MappingProxyType({})) -> bool:
        """Offer a configuration in which these candidates run, on the hosts `wished` if these have room; False if it is
        not valid.
        """
        units = Configuration(self.candidates, hot, self._attribute, self._spare_us, wished).units()
        return units is not None and self.state.offer(self.candidates, units) is not None


def _asked(candidates: Candidates) -> QualityAttribute | None:
    """An attribute that targets ask for, if possible one that they bound; None if they ask for none."""
    wishes = [wish for target in candidates.environment.targets for wish in target.quality]
    bounded = [wish.attribute for wish in wishes if wish.bound is not None]
    names = bounded or [wish.attribute for wish in wishes]
    return candidates.environment.quality[names[0]] if names else None
