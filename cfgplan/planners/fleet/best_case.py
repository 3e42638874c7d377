"""How good streams can be at best, and how bad they may be at worst, attribute by attribute.

At best all that can run runs. What would miss every bound even then is of no use anywhere.
"""

from __future__ import annotations

from cfgplan.domain import InputPort, OutputPort, Stream
from cfgplan.planners.fleet.candidates import Candidate, Candidates
from cfgplan.qualities import Better, Over, QualityAttribute, Rule, price_us, propagated


def leave_out_what_is_too_bad(candidates: Candidates) -> None:
    """Streams that no plan can take where a tag is demanded, since they would miss the bounds of all targets."""
    bounded = {w.attribute for t in candidates.environment.targets for w in t.quality if w.bound is not None}
    for name in sorted(bounded):
        attribute = candidates.environment.quality[name]
        best = best_values(candidates, attribute)
        allowed = _allowed(candidates, attribute)
        candidates.leave_out(
            {
                (tag, stream)
                for tag, worst in allowed.items()
                for stream in candidates.streams(tag)
                if stream not in best or attribute.is_better(worst, best[stream])
            }
        )


def least_price_us(candidates: Candidates) -> int:
    """What targets charge for quality at least, whatever the plan."""
    total_us = 0
    for attribute in candidates.environment.qualities:
        asked = [(t, w) for t in candidates.environment.targets for w in t.quality if w.attribute == attribute.name]
        best = best_values(candidates, attribute) if any(wish.weight_us for _, wish in asked) else {}
        for target, wish in asked:
            values = [best[stream] for stream in candidates.streams(target.tag) if stream in best]
            total_us += min((price_us(attribute, wish, value) for value in values), default=0)
    return total_us


def best_values(candidates: Candidates, attribute: QualityAttribute) -> dict[Stream, int]:
    """No wiring gives a stream a better value. Streams that nothing can feed are left out.

    Round by round for one more unit in a row; no row is longer than there are units.
    """
    best: dict[Stream, int] = {}
    for _ in candidates.all:
        before = dict(best)
        for candidate in candidates.all:
            ordinary = [port for port in candidate.transformation.inputs if not port.feedback]
            inputs = [_best_at(candidates, attribute, port, best) for port in ordinary]
            fed = [value for value in inputs if value is not None]
            if len(fed) < len(inputs) or not candidate.may_run:
                continue
            for port in candidate.transformation.outputs:
                value = propagated(attribute, {c.attribute: c for c in port.quality}.get(attribute.name), fed)
                stream = Stream(candidate.id, port.name)
                if stream not in best or attribute.is_better(value, best[stream]):
                    best[stream] = value
        if before == best:
            break
    return best


def _best_at(
    candidates: Candidates, attribute: QualityAttribute, port: InputPort, best: dict[Stream, int]
) -> int | None:
    values = [best[stream] for stream in candidates.streams(port.tag) if stream in best]
    if not values:
        return None
    return min(values) if attribute.better is Better.LOWER else max(values)


def _allowed(candidates: Candidates, attribute: QualityAttribute) -> dict[str, int]:
    """For each demanded tag the worst value that anybody who demands it may take, if it is of use at all."""
    allowed: dict[str, int] = {}

    def allow(tag: str, value: int) -> bool:
        if tag in allowed and not attribute.is_better(allowed[tag], value):
            return False
        allowed[tag] = value
        return True

    for target in candidates.environment.targets:
        bounds = [w.bound for w in target.quality if w.attribute == attribute.name and w.bound is not None]
        allow(target.tag, bounds[0] if bounds else attribute.worst)
    asked = [i for i, c in enumerate(candidates.all) if candidates.is_pinned(i) or c.transformation.min_instances]
    for i in asked:
        for port in candidates.all[i].transformation.inputs:
            allow(port.tag, attribute.worst)
    grew = True
    while grew:
        grew = False
        for candidate in candidates.all:
            for output in candidate.transformation.outputs:
                out = _allowed_at(candidates, output, attribute, allowed)
                if out is None:
                    continue
                for port in candidate.transformation.inputs:
                    value = attribute.worst if port.feedback else _allowed_before(attribute, candidate, output, out)
                    grew |= allow(port.tag, value)
    return allowed


def _allowed_at(
    candidates: Candidates, output: OutputPort, attribute: QualityAttribute, allowed: dict[str, int]
) -> int | None:
    """The worst value of an output that is of use; None if it is of none."""
    values = [value for tag, value in allowed.items() if candidates.problem.similarity.holds(output.tag, tag)]
    if not values:
        return None
    return max(values) if attribute.better is Better.LOWER else min(values)


def _allowed_before(attribute: QualityAttribute, candidate: Candidate, output: OutputPort, out: int) -> int:
    """The worst value of an input with which an output is still good enough, as far as the rule says that."""
    stated = {c.attribute: c for c in output.quality}.get(attribute.name)
    if stated is None:
        return out
    ordinary = sum(not port.feedback for port in candidate.transformation.inputs)
    if out == attribute.worst or (stated.over is not Over.WORST and ordinary > 1):
        return attribute.worst
    match stated.rule:
        case Rule.ADD:
            low, high = sorted((attribute.worst, attribute.best))
            return min(max(out - stated.value, low), high)
        case Rule.LIMIT:
            return out
        case Rule.SCALE | Rule.SET:
            return attribute.worst
