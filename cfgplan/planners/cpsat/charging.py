"""The best way to charge landmarks: a linear program, whose dual chooses fractions of transformations."""

from __future__ import annotations

from math import floor

from ortools.linear_solver import pywraplp  # type: ignore[import-untyped]

from cfgplan.planners.cpsat.network import Ints


def best_weights(members: list[Ints], cost: Ints, time_limit_s: float | None) -> list[int]:
    """How much to charge each landmark so that no label is charged more than it costs and the sum is greatest.

    Rounded down, so that it is exact whatever the engine's tolerance; empty if the engine fails or the time is over.
    """
    if not members:
        return []
    solver = pywraplp.Solver.CreateSolver("GLOP")
    solver.SuppressOutput()
    if time_limit_s is not None:
        solver.SetTimeLimit(1 + int(1000 * time_limit_s))
    unit = float(max(1, cost.max()))
    weights = [solver.NumVar(0.0, float(cost[labels].min()) / unit, "") for labels in members]
    rows: dict[int, pywraplp.Constraint] = {}
    objective = solver.Objective()
    objective.SetMaximization()
    for weight, labels in zip(weights, members, strict=True):
        objective.SetCoefficient(weight, 1.0)
        for label in labels.tolist():
            if label not in rows:
                rows[label] = solver.RowConstraint(-solver.infinity(), float(cost[label]) / unit, "")
            rows[label].SetCoefficient(weight, 1.0)
    if solver.Solve() != pywraplp.Solver.OPTIMAL:
        return []
    return [max(0, floor(weight.solution_value() * unit)) for weight in weights]
