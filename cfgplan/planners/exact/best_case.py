"""Bounds on the badness of streams, from below and from above, attribute by attribute.

Badness is by how much a value misses the best of its scale, in micro-units. The least is that with all running that can
run. A stream that misses every bound even then is of no use anywhere.
"""

from __future__ import annotations

from collections.abc import Collection, Hashable, Iterator
from dataclasses import dataclass
from itertools import chain

from cfgplan.domain import InputPort, OutputPort, Stream, Transformation
from cfgplan.onward import grouped, reached
from cfgplan.planners.exact.candidates import ONLY_IN_THE_MODEL, Candidate, Candidates, HostName
from cfgplan.qualities import MICRO, Contribution, Over, QualityAttribute, QualityRule, price_us, propagated

Demand = tuple[Stream, ...]
"""What inputs or a target ask for: the streams that would do."""


def least_prices_us(candidates: Candidates) -> dict[tuple[str, str], int]:
    """The least price of each target for each attribute, whatever the plan."""
    prices: dict[tuple[str, str], int] = {}
    for attribute in candidates.environment.qualities:
        weighed = [
            (target, wish)
            for target in candidates.environment.targets
            for wish in target.quality
            if wish.attribute == attribute.name and wish.weight_us
        ]
        least = least_badness(candidates, attribute) if weighed else {}
        for target, wish in weighed:
            reached = min((least[stream] for stream in candidates.streams(target.tag) if stream in least), default=0)
            prices[target.label, attribute.name] = price_us(attribute, wish, attribute.at(reached))
    return prices


def least_of_all(candidates: Candidates) -> tuple[int, int, int]:
    """The least cost of any plan, and the least numbers of units that a plan of this cost rewires and starts.

    Every plan runs a unit of each transformation that no plan does without, and no target gets more than the best
    quality. At the least cost it runs the cheapest of these units, which is rewired if it runs and has lost a feed.
    """
    network = candidates.network
    indispensable = [[c for c in candidates.of(network.labels[n]) if c.may_run] for n in network.pinned]
    least_us = [min((c.cost_us for c in units), default=0) for units in indispensable]
    rewired = sum(
        all(_has_lost_a_feed(c) for c in units if c.cost_us == least)
        for units, least in zip(indispensable, least_us, strict=True)
        if units
    )
    started = sum(all(c.running is None for c in units) for units in indispensable if units)
    return sum(least_us) + sum(least_prices_us(candidates).values()), rewired, started


def _has_lost_a_feed(candidate: Candidate) -> bool:
    unit = candidate.running
    if unit is None or unit.standby:
        return False
    return any(port.name not in unit.feeds for port in candidate.transformation.inputs)


def least_badness(candidates: Candidates, attribute: QualityAttribute) -> dict[Stream, int]:
    """For each stream a badness that no wiring goes below. Streams that nothing can feed are left out.

    It is 0 where inputs take none or several: together these may be better than any by itself.
    """
    if attribute not in candidates.least:
        streams = (Stream(c.id, port.name) for c in candidates.all for port in c.transformation.outputs)
        is_of_several = not ONLY_IN_THE_MODEL.isdisjoint(candidates.problem.features)
        least = dict.fromkeys(streams, 0) if is_of_several else _least_badness(candidates, attribute)
        candidates.least[attribute] = least
    return candidates.least[attribute]


def _least_badness(candidates: Candidates, attribute: QualityAttribute) -> dict[Stream, int]:
    """Each round allows chains of one more unit; no chain is longer than there are units, none feeds itself at once."""
    least: dict[Stream, int] = {}
    at: dict[str, int] = {}
    demands = _demands(candidates)
    ordinary = [[port.tag for port in c.transformation.inputs if not port.feedback] for c in candidates.all]
    needing = grouped((tag, i) for i, tags in enumerate(ordinary) for tag in set(tags))

    def of_others(unit: int, tag: str) -> int | None:
        id_ = candidates.all[unit].id
        return min((least[s] for s in candidates.streams(tag) if s in least and s.unit != id_), default=None)

    ahead = [i for i, candidate in enumerate(candidates.all) if candidate.may_run]
    for _ in candidates.all:
        better: set[str] = set()
        for i in candidates.clock.each(ahead):
            candidate = candidates.all[i]
            own = {tag for port in candidate.transformation.outputs for tag in demands.get(port.tag, ())}
            known = [of_others(i, tag) if tag in own else at.get(tag) for tag in ordinary[i]]
            fed = [attribute.at(one) for one in known if one is not None]
            if len(fed) < len(ordinary[i]) or not candidate.may_run:
                continue
            for port in candidate.transformation.outputs:
                stated = stated_of(port, attribute, candidate.hosts)
                made = attribute.badness(propagated(attribute, stated, fed))
                stream = Stream(candidate.id, port.name)
                if made < least.get(stream, made + 1):
                    least[stream] = made
                    for tag in demands.get(port.tag, ()):
                        if made < at.get(tag, made + 1):
                            at[tag] = made
                            better.add(tag)
        ahead = sorted({i for tag in better for i in needing[tag]})
        if not ahead:
            break
    return least


