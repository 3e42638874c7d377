"""Other solvers as planners, for comparison only; they need the extra `peers`.

Each encodes the whole problem: grounded, shared, with what reuse saves. What one does not know it refuses.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from cfgplan.comparing import Entrant

PEERS: Mapping[str, Entrant] = MappingProxyType(
    {
        entrant.name: entrant
        for entrant in (
            Entrant("clingo-usc", "experiments.peers.asp:plan_by_cores", ("clingo",), ("clingo",)),
            Entrant("clingo-bb", "experiments.peers.asp:plan_by_branching", ("clingo",), ("clingo",)),
            Entrant("highs", "experiments.peers.milp:plan", ("highspy", "numpy"), ("highspy",)),
            Entrant("fast-downward", "experiments.peers.downward:plan", (), ("up-fast-downward",)),
        )
    }
)
