"""The best way to charge landmarks: a linear program, whose dual chooses fractions of transformations."""

from __future__ import annotations

import time
from collections.abc import Sequence
from math import floor

from cfgplan.planners.cpsat.landmarks import Landmark
from cfgplan.planners.cpsat.network import Ints

BUILDING_S = 3e-6
"""What a member of a landmark takes until the engine begins."""


def best_weights(landmarks: Sequence[Landmark], cost: Ints, time_limit_s: float | None) -> list[int]:
    """How much to charge each landmark so that no label is charged more than it costs and the bound is greatest.

    Rounded down, so that it is exact whatever the engine's tolerance; empty if the engine fails or the time is over.
    """
    members = [landmark.counted for landmark in landmarks]
    if not members or (time_limit_s is not None and sum(map(len, members)) * BUILDING_S > time_limit_s):
        return []
    shares = _cheapest_of_alike(members, cost)
    if all(len(charging) == 1 for charging in shares):
        return [int(cost[labels].min()) for labels in members]
    from ortools.linear_solver import pywraplp  # type: ignore[import-untyped]

    began = time.monotonic()
    solver = pywraplp.Solver.CreateSolver("GLOP")
    solver.SuppressOutput()
    unit = float(max(1, cost.max()))
    weights = [solver.NumVar(0.0, float(cost[labels].min()) / unit, "") for labels in members]
    objective = solver.Objective()
    objective.SetMaximization()
    for weight, landmark in zip(weights, landmarks, strict=True):
        objective.SetCoefficient(weight, float(landmark.least))
    for charging, least in shares.items():
        row = solver.RowConstraint(-solver.infinity(), least / unit, "")
        for i in charging:
            row.SetCoefficient(weights[i], 1.0 if landmarks[i].crowd is None else float(charging.count(i)))
    if time_limit_s is not None:
        solver.SetTimeLimit(1 + int(900 * max(0.0, time_limit_s - (time.monotonic() - began))))
    if solver.Solve() != pywraplp.Solver.OPTIMAL:
        return []
    return [max(0, floor(weight.solution_value() * unit)) for weight in weights]


def _cheapest_of_alike(members: list[Ints], cost: Ints) -> dict[tuple[int, ...], int]:
    """Which landmarks charge a label, each as often as it counts; the least cost of the labels charged just so."""
    charging: dict[int, list[int]] = {}
    for i, labels in enumerate(members):
        for label in labels.tolist():
            charging.setdefault(label, []).append(i)
    least: dict[tuple[int, ...], int] = {}
    for label, landmarks in charging.items():
        alike = tuple(landmarks)
        least[alike] = min(least.get(alike, int(cost[label])), int(cost[label]))
    return least