@dataclass(frozen=True, slots=True)
class OutputRule:
    """How bad an output is: `gain` times its `inputs` together, plus `shift`, in millionths; and at least `least`.

    It is `alone` if none of them is fed.
    """

    inputs: tuple[InputPort, ...]
    over: Over
    gain: int
    shift: int
    least: int
    alone: int

    @classmethod
    def of(
        cls, attribute: QualityAttribute, transformation: Transformation, port: OutputPort, hosts: Collection[HostName]
    ) -> OutputRule:
        """The rule by which an output of a transformation derives its badness from the inputs that count, on the best
        of some hosts.
        """
        stated = stated_of(port, attribute, hosts)
        inputs = tuple(port for port in transformation.inputs if not port.feedback)
        own = attribute.scale if stated is None else attribute.badness(stated.value)
        alone = min(max(own, 0), attribute.scale)
        if not inputs or (stated is not None and stated.rule is QualityRule.SET):
            return cls((), Over.WORST, 0, 0, alone, alone)
        if stated is None:
            return cls(inputs, Over.WORST, MICRO, 0, 0, alone)
        match stated.rule:
            case QualityRule.LIMIT:
                return cls(inputs, stated.over, MICRO, 0, alone, alone)
            case QualityRule.SCALE:
                shift = attribute.sign * attribute.best * (stated.value - MICRO)
                return cls(inputs, stated.over, stated.value, shift, 0, alone)
        return cls(inputs, stated.over, MICRO, attribute.sign * stated.value * MICRO, 0, alone)

    def allowed(self, badness: int, worst: int) -> int:
        """The largest badness of inputs for a given badness of the output; `worst` where the rule bounds nothing."""
        is_combined = self.over is not Over.WORST and len(self.inputs) > 1
        if badness == worst or is_combined or self.gain != MICRO:
            return worst
        return min(max(badness - self.shift // MICRO, 0), worst)


def stated_of(port: OutputPort, attribute: QualityAttribute, hosts: Collection[HostName]) -> Contribution | None:
    """Return the contribution of an output to an attribute, on that one of some hosts where it is best."""
    stated = next((c for c in port.quality if c.attribute == attribute.name), None)
    if stated is None or not stated.seen_on:
        return stated
    return min((stated.on(host) for host in hosts), key=lambda each: attribute.sign * each.value, default=stated)


def _demands(candidates: Candidates) -> dict[str, list[str]]:
    """For each offered tag the demanded ones that it meets."""
    return grouped((one, tag) for tag, offered in candidates.problem.similarity.offers.items() for one in offered)


def most_badness(candidates: Candidates, attribute: QualityAttribute) -> dict[str, int]:
    """For each demanded tag the badness up to which a stream is of use for it; tags of no use are left out."""
    if ONLY_IN_THE_MODEL & candidates.problem.features:
        return {}
    if attribute not in candidates.most:
        candidates.most[attribute] = _most_badness(candidates, attribute)
    return candidates.most[attribute]


def _most_badness(candidates: Candidates, attribute: QualityAttribute) -> dict[str, int]:
    """Each round allows one more unit between a stream and what it is of use for; each unit is there once at most.

    In a cycle of units that are better than their inputs, more rounds would allow more and more.
    """
    most: dict[str, int] = {}

    def allow(tag: str, badness: int) -> bool:
        if tag in most and badness <= most[tag]:
            return False
        most[tag] = badness
        return True

    for target in candidates.environment.targets:
        allow(target.tag, candidates.bounds.get((target.label, attribute.name), attribute.scale))
    for label in candidates.asked_for:
        for port in candidates.environment.transformation[label].inputs:
            allow(port.tag, attribute.scale)
    demands = _demands(candidates)
    fed = [
        (demands[output.tag], OutputRule.of(attribute, t, output, candidate.hosts), t.inputs)
        for candidate in candidates.all
        for t in [candidate.transformation]
        for output in t.outputs
        if output.tag in demands and t.inputs
    ]
    meeting = grouped((tag, number) for number, (tags, _, _) in enumerate(fed) for tag in tags)
    ahead = set(most)
    for _ in candidates.all:
        worse: set[str] = set()
        for number in candidates.clock.each(sorted({number for tag in ahead for number in meeting[tag]})):
            tags, making, inputs = fed[number]
            allowed = making.allowed(max(most[tag] for tag in tags if tag in most), attribute.scale)
            for port in inputs:
                if allow(port.tag, attribute.scale if port.feedback else allowed):
                    worse.add(port.tag)
        ahead = worse
        if not ahead:
            break
    return most


def demands_of_quality(candidates: Candidates) -> dict[Demand, bool]:
    """The demands whose streams go into the quality that a target asks for, and whether the choice of consumer matters.

    Usually all consumers of a demand want the same, best stream. They may want different ones if two attributes count,
    or in a cycle of demands with a stream better than its inputs: the best stream may then depend on the consumer's
    own.
    """
    environment, hosts = candidates.environment, tuple(candidates.environment.host)
    asked = sorted({wish.attribute for target in environment.targets for wish in target.quality})
    counting = {name: _where_it_counts(candidates, environment.quality[name]) for name in asked}
    found = {demand: sum(demand in these for these in counting.values()) > 1 for demand in chain(*counting.values())}
    better = {
        name: [label for label, t in candidates.kinds.items() if _may_be_better_than_its_inputs(attribute, t, hosts)]
        for name in asked
        for attribute in [environment.quality[name]]
        if not all(found[demand] for demand in counting[name])
    }
    cycle_of = _rings(candidates) if any(better.values()) else {}
    for name, labels in better.items():
        cycles = {cycle_of.get(label, -1) for label in labels}
        found.update({demand: True for demand in counting[name] if cycle_of.get(demand) in cycles})
    return found


def _where_it_counts(candidates: Candidates, attribute: QualityAttribute) -> set[Demand]:
    """The demands of the targets that ask for an attribute, and of the inputs from which their streams are derived."""

    def made_of(tag: str) -> Iterator[str]:
        for stream in candidates.streams(tag):
            t = candidates.kinds[candidates.label_of(stream)]
            stated = stated_of(t.output[stream.port], attribute, ())
            if stated is None or stated.rule is not QualityRule.SET:
                yield from (port.tag for port in t.inputs if not port.feedback)

    targets = candidates.environment.targets
    asking = (target.tag for target in targets if any(wish.attribute == attribute.name for wish in target.quality))
    return {candidates.streams(tag) for tag in reached(asking, made_of)}


def _may_be_better_than_its_inputs(attribute: QualityAttribute, of: Transformation, hosts: Collection[str]) -> bool:
    """Whether some output may be better than the worst of its inputs, on one of some hosts."""
    is_joined = sum(not port.feedback for port in of.inputs) > 1
    neutral = {QualityRule.ADD: 0, QualityRule.SCALE: MICRO}
    no_better = {Over.WORST, Over.SUM} if attribute.sign > 0 else {Over.WORST}
    return any(
        stated.rule is QualityRule.SET
        or attribute.is_better(stated.value, neutral.get(stated.rule, stated.value))
        or (is_joined and stated.over not in no_better)
        for stated in (stated_of(port, attribute, hosts) for port in of.outputs)
        if stated is not None
    )


def _rings(candidates: Candidates) -> dict[Hashable, int]:
    """The strongly connected component of each demand, and of each transformation by its label."""
    from networkx import DiGraph, strongly_connected_components

    graph: DiGraph[Hashable] = DiGraph()
    inputs = [
        (candidates.streams(p.tag), t.label) for t in candidates.kinds.values() for p in t.inputs if not p.feedback
    ]
    graph.add_edges_from(inputs)
    for demand in {demand for demand, _ in inputs}:
        graph.add_edges_from((candidates.label_of(stream), demand) for stream in demand)
    parts = enumerate(strongly_connected_components(graph))
    return {node: number for number, part in parts for node in part}
