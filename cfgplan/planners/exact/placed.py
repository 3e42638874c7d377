"""Units on hosts, and streams carried to hosts, as labels of one core: its plans pay for streams between hosts.

A unit needs its inputs on its host, and gives its streams there. A carried stream needs the stream where it is made,
and gives it on another host; it is paid once, however many units take it there. The core leaves out the room on hosts,
distinct and feedback inputs, and the qualities of streams.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Hashable, Iterable, Iterator

from cfgplan.domain import Stream
from cfgplan.planners.exact.candidates import Candidates, HostName
from cfgplan.planners.networks.core import NEVER, Core, Floats, Rows
from cfgplan.planners.networks.greedy import FREE, plan_at, with_less
from cfgplan.planners.networks.network import Choosable
from cfgplan.planners.solving.arrays import np


class PlacedNetwork(Choosable):
    """The core of the candidates on their hosts; the first labels are the `units`, each a candidate and its host.

    The new candidates of a transformation are one label on each host.
    """

    def __init__(self, candidates: Candidates) -> None:
        """Raises OutOfTimeError by the candidates' clock."""
        self.candidates = candidates
        self.units: list[tuple[int, HostName]] = []
        self._facts: dict[Hashable, int] = {}
        self._needs: list[list[int]] = []
        self._providers: list[list[int]] = []
        self._cost_us: list[int] = []
        self._fact_of_tag = candidates.network.fact_of_tag
        self._met = self._facts_met()
        for index in candidates.clock.each(i for label in candidates.network.labels for i in self._examples(label)):
            self._add_units(index)
        for index in candidates.clock.each(dict.fromkeys(index for index, _ in self.units)):
            self._add_carried(index)
        targets = [self._fact(self._fact_of_tag[t.tag], t.host) for t in candidates.environment.stream_targets]
        asked_for = [self._fact(label) for label in candidates.network.labels if label in candidates.asked_for]
        self._needs.append([*targets, *asked_for])
        self.core = Core(Rows.of(sorted(set(row)) for row in self._needs), Rows.of(self._providers))
        self.cost = np.array(self._cost_us, np.int64)

    def cheap_plan(self, attempts: int) -> dict[int, HostName]:
        """The host of each candidate in a cheap plan, after up to `attempts` attempts to do without a member of it.

        Empty if no plan was found.
        """
        cost, clock = self.cost.copy(), self.candidates.clock
        price: Floats = np.asarray(cost, np.float64) + 1.0
        while (chosen := plan_at(self, cost, price, clock.each)) is not None:
            chosen = with_less(self, cost, chosen, attempts, clock)
            host_of, too_many = self._hosts(chosen)
            if not too_many:
                return host_of
            price[[*chosen]] = FREE
            price[too_many], cost[too_many] = np.inf, NEVER
        return {}

    def _hosts(self, chosen: Iterable[int]) -> tuple[dict[int, HostName], list[int]]:
        """The host of each candidate among chosen labels, and the labels for which no candidate is left."""
        host_of: dict[int, HostName] = {}
        too_many = []
        all_of = self.candidates.all
        for number in sorted(label for label in chosen if label < len(self.units)):
            index, host = self.units[number]
            same = self.candidates.units_of(all_of[index].transformation.label)
            new = [i for i in same if all_of[i].running is None]
            free = [i for i in (index, *new) if i not in host_of and host in all_of[i].places]
            if free:
                host_of[free[0]] = host
            else:
                too_many.append(number)
        return host_of, too_many

    def _facts_met(self) -> dict[Stream, list[tuple[int]]]:
        """The network's facts that each stream meets."""
        met = defaultdict[Stream, set[tuple[int]]](set)
        for tag, fact in self._fact_of_tag.items():
            for stream in self.candidates.streams(tag):
                met[stream].add((fact,))
        return {stream: sorted(facts) for stream, facts in met.items()}

    def _examples(self, label: str) -> Iterator[int]:
        """The running candidates of a transformation, and its first new one."""
        may_run = [i for i in self.candidates.units_of(label) if self.candidates.all[i].may_run]
        running = [i for i in may_run if self.candidates.all[i].running is not None]
        return iter(running + [i for i in may_run if self.candidates.all[i].running is None][:1])

    def _add_units(self, index: int) -> None:
        """Add a candidate on each of its hosts."""
        candidate, kind = self.candidates.all[index], self.candidates.all[index].transformation
        tags = [port.tag for port in kind.needed_inputs if not port.feedback]
        is_asked_for = kind.label in self.candidates.asked_for
        for host, place in candidate.places.items():
            needs = [self._fact(self._fact_of_tag[tag], host) for tag in tags]
            gives = [self._fact(kind.label)] if is_asked_for else []
            for port in kind.outputs:
                if met := self._met.get(Stream(candidate.id, port.name)):
                    gives += [self._fact(*key, at) for key in ((candidate.id, port.name), *met) for at in (host, None)]
            self.units.append((index, host))
            self._add(needs, gives, place.cost_us)

    def _add_carried(self, index: int) -> None:
        """Add each stream of a candidate as carried to each host: one label if it costs the same from all."""
        candidate = self.candidates.all[index]
        streams = [Stream(candidate.id, port.name) for port in candidate.transformation.outputs]
        for stream in (one for one in streams if one in self._met):
            for to in (kind.first for kind in self.candidates.hosts):
                cost_us = {at: self.candidates.carried_us(stream, at, to) for at in candidate.places if at != to}
                is_uniform = len(set(cost_us.values())) == 1
                gives = [self._fact(*met, to) for met in self._met[stream]]
                for at, us in [(None, min(cost_us.values()))] if is_uniform else cost_us.items():
                    self._add([self._fact(candidate.id, stream.port, at)], gives, us)

    def _add(self, needs: list[int], gives: Iterable[int], cost_us: int) -> None:
        for fact in dict.fromkeys(gives):
            self._providers[fact].append(len(self._needs))
        self._needs.append(needs)
        self._cost_us.append(cost_us)

    def _fact(self, *key: Hashable) -> int:
        fact = self._facts.setdefault(key, len(self._facts))
        if fact == len(self._providers):
            self._providers.append([])
        return fact
