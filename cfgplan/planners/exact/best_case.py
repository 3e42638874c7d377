"""How good streams can be at best, and how bad they may be at worst, attribute by attribute.

The best values assume that all that can run runs. A stream that misses every bound even then is of no use anywhere.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Hashable, Mapping
from itertools import chain

from cfgplan.domain import OutputPort, Stream, Transformation
from cfgplan.planners.exact.candidates import Candidate, Candidates
from cfgplan.qualities import MICRO, Better, Contribution, Over, QualityAttribute, QualityRule, price_us, propagated

Demand = tuple[Stream, ...]
"""What inputs or a target ask for: the streams that would do."""


def leave_out_what_is_too_bad(candidates: Candidates) -> None:
    """Leave out, where a tag is demanded, the streams that would miss the bounds of all targets."""
    for name in sorted({attribute for _, attribute in candidates.bounds}):
        attribute = candidates.environment.quality[name]
        best = best_values(candidates, attribute)
        allowed = worst_of_use(candidates, attribute)
        candidates.leave_out(
            {
                (tag, stream)
                for tag, worst in allowed.items()
                for stream in candidates.streams(tag)
                if stream not in best or attribute.is_better(worst, best[stream])
            }
        )


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
        best = best_values(candidates, attribute) if weighed else {}
        for target, wish in weighed:
            values = [best[stream] for stream in candidates.streams(target.tag) if stream in best]
            found = min((price_us(attribute, wish, value) for value in values), default=0)
            prices[target.label, attribute.name] = found
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


def bound_by_price(candidates: Candidates, most_us: int) -> None:
    """Turn weights of targets into bounds on quality: all prices together are at most `most_us`."""
    least = least_prices_us(candidates)
    for target in candidates.environment.targets:
        for wish in target.quality:
            place = target.label, wish.attribute
            if place not in least:
                continue
            attribute = candidates.environment.quality[wish.attribute]
            missed_by = (most_us - sum(least.values()) + least[place]) * MICRO // wish.weight_us
            is_low = attribute.better is Better.LOWER
            value = attribute.best + missed_by if is_low else attribute.best - missed_by
            low, high = sorted((attribute.best, attribute.worst))
            known = candidates.bounds.get(place, attribute.worst)
            candidates.bounds[place] = min(known, max(value, low)) if is_low else max(known, min(value, high))
    leave_out_what_is_too_bad(candidates)


def best_values(candidates: Candidates, attribute: QualityAttribute) -> dict[Stream, int]:
    """For each stream a value that no wiring betters. Streams that nothing can feed are left out."""
    if attribute not in candidates.best:
        candidates.best[attribute] = _best_values(candidates, attribute)
    return candidates.best[attribute]


def _best_values(candidates: Candidates, attribute: QualityAttribute) -> dict[Stream, int]:
    """Each round allows chains of one more unit; no chain is longer than there are units, none feeds itself at once."""
    best: dict[Stream, int] = {}
    at: dict[str, int] = {}
    demands = _demands(candidates)
    ordinary = [[port.tag for port in c.transformation.inputs if not port.feedback] for c in candidates.all]
    needing: dict[str, list[int]] = defaultdict(list)
    for i, tags in enumerate(ordinary):
        for tag in set(tags):
            needing[tag].append(i)
    ahead = [i for i, candidate in enumerate(candidates.all) if candidate.may_run]
    for _ in candidates.all:
        better: set[str] = set()
        for i in candidates.clock.each(ahead):
            candidate = candidates.all[i]
            own = {tag for port in candidate.transformation.outputs for tag in demands.get(port.tag, ())}
            known = [
                _best_of_others(candidates, i, tag, attribute, best) if tag in own else at.get(tag)
                for tag in ordinary[i]
            ]
            fed = [value for value in known if value is not None]
            if len(fed) < len(ordinary[i]) or not candidate.may_run:
                continue
            for port in candidate.transformation.outputs:
                value = propagated(attribute, {c.attribute: c for c in port.quality}.get(attribute.name), fed)
                stream = Stream(candidate.id, port.name)
                if stream not in best or attribute.is_better(value, best[stream]):
                    best[stream] = value
                    for tag in demands.get(port.tag, ()):
                        if tag not in at or attribute.is_better(value, at[tag]):
                            at[tag] = value
                            better.add(tag)
        ahead = sorted({i for tag in better for i in needing[tag]})
        if not ahead:
            break
    return best


def _best_of_others(
    candidates: Candidates, unit: int, tag: str, attribute: QualityAttribute, best: Mapping[Stream, int]
) -> int | None:
    """The best value known of a stream that meets a demand and is not the unit's own."""
    id_, pick = candidates.all[unit].id, min if attribute.better is Better.LOWER else max
    return pick((best[s] for s in candidates.streams(tag) if s in best and s.unit != id_), default=None)


