"""Single failures in the constraint model: for each, which units could still be fed by what is left.

Running all that is left hurts nothing, so what could be fed is a closure; the model may claim less of it,
never more. Tags decide, so units of one transformation feed alike.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable

from ortools.sat.python.cp_model import IntVar

from cfgplan.domain import InputPort, Target
from cfgplan.planners.fleet.model import Model
from cfgplan.planning import Failures
from cfgplan.reasons import distinct_groups


def every_failure_leaves_a_stream_for_every_target(model: Model) -> None:
    targets = model.environment.targets
    if model.problem.survive is None or not targets:
        return
    for unit, runs in model.runs.items():
        _survives(model, targets, lost={unit: model.true}, only_if=runs)
    if model.problem.survive is Failures.HOSTS:
        for host in model.environment.hosts:
            lost = {i: on[host.name] for i, on in model.is_on.items() if host.name in on}
            _survives(model, [t for t in targets if t.host != host.name], lost, only_if=model.true)


def _survives(model: Model, targets: Iterable[Target], lost: dict[int, IntVar], only_if: IntVar) -> None:
    """If `only_if`, every target could be met by units that are there and not lost."""
    candidates = model.candidates
    kinds = sorted({c.transformation.label for c in candidates.all})
    left = {label: model.boolean() for label in kinds}
    units: dict[str, list[IntVar]] = defaultdict(list)
    for i, candidate in enumerate(candidates.all):
        remains = model.is_there[i]
        if i in lost:
            remains = model.boolean()
            model.cp.add_implication(remains, model.is_there[i])
            model.cp.add_implication(remains, lost[i].negated())
        units[candidate.transformation.label].append(remains)
    level = {label: model.cp.new_int_var(0, len(kinds), "") for label in kinds}
    library = model.environment.transformation
    for label in kinds:
        model.needs_any(left[label], units[label])
        for port in library[label].inputs:
            _is_fed(model, label, port, left, level)
        for group in distinct_groups(library[label]):
            _is_fed_by_different_ones(model, label, group, left, level)
    for target in targets:
        model.needs_any(only_if, [left[label] for label in candidates.givers.of(target.tag) if label in left])


def _is_fed(
    model: Model, label: str, port: InputPort, left: dict[str, IntVar], level: dict[str, IntVar]
) -> dict[str, IntVar]:
    choices: dict[str, IntVar] = {}
    for feeder in model.candidates.givers.of(port.tag):
        if feeder in left and (feeder != label or port.feedback):
            choices[feeder] = model.boolean()
            model.cp.add_implication(choices[feeder], left[feeder])
            if not port.feedback:
                model.cp.add(level[label] > level[feeder]).only_enforce_if(choices[feeder])
    model.needs_any(left[label], list(choices.values()))
    return choices


def _is_fed_by_different_ones(
    model: Model, label: str, group: list[InputPort], left: dict[str, IntVar], level: dict[str, IntVar]
) -> None:
    by_feeder: dict[str, list[IntVar]] = defaultdict(list)
    for port in group:
        choices = _is_fed(model, label, port, left, level)
        model.cp.add_at_most_one(choices.values())
        for feeder, chosen in choices.items():
            by_feeder[feeder].append(chosen)
    for chosen_ones in by_feeder.values():
        model.cp.add_at_most_one(chosen_ones)
