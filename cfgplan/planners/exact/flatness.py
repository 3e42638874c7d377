"""Whether the cost of a configuration depends on what is where alone, and not on who feeds whom."""

from __future__ import annotations

from cfgplan.domain import OutputPort, Transformation
from cfgplan.planners.exact.candidates import Candidates
from cfgplan.planning import Notion
from cfgplan.qualities import MICRO, Better, Over, QualityAttribute, QualityRule
from cfgplan.reasons import distinct_groups


def is_one_stream_best_for_all(candidates: Candidates) -> bool:
    """Whether one stream can meet a demand for all who have it.

    With one attribute all want the best stream. Where no stream in a ring of demands is better than its inputs, the
    best one is there before all that is made of it.
    """
    problem = candidates.problem
    asked = {wish.attribute for target in problem.environment.targets for wish in target.quality}
    transformations = {c.transformation.label: c.transformation for c in candidates.all}.values()
    if (
        Notion.SURVIVAL in problem.notions
        or len(asked) > 1
        or any(t.required or distinct_groups(t) or any(p.feedback for p in t.inputs) for t in transformations)
    ):
        return False
    better = [
        (t, port)
        for name in asked
        for t in transformations
        for port in t.outputs
        if t.inputs and not _is_no_better_than_its_inputs(problem.environment.quality[name], t, port)
    ]
    ring_of = _rings(candidates) if better else {}
    return not any(ring_of[port.tag] == ring_of[one.tag] for t, port in better for one in t.inputs)


def _is_no_better_than_its_inputs(attribute: QualityAttribute, of: Transformation, port: OutputPort) -> bool:
    stated = {c.attribute: c for c in port.quality}.get(attribute.name)
    if stated is None:
        return True
    is_low = attribute.better is Better.LOWER
    if len(of.inputs) > 1 and not (stated.over is Over.WORST or (stated.over is Over.SUM and is_low)):
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


def _rings(candidates: Candidates) -> dict[str, int]:
    """The strongly connected component of each tag; an offered tag depends on the tags demanded to make it."""
    from networkx import DiGraph, strongly_connected_components

    graph: DiGraph[str] = DiGraph()
    graph.add_nodes_from(port.tag for candidate in candidates.all for port in candidate.transformation.outputs)
    library = candidates.environment.transformation
    for t in {candidate.transformation.label for candidate in candidates.all}:
        for one in library[t].inputs:
            graph.add_edges_from((one.tag, port.tag) for port in library[t].outputs)
    demanded = {one.tag for candidate in candidates.all for one in candidate.transformation.inputs}
    for tag in demanded:
        graph.add_edges_from((offered, tag) for offered in candidates.problem.similarity.offers.get(tag, ()))
    parts = enumerate(strongly_connected_components(graph))
    return {tag: number for number, part in parts for tag in part}