def _demands(candidates: Candidates) -> dict[str, list[str]]:
    """For each offered tag the demanded ones that it meets."""
    demands: dict[str, list[str]] = defaultdict(list)
    for tag, offered in candidates.problem.similarity.offers.items():
        for one in offered:
            demands[one].append(tag)
    return demands


def worst_of_use(candidates: Candidates, attribute: QualityAttribute) -> dict[str, int]:
    """For each demanded tag the worst value that is of use to anybody who demands it; tags of no use are left out."""
    key = attribute, *sorted(candidates.bounds.items())
    if key not in candidates.allowed:
        candidates.allowed[key] = _worst_of_use(candidates, attribute)
    return candidates.allowed[key]


def _worst_of_use(candidates: Candidates, attribute: QualityAttribute) -> dict[str, int]:
    allowed: dict[str, int] = {}

    def allow(tag: str, value: int) -> bool:
        if tag in allowed and not attribute.is_better(allowed[tag], value):
            return False
        allowed[tag] = value
        return True

    for target in candidates.environment.targets:
        allow(target.tag, candidates.bounds.get((target.label, attribute.name), attribute.worst))
    asked = [i for i in range(len(candidates.all)) if candidates.is_asked_for(i)]
    for i in asked:
        for port in candidates.all[i].transformation.inputs:
            allow(port.tag, attribute.worst)
    demands = _demands(candidates)
    worst_of = max if attribute.better is Better.LOWER else min
    fed = [
        (demands[output.tag], {c.attribute: c for c in output.quality}.get(attribute.name), candidate)
        for candidate in candidates.all
        for output in candidate.transformation.outputs
        if output.tag in demands and candidate.transformation.inputs
    ]
    meeting: dict[str, list[int]] = defaultdict(list)
    for number, (tags, _, _) in enumerate(fed):
        for tag in tags:
            meeting[tag].append(number)
    ahead = set(allowed)
    while ahead:
        worse: set[str] = set()
        for number in candidates.clock.each(sorted({number for tag in ahead for number in meeting[tag]})):
            tags, stated, candidate = fed[number]
            wanted = worst_of([allowed[tag] for tag in tags if tag in allowed])
            ordinary = _allowed_before(attribute, candidate, stated, wanted)
            for port in candidate.transformation.inputs:
                if allow(port.tag, attribute.worst if port.feedback else ordinary):
                    worse.add(port.tag)
        ahead = worse
    return allowed


def _allowed_before(attribute: QualityAttribute, candidate: Candidate, stated: Contribution | None, out: int) -> int:
    """The worst input value with which an output is no worse than `out`, as far as the rule says that."""
    if stated is None:
        return out
    ordinary = sum(not port.feedback for port in candidate.transformation.inputs)
    if out == attribute.worst or (stated.over is not Over.WORST and ordinary > 1):
        return attribute.worst
    match stated.rule:
        case QualityRule.ADD:
            low, high = sorted((attribute.worst, attribute.best))
            return min(max(out - stated.value, low), high)
        case QualityRule.LIMIT:
            return out
        case QualityRule.SCALE | QualityRule.SET:
            return attribute.worst


