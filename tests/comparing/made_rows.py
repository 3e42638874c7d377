"""Rows of runs that never were."""

from __future__ import annotations

from cfgplan.planning import Status
from experiments.study.rows import Row


def row(planner: str, cost_us: int | None, proof_s: float | None = None, **more: object) -> Row:
    """A run on one instance; proven with the cost as bound if there is a time of proof."""
    values: dict[str, object] = {
        "instance": "it",
        "family": "own",
        "parameters": {"size": 3},
        "seed": 0,
        "digest": "d",
        "transformations": 1,
        "planner": planner,
        "time_limit_s": 5.0,
        "memory_mb": None,
        "outcome": Status.UNKNOWN if cost_us is None else Status.FEASIBLE if proof_s is None else Status.OPTIMAL,
        "cost_us": cost_us,
        "bound_us": 0 if proof_s is None else cost_us,
        "unused_required": 0,
        "first_s": None,
        "best_s": None,
        "proof_s": proof_s,
        "total_s": 5.0 if proof_s is None else proof_s,
        "trace": (),
        "counts": {},
        "peak_mb": 10.0,
        "violations": (),
        "message": "",
        "versions": {},
        "machine": {},
    }
    return Row(**{**values, **more})  # type: ignore[arg-type]
