"""Other planners, for comparison only: solvers, which need the extra `peers`, and a corrected version of the paper's
search.

Each models the whole problem: groundedness, sharing, and the savings of reuse. Unsupported features raise InputError.
clingo, HiGHS and SCIP support fleets and deployments in which nothing runs yet.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from cfgplan.comparing import Entrant

SHARING = Entrant("branch-and-bound-shared", "experiments.peers.sharing:plan")
"""The paper's search, if it counted what is shared once."""
LED = ("clingo-usc-led", "highs-led", "scip-led")
"""Those of the peers that begin with what `cpsat` knows before it calls its solver."""
PEERS: Mapping[str, Entrant] = MappingProxyType(
    {
        entrant.name: entrant
        for entrant in (
            Entrant("clingo-usc", "experiments.peers.asp:plan_by_cores", ("clingo",)),
            Entrant("clingo-bb", "experiments.peers.asp:plan_by_branching", ("clingo",)),
            Entrant("highs", "experiments.peers.milp:plan", ("highspy", "numpy")),
            Entrant("scip", "experiments.peers.scip:plan", ("pyscipopt",)),
            Entrant("rc2", "experiments.peers.maxsat:plan", ("pysat",)),
            Entrant("rc2-stratified", "experiments.peers.maxsat:plan_stratified", ("pysat",)),
            Entrant("fast-downward", "experiments.peers.downward:plan"),
            Entrant("clingo-usc-led", "experiments.peers.asp:plan_by_cores_led", ("clingo",)),
            Entrant("highs-led", "experiments.peers.milp:plan_led", ("highspy", "numpy")),
            Entrant("scip-led", "experiments.peers.scip:plan_led", ("pyscipopt",)),
        )
    }
)