def demands_of_quality(candidates: Candidates) -> dict[Demand, bool]:
    """The demands whose stream is a part of what some target asks for, and whether it matters who has the demand.

    Mostly all who have a demand want the same stream, the best. Not so where two attributes count; nor in a ring of
    demands with a stream that is better than its inputs: the best one may be made of what one who wants it makes.
    """
    environment = candidates.environment
    asked = sorted({wish.attribute for target in environment.targets for wish in target.quality})
    counting = {name: _where_it_counts(candidates, environment.quality[name]) for name in asked}
    found = {demand: sum(demand in these for these in counting.values()) > 1 for demand in chain(*counting.values())}
    better = [
        (name, t.label, port)
        for name in asked
        if not all(found[demand] for demand in counting[name])
        for t in _transformations(candidates)
        for port in t.outputs
        if not _is_no_better_than_its_inputs(environment.quality[name], t, port)
    ]
    ring_of = _rings(candidates) if better else {}
    for name, label, port in better:
        ring = ring_of[label, port.name]
        found.update({demand: True for demand in counting[name] if ring_of.get(demand) == ring})
    return found


def _transformations(candidates: Candidates) -> list[Transformation]:
    return list({c.transformation.label: c.transformation for c in candidates.all}.values())


def _where_it_counts(candidates: Candidates, attribute: QualityAttribute) -> set[Demand]:
    """The demands of targets that ask for an attribute, and of inputs of which such streams are made."""
    ahead = [
        target.tag
        for target in candidates.environment.targets
        if any(wish.attribute == attribute.name for wish in target.quality)
    ]
    seen = set(ahead)
    for tag in ahead:
        for stream in candidates.streams(tag):
            t = candidates.all[candidates.index_of[stream.unit]].transformation
            stated = {c.attribute: c for c in t.output[stream.port].quality}.get(attribute.name)
            if stated is None or stated.rule is not QualityRule.SET:
                new = {port.tag for port in t.inputs if not port.feedback} - seen
                seen |= new
                ahead += sorted(new)
    return {candidates.streams(tag) for tag in ahead}


def _is_no_better_than_its_inputs(attribute: QualityAttribute, of: Transformation, port: OutputPort) -> bool:
    stated = {c.attribute: c for c in port.quality}.get(attribute.name)
    if stated is None:
        return True
    is_low = attribute.better is Better.LOWER
    if sum(not port.feedback for port in of.inputs) > 1 and not (
        stated.over is Over.WORST or (stated.over is Over.SUM and is_low)
    ):
        return False
    match stated.rule:
        case QualityRule.LIMIT:
            return True
        case QualityRule.SET:
            return False
        case QualityRule.ADD:
            return stated.value >= 0 if is_low else stated.value <= 0
        case QualityRule.SCALE:
            return stated.value >= MICRO if is_low else stated.value <= MICRO


def _rings(candidates: Candidates) -> dict[Hashable, int]:
    """The strongly connected component of each demand, and of each output, by label and port."""
    from networkx import DiGraph, strongly_connected_components

    graph: DiGraph[Hashable] = DiGraph()
    demands: set[Demand] = set()
    for t in _transformations(candidates):
        inputs = {candidates.streams(port.tag) for port in t.inputs if not port.feedback}
        demands |= inputs
        graph.add_nodes_from((t.label, port.name) for port in t.outputs)
        graph.add_edges_from((one, (t.label, port.name)) for one in inputs for port in t.outputs)
    for one in demands:
        graph.add_edges_from(((candidates.label_of(stream), stream.port), one) for stream in one)
    parts = enumerate(strongly_connected_components(graph))
    return {node: number for number, part in parts for node in part}
