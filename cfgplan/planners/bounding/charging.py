"""The best way to charge landmarks: a linear program, whose dual chooses fractions of transformations."""

from __future__ import annotations

from collections.abc import Sequence
from math import floor

import numpy as np

from cfgplan.planners.bounding.landmarks import Landmark
from cfgplan.planners.networks.core import Ints
from cfgplan.planners.solving.clock import Clock


def best_weights(landmarks: Sequence[Landmark], cost: Ints, clock: Clock) -> list[int]:
    """How much to charge each landmark so that the bound is greatest.

    No label is charged more than it costs, except that landmarks that demand several members may charge labels more:
    that is not gained (`spread`). Rounded down; empty if the engine fails or the time is over.
    """
    members = [landmark.counted for landmark in landmarks]
    if not members or not clock.has_steps(clock.tuning.rise.building * sum(map(len, members))):
        return []
    several = {i for i, landmark in enumerate(landmarks) if landmark.least > 1}
    shares = _cheapest_of_alike(members, cost, several)
    if not several and all(len(charging) == 1 for charging, _ in shares):
        return [int(cost[labels].min()) for labels in members]
    from ortools.linear_solver import pywraplp  # type: ignore[import-untyped]

    solver = pywraplp.Solver.CreateSolver("GLOP")
    solver.SuppressOutput()
    unit = float(max(1, cost.max()))
    most = [int(cost[labels].max() if i in several else cost[labels].min()) for i, labels in enumerate(members)]
    weights = [solver.NumVar(0.0, each / unit, "") for each in most]
    objective = solver.Objective()
    objective.SetMaximization()
    for weight, landmark in zip(weights, landmarks, strict=True):
        objective.SetCoefficient(weight, float(landmark.least))
    for charging, least in shares:
        if clock.is_over():
            return []
        row = solver.RowConstraint(-solver.infinity(), least / unit, "")
        for i in charging:
            row.SetCoefficient(weights[i], 1.0 if landmarks[i].crowd is None else float(charging.count(i)))
        if not several.isdisjoint(charging):
            too_much = solver.NumVar(0.0, solver.infinity(), "")
            row.SetCoefficient(too_much, -1.0)
            objective.SetCoefficient(too_much, -1.0)
    left_s = clock.left_s()
    if left_s is not None:
        solver.SetTimeLimit(1 + int(900 * left_s))
    if solver.Solve() != pywraplp.Solver.OPTIMAL:
        return []
    return [max(0, floor(weight.solution_value() * unit)) for weight in weights]


def spread(landmarks: Sequence[Landmark], weights: Sequence[int], cost: Ints) -> tuple[list[Landmark], list[int]]:
    """The landmarks and more of them, charged so that labels are not charged more than they cost.

    A label that is counts as there in a part of the landmarks that demand several members.
    """
    landmarks, weights = list(landmarks), list(weights)
    charged = np.zeros_like(cost)
    for landmark, weight in zip(landmarks, weights, strict=True):
        np.add.at(charged, landmark.counted, weight)
    number = {landmark.key: i for i, landmark in enumerate(landmarks) if landmark.crowd is not None}
    for label in np.flatnonzero(charged > cost).tolist():
        too_much = int(charged[label] - cost[label])
        for i in [i for i, one in enumerate(landmarks) if one.least > 1 and weights[i] and label in one.members]:
            other = landmarks[i].sparing(label)
            count = int((landmarks[i].counted == label).sum())
            moved = min(weights[i], -(-too_much // count))
            if other is not None and moved > 0:
                weights[i] -= moved
                too_much -= moved * count
                if number.setdefault(other.key, len(landmarks)) == len(landmarks):
                    landmarks.append(other)
                    weights.append(0)
                weights[number[other.key]] += moved
    return landmarks, weights


def _cheapest_of_alike(members: list[Ints], cost: Ints, several: set[int]) -> list[tuple[tuple[int, ...], int]]:
    """Which landmarks charge a label, each as often as it counts, and the least cost of the labels charged just so.

    Labels that landmarks charge that demand several members are not put together.
    """
    charging: dict[int, list[int]] = {}
    for i, labels in enumerate(members):
        for label in labels.tolist():
            charging.setdefault(label, []).append(i)
    least: dict[tuple[int, ...], int] = {}
    apart: list[tuple[tuple[int, ...], int]] = []
    for label, landmarks in charging.items():
        alike = tuple(landmarks)
        if several and not several.isdisjoint(alike):
            apart.append((alike, int(cost[label])))
        else:
            least[alike] = min(least.get(alike, int(cost[label])), int(cost[label]))
    return [*least.items(), *apart]
