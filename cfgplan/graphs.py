"""The computation graph of an environment (section III-A) as a networkx graph, for analysis and drawing by others."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cfgplan.domain import Environment

if TYPE_CHECKING:
    from networkx import MultiDiGraph


def computation_graph(environment: Environment) -> MultiDiGraph[str]:
    """Units as nodes (attribute `transformation`) and subscriptions as edges from the unit that feeds.

    An edge's key is the input port; its attributes are `stream` and whether it is `feedback`. A feeder that is
    gone is a node without attributes.
    """
    from networkx import MultiDiGraph

    graph: MultiDiGraph[str] = MultiDiGraph()
    for unit in environment.units:
        graph.add_node(unit.id, transformation=unit.transformation)
    for unit in environment.units:
        transformation = environment.transformation.get(unit.transformation)
        for name, stream in unit.feeds.items():
            port = transformation.input.get(name) if transformation else None
            is_feedback = port is not None and port.feedback
            graph.add_edge(stream.unit, unit.id, key=name, stream=str(stream), feedback=is_feedback)
    return graph
