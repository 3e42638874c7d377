"""The counting model: integer variables say how many units of each group are on hosts of each kind."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Final, NamedTuple

from ortools.sat.python.cp_model import IntVar, LinearExpr

from cfgplan.domain import InputPort, Objective, Stream
from cfgplan.onward import grouped
from cfgplan.planners.exact.candidates import Candidates
from cfgplan.planners.exact.groups import Group, HostKind
from cfgplan.planners.solving.engine import ExactModel

Where = tuple[int, int]
"""The number of a group, and that of a kind of hosts."""
GroupOutput = tuple[int, str]
"""The number of a group, and an output port of its units."""


@dataclass(frozen=True)
class Misfit:
    """Numbers of units, by their groups, that do not fit on so many hosts of a kind."""

    kind: int
    hosts: int
    units: Mapping[int, int]
    company: frozenset[int]
    """The groups that others need beside them: with another number of these it may be otherwise."""


class Weights(NamedTuple):
    """A packing constraint: the weight of a unit of each group, and the most that one host of a kind carries."""

    of: Mapping[int, int]
    most: int


class CountingModel:
    """The numbers of units on each kind of host, as variables of a constraint model.

    If each kind is one host, the model is complete. Otherwise it bounds the total load of all hosts of a kind and their
    number; the caller has to check whether the units can be placed.
    """

    def __init__(
        self,
        candidates: Candidates,
        groups: Sequence[Group],
        kinds: Sequence[HostKind],
        rules: Sequence[CountingRule] | None = None,
    ) -> None:
        self.candidates, self.environment = candidates, candidates.environment
        self.groups, self.kinds = groups, kinds
        self.cp = ExactModel()
        self.group_of = {i: number for number, group in enumerate(groups) for i in group.units}
        self.number = [self.cp.new_int_var(0, len(group.units), "") for group in groups]
        """How many units of each group run."""
        self.there: dict[Where, IntVar] = {}
        """How many units of a group are on hosts of a kind."""
        self.has: dict[Where, IntVar] = {}
        """How many hosts of a kind have units of a group."""
        self.used: dict[int, IntVar] = {}
        """How many hosts of a kind have any unit."""
        self.stays: dict[int, IntVar] = {}
        """Whether the unit of a group, which runs, is wired as it was."""
        self.publishes: dict[tuple[str, GroupOutput], IntVar] = {}
        """Whether a unit of a group publishes a target, by the target's label."""
        self.streams: dict[tuple[int, str, GroupOutput], IntVar] = {}
        """How many streams units of a group take at an input from another group: where some serve only so many."""
        for rule in COUNTED if rules is None else rules:
            rule(self)

    def forbid(self, misfit: Misfit) -> None:
        """Demand other numbers than those that do not fit: fewer units of some group, more hosts, or other company."""
        more = self.cp.new_bool_var("")
        self.cp.add(self.used[misfit.kind] > misfit.hosts).only_enforce_if(more)
        ways = [more]
        for n, number in misfit.units.items():
            there = self.there[n, misfit.kind]
            for is_other in (there < number, there > number) if n in misfit.company else (there < number,):
                ways.append(self.cp.new_bool_var(""))
                self.cp.add(is_other).only_enforce_if(ways[-1])
        self.cp.add_bool_or(ways)

    def limit(self, kind: int, weights: Weights) -> None:
        """Add the constraint that the units on hosts of a kind weigh at most what that number of hosts carries."""
        weight = LinearExpr.sum([weight * self.there[n, kind] for n, weight in weights.of.items()])
        self.cp.add(weight <= weights.most * self.used[kind])

    @cached_property
    def of_label(self) -> dict[str, list[int]]:
        """The groups of each transformation."""
        return grouped((group.label, number) for number, group in enumerate(self.groups))

    @cached_property
    def runs(self) -> dict[str, IntVar]:
        """Whether any unit of a transformation runs."""
        found: dict[str, IntVar] = {}
        for label, groups in self.of_label.items():
            found[label] = runs = self.cp.new_bool_var("")
            most = sum(len(self.groups[n].units) for n in groups)
            self.cp.add(self.units_of(label) <= most * runs)
            self.cp.add(self.units_of(label) >= runs)
        return found

    def units_of(self, label: str) -> LinearExpr:
        """How many units of a transformation run."""
        return LinearExpr.sum([self.number[n] for n in self.of_label.get(label, ())])

    def sources(self, tag: str) -> list[GroupOutput]:
        """The outputs that match a demanded tag."""
        streams = self.candidates.streams(tag)
        return list(dict.fromkeys((self.group_of[self.candidates.index_of[s.unit]], s.port) for s in streams))

    def serves(self, source: GroupOutput) -> int | None:
        """The most consumers of each stream of an output; None if it serves any number."""
        return self.groups[source[0]].first.transformation.output[source[1]].serves

    def is_limited(self, port: InputPort) -> bool:
        """Whether some of the streams that may feed an input serve only so many."""
        return any(self.serves(source) is not None for source in self.sources(port.tag))

    def most_there(self, group: int, kind: int) -> int:
        """The most units of a group that fit on one host of a kind."""
        found, hosts = self.groups[group], self.kinds[kind]
        takes, per_host = found.first.places[hosts.first].takes, found.first.transformation.per_host
        by_room = [room // takes[each] for each, room in hosts.rooms.items() if takes.get(each)]
        return min([len(found.units), *by_room, *([] if per_host is None else [per_host])])

    def objective(self, which: Objective) -> LinearExpr:
        """An objective as a linear expression."""
        match which:
            case Objective.COST:
                places = [self.groups[n].first.places[self.kinds[k].first] for n, k in self.there]
                terms = [place.cost_us * on for place, on in zip(places, self.there.values(), strict=True)]
                return LinearExpr.sum([*terms, self.objective(Objective.RENT)])
            case Objective.RENT:
                return LinearExpr.sum([self.kinds[k].rent_us * used for k, used in self.used.items()])
            case Objective.UNITS:
                return LinearExpr.sum(self.number)
            case Objective.HOSTS:
                return LinearExpr.sum([*self.used.values()] if self.environment.hosts else [])
            case Objective.REWIRED:
                running = [n for n, group in enumerate(self.groups) if group.first.running is not None]
                return LinearExpr.sum([self.number[n] - self.stays.get(n, 0) for n in running])
            case Objective.STARTED:
                new = zip(self.groups, self.number, strict=True)
                return LinearExpr.sum([number for group, number in new if group.first.running is None])


CountingRule = Callable[[CountingModel], None]


def hosts_of_a_kind_bear_their_units(counts: CountingModel) -> None:
    """Units take no more resources than the used hosts have, and each host holds at most `most_there` of a group."""
    for k, kind in enumerate(counts.kinds):
        counts.used[k] = counts.cp.new_int_var(0, len(kind.names), "")
        here = [n for n, group in enumerate(counts.groups) if kind.first in group.first.places]
        for n in here:
            _units_are_on_hosts(counts, n, k)
        counts.cp.add(counts.used[k] <= LinearExpr.sum([counts.there[n, k] for n in here]))
        takes = {n: counts.groups[n].first.places[kind.first].takes for n in here}
        for resource, room in kind.rooms.items():
            taken = LinearExpr.sum([takes[n].get(resource, 0) * counts.there[n, k] for n in here])
            counts.cp.add(taken <= room * counts.used[k])
    for n, number in enumerate(counts.number):
        counts.cp.add(number == LinearExpr.sum([on for (group, _), on in counts.there.items() if group == n]))


def _units_are_on_hosts(counts: CountingModel, group: int, kind: int) -> None:
    hosts, most = len(counts.kinds[kind].names), counts.most_there(group, kind)
    there = counts.there[group, kind] = counts.cp.new_int_var(0, hosts * most, "")
    has = counts.has[group, kind] = there if most == 1 else counts.cp.new_int_var(0, hosts, "")
    counts.cp.add(has <= counts.used[kind])
    if most != 1:
        counts.cp.add(there <= most * has)
        counts.cp.add(has <= there)


def pinned_units_stay(counts: CountingModel) -> None:
    for n, group in enumerate(counts.groups):
        if counts.candidates.is_pinned(group.units[0]):
            counts.cp.add(counts.number[n] == 1)


def there_are_as_many_as_asked_for_and_allowed(counts: CountingModel) -> None:
    for kind in counts.environment.library:
        if kind.min_instances:
            counts.cp.add(counts.units_of(kind.label) >= kind.min_instances)
        if kind.max_instances is not None:
            counts.cp.add(counts.units_of(kind.label) <= kind.max_instances)


def no_host_has_more_of_a_transformation_than_it_allows(counts: CountingModel) -> None:
    for groups in counts.of_label.values():
        most = counts.groups[groups[0]].first.transformation.per_host
        if most is not None:
            for k, used in counts.used.items():
                here = LinearExpr.sum([counts.there[n, k] for n in groups if (n, k) in counts.there])
                counts.cp.add(here <= most * used)


def who_conflicts_is_not_there_together(counts: CountingModel) -> None:
    for label, other in _pairs(counts, "conflicts"):
        counts.cp.add_at_most_one(counts.runs[label], counts.runs[other])


def who_conflicts_is_not_on_one_host(counts: CountingModel) -> None:
    for label, other in _pairs(counts, "conflicts_on_host"):
        for one, second in product(counts.of_label[label], counts.of_label[other]):
            for k in range(len(counts.kinds)):
                if (one, k) in counts.has and (second, k) in counts.has:
                    counts.cp.add(counts.has[one, k] + counts.has[second, k] <= counts.used[k])


def _pairs(counts: CountingModel, said: str) -> Iterator[tuple[str, str]]:
    for label, groups in counts.of_label.items():
        for other in getattr(counts.groups[groups[0]].first.transformation, said):
            if other != label and other in counts.of_label:
                yield label, other


def who_runs_has_company(counts: CountingModel) -> None:
    """On each host with a unit there is one of each transformation that it runs with."""
    for n, group in enumerate(counts.groups):
        for label in group.first.transformation.beside:
            for k in (k for one, k in counts.has if one == n):
                company = [counts.has[m, k] for m in counts.of_label.get(label, ()) if (m, k) in counts.has]
                counts.cp.add(counts.has[n, k] <= LinearExpr.sum(company))


def inputs_are_fed(counts: CountingModel) -> None:
    """Each by streams of as many different units as it counts; where these serve only so many, streams are counted."""
    for label, groups in counts.of_label.items():
        for port in counts.groups[groups[0]].first.transformation.inputs:
            feeders = sorted({n for n, _ in counts.sources(port.tag)})
            enough = LinearExpr.sum([counts.number[n] for n in feeders]) >= port.count
            counts.cp.add(enough).only_enforce_if(counts.runs[label])
            for n in groups if counts.is_limited(port) else ():
                _takes_streams(counts, n, port, feeders)


def _takes_streams(counts: CountingModel, group: int, port: InputPort, feeders: Sequence[int]) -> None:
    taken: dict[int, list[IntVar]] = defaultdict(list)
    units = len(counts.groups[group].units)
    for source in counts.sources(port.tag):
        most = units * min(port.count, len(counts.groups[source[0]].units))
        streams = counts.streams[group, port.name, source] = counts.cp.new_int_var(0, most, "")
        taken[source[0]].append(streams)
    counts.cp.add(LinearExpr.sum([s for these in taken.values() for s in these]) == port.count * counts.number[group])
    for feeder in feeders:
        if port.count == 1 or units == 1:
            counts.cp.add(LinearExpr.sum(taken[feeder]) <= units * counts.number[feeder])
            continue
        pairs = counts.cp.new_int_var(0, units * len(counts.groups[feeder].units), "")
        counts.cp.add_multiplication_equality(pairs, [counts.number[feeder], counts.number[group]])
        counts.cp.add(LinearExpr.sum(taken[feeder]) <= pairs)


def targets_are_met(counts: CountingModel) -> None:
    for target in counts.environment.stream_targets:
        ways = {source: counts.cp.new_bool_var("") for source in counts.sources(target.tag)}
        for source, publishes in ways.items():
            counts.publishes[target.label, source] = publishes
            counts.cp.add(publishes <= counts.number[source[0]])
        counts.cp.add_exactly_one(ways.values())
    for label in counts.environment.wanted_to_run.values():
        counts.cp.add(counts.units_of(label) >= 1)


def a_stream_serves_only_so_many(counts: CountingModel) -> None:
    taking = [(source, streams) for (_, _, source), streams in counts.streams.items()]
    taking += [(source, publishes) for (_, source), publishes in counts.publishes.items()]
    for source, taken in grouped(taking).items():
        most = counts.serves(source)
        if most is not None:
            counts.cp.add(LinearExpr.sum(taken) <= most * counts.number[source[0]])


def who_stays_as_it_is_has_what_it_had(counts: CountingModel) -> None:
    """A unit that stays keeps its present streams and its present publications, and gets no others."""
    index_of = counts.candidates.index_of
    for n, group in enumerate(counts.groups):
        unit = group.first.running
        if unit is None or not counts.candidates.may_stay(group.units[0]):
            continue
        stays = counts.stays[n] = counts.cp.new_bool_var("")
        counts.cp.add(stays <= counts.number[n])
        for subscription in unit.subscriptions:
            feeder = counts.group_of[index_of[subscription.stream.unit]]
            counts.cp.add(stays <= counts.number[feeder])
            taken = counts.streams.get((n, subscription.port, (feeder, subscription.stream.port)))
            if taken is not None:
                counts.cp.add(stays <= taken)
        published = {Stream(p.topic, p.port) for p in unit.publications}
        topics = {target.label: target.topic for target in counts.environment.stream_targets}
        for (target, (publisher, port)), publishes in counts.publishes.items():
            if publisher == n:
                is_old = Stream(topics[target], port) in published
                counts.cp.add_implication(stays, publishes if is_old else publishes.negated())


def hosts_alike_are_taken_in_order(counts: CountingModel) -> None:
    """Where each host is a kind of its own: the later ones have less on them."""
    for k in range(1, len(counts.kinds)):
        if counts.kinds[k].rooms is counts.kinds[k - 1].rooms:
            counts.cp.add(counts.used[k] <= counts.used[k - 1])


PLACED: Final[tuple[CountingRule, ...]] = (
    hosts_of_a_kind_bear_their_units,
    no_host_has_more_of_a_transformation_than_it_allows,
    who_conflicts_is_not_on_one_host,
    who_runs_has_company,
    hosts_alike_are_taken_in_order,
)
"""The constraints on the numbers of units on hosts."""
COUNTED: Final[tuple[CountingRule, ...]] = (
    *PLACED,
    pinned_units_stay,
    there_are_as_many_as_asked_for_and_allowed,
    who_conflicts_is_not_there_together,
    inputs_are_fed,
    targets_are_met,
    a_stream_serves_only_so_many,
    who_stays_as_it_is_has_what_it_had,
)
"""The constraints on a configuration, in the order in which their variables are made."""
