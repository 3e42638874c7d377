"""Groundedness without lazy cuts: integer levels inside the strongly connected components of the support graph.

It is several times slower than lazy cuts on large instances.
"""

from __future__ import annotations

import networkx as nx
from ortools.sat.python.cp_model import IntVar

from cfgplan.planners.exact.model import Model


def everything_rests_on_something_lower(model: Model) -> None:
    """Give each proposition a level.

    A proposition that needs any one of others needs one on a lower level; a proposition that needs all of others is on
    no lower level than they are. Every cycle has a proposition of the first kind, so that no cycle supports itself.
    """
    support = model.support
    graph = nx.DiGraph()
    for links in (support.any_of, support.all_of):
        graph.add_edges_from((head, below) for head, choices in links.items() for below in choices)
    for part in nx.strongly_connected_components(graph):
        if len(part) > 1:
            _add_levels(model, sorted(part))


def _add_levels(model: Model, part: list[int]) -> None:
    support = model.support
    literals = {literal.index: literal for literal in model.literals}
    inside = set(part)
    level = {p: model.cp.new_int_var(0, len(part), "") for p in part}
    for p in part:
        for below in support.all_of.get(p, ()):
            if below in inside:
                model.cp.add(level[p] >= level[below]).only_enforce_if(literals[p])
        choices: list[IntVar] = []
        for below in support.any_of.get(p, ()):
            if below in inside:
                rests = model.boolean()
                model.cp.add_implication(rests, literals[below])
                model.cp.add(level[p] > level[below]).only_enforce_if(rests)
                choices.append(rests)
            else:
                choices.append(literals[below])
        if p in support.any_of:
            model.needs_any(literals[p], choices)
