"""Transformations alike: they meet the same demands, so that a cheapest plan has at most one of them.

If a plan had two, the later one in a grounded order could go: all that it gives is given by the earlier one. So the
later one must cost something, and nobody may want two different ones.
"""

from __future__ import annotations

import numpy as np

from cfgplan.planners.networks.core import Ints
from cfgplan.planners.networks.network import Graph


def alike(network: Graph, cost: Ints) -> Ints:
    """A number for each label, equal for those of which a cheapest plan has at most one."""
    distinct = {network.fact_of_tag[p.tag] for t in network.transformations for p in t.inputs if p.distinct is not None}
    gives = network.core.gives
    first: dict[bytes, int] = {}
    kinds = np.arange(len(cost))
    for label in np.flatnonzero(cost).tolist():
        facts = gives[label]
        if distinct.isdisjoint(facts.tolist()):
            kinds[label] = first.setdefault(facts.tobytes(), label)
    return kinds
