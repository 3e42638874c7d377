"""Which units may be there together, and how many, in the constraint model."""

from __future__ import annotations

from collections import defaultdict

from ortools.sat.python.cp_model import IntVar, LinearExpr

from cfgplan.planners.fleet.model import Model


def units_that_conflict_are_not_there_together(model: Model) -> None:
    there = _there(model)
    for transformation in model.environment.library:
        for other in transformation.conflicts:
            if other != transformation.label:
                for one in there.get(transformation.label, ()):
                    for second in there.get(other, ()):
                        model.cp.add_at_most_one(one, second)


def there_are_as_many_units_as_asked_for_and_allowed(model: Model) -> None:
    there = _there(model)
    running: dict[str, list[IntVar]] = defaultdict(list)
    for i, runs in model.runs.items():
        running[model.candidates.all[i].transformation.label].append(runs)
    for t in model.environment.library:
        if t.min_instances:
            model.cp.add(LinearExpr.sum(running[t.label]) >= t.min_instances)
        if t.max_instances is not None:
            model.cp.add(LinearExpr.sum(there[t.label]) <= t.max_instances)


def _there(model: Model) -> dict[str, list[IntVar]]:
    there: dict[str, list[IntVar]] = defaultdict(list)
    for i, is_there in model.is_there.items():
        there[model.candidates.all[i].transformation.label].append(is_there)
    return there
