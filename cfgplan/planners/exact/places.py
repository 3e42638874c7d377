"""Places chosen units on hosts one after the other, where they have room and little has to be carried."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from functools import partial

from cfgplan.domain import ComputationUnit, Stream
from cfgplan.planners.exact.candidates import Candidates, HostName
from cfgplan.planners.exact.grounded import Grounded
from cfgplan.planners.exact.rules import host_loads
from cfgplan.planners.exact.wiring import wired


class Places:
    """A partial placement: the host of each unit and cold spare, and the stream of each input and target.

    A unit comes on the host `wished` for it if that has room.
    """

    def __init__(self, candidates: Candidates, wished: Mapping[int, HostName]) -> None:
        self.candidates = candidates
        self._wished = wished
        self.host_of: dict[int, HostName] = {}
        self.feeds: dict[tuple[int, str], Stream] = {}
        self.published: dict[str, Stream] = {}
        self._loads = host_loads(candidates.problem)

    def put_all(self, grounded: Grounded, but_on: HostName = None) -> bool:
        """Place all running units that have no host yet, except on `but_on`, and feed them. False if they do
        not fit.
        """
        new = [unit for unit in grounded.order if unit not in self.host_of]
        hosts_of = {unit: [h for h in self.candidates.all[unit].hosts if h is None or h != but_on] for unit in new}
        if not all(self.put(unit, hosts) for unit, hosts in hosts_of.items() if len(hosts) <= 1):
            return False
        for unit in new:
            if unit not in self.host_of and not self.put(unit, self._by_price(grounded, unit, hosts_of[unit])):
                return False
        self._feed(grounded)
        return True

    def put(self, unit: int, hosts: Iterable[HostName]) -> bool:
        """Place a unit on the first of some hosts that has room for it; False if none has."""
        candidate = self.candidates.all[unit]
        for host in hosts:
            if self._loads.put(candidate.transformation, host):
                self.host_of[unit] = host
                return True
        return False

    def _by_price(self, grounded: Grounded, unit: int, hosts: Iterable[HostName]) -> list[HostName]:
        """The hosts for a unit: the one wished for it, then by missing company, then by the cost of running it and of
        carrying its inputs there.
        """
        candidate, missing = self.candidates.all[unit], self._loads.missing_companions
        horizon_s = self.candidates.problem.horizon_s

        def price(host: HostName) -> tuple[bool, int, int, str]:
            carry_us = self._carry_us(grounded, unit, host)
            cost_us = candidate.places[host].cost_us + carry_us + self._loads.rent_us(host) * horizon_s
            is_other = self._wished.get(unit, host) != host
            return is_other, missing(candidate.transformation, host), cost_us, host or ""

        return sorted(hosts, key=price)

    def _carry_us(self, grounded: Grounded, unit: int, host: HostName) -> int:
        """The cost to carry a unit's inputs to a host from those of their feeders that are placed."""
        return sum(
            min(self._price_to(stream, host) for stream in grounded.choices(unit, port))
            for port in self.candidates.all[unit].transformation.inputs
        )

    def _price_to(self, stream: Stream, host: HostName) -> int:
        """The cost to have a stream on a host; 0 while its unit is not placed."""
        at = self.host_of.get(self.candidates.index_of[stream.unit])
        return 0 if host is None or at is None or at == host else self.candidates.carried_us(stream, at, host)

    def _feed(self, grounded: Grounded) -> None:
        """Feed each input by a stream that is on its host already if possible, else by the cheapest to carry there.

        Among equally cheap streams, the present one is taken. A target takes the stream of a unit that publishes it and
        may stay as it is, or of a unit that has to change anyway.
        """
        environment, all_of = self.candidates.environment, self.candidates.all
        carried: set[tuple[Stream, HostName]] = set()

        def taken(choices: Collection[Stream], host: HostName, now: Collection[Stream]) -> Stream:
            def price(stream: Stream) -> tuple[int, bool]:
                return 0 if (stream, host) in carried else self._price_to(stream, host), stream not in now

            stream = min(choices, key=price)
            carried.add((stream, host))
            return stream

        running = [unit for i in grounded.order if (unit := all_of[i].running) is not None]
        was = {each.topic: Stream(unit.id, each.port) for unit in running for each in unit.publications}
        for target in environment.stream_targets:
            if choices := grounded.published(target.tag):
                in_order = sorted(choices, key=partial(self._publish_preference, was.get(target.topic)))
                self.published[target.topic] = taken(in_order, target.host, ())
        for i in grounded.order:
            kept = all_of[i].running
            for port in all_of[i].transformation.inputs:
                now = () if kept is None else kept.feeds.get(port.name, ())
                self.feeds[i, port.name] = taken(grounded.choices(i, port), self.host_of[i], now)

    def _publish_preference(self, old: Stream | None, stream: Stream) -> tuple[bool, bool, bool]:
        """The less of it, the sooner a stream is published where the `old` one is now."""
        publishes = old is not None and stream.unit == old.unit
        may_stay = self.candidates.may_stay(self.candidates.index_of[stream.unit])
        return not publishes, may_stay != publishes, stream != old

    def units(self, grounded: Grounded) -> list[ComputationUnit] | None:
        """The units that run, wired; None if a target is not met."""
        all_of, environment = self.candidates.all, self.candidates.environment
        labels = {all_of[i].transformation.label for i in grounded.order}
        if len(self.published) < len(environment.stream_targets) or not labels.issuperset(
            environment.wanted_to_run.values()
        ):
            return None
        hosts = {i: self.host_of[i] for i in grounded.order}
        feeds = {fed: (stream,) for fed, stream in self.feeds.items()}
        return wired(self.candidates, hosts, feeds, self.published)
