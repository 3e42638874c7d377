"""Why no configuration meets all that is asked, where every target alone could have a stream."""

from __future__ import annotations

from cfgplan.domain import Target
from cfgplan.planning import Problem
from cfgplan.qualities import Better, is_met, propagated, units


def joint_reasons(problem: Problem) -> dict[str, str]:
    """A reason for each target whose bounds no wiring can meet; else one for all targets together."""
    unreachable = {
        target.label: reason
        for target in problem.environment.targets
        for reason in [_missed_bound(problem, target)]
        if reason
    }
    asked = ", ".join(sorted(problem.notions))
    joint = f"no configuration meets all that is asked together ({asked})"
    return unreachable or {target.label: joint for target in problem.environment.targets}


def _missed_bound(problem: Problem, target: Target) -> str | None:
    for wish in target.quality:
        attribute = problem.environment.quality[wish.attribute]
        best = _best_values(problem, wish.attribute)
        values = [value for tag, value in best.items() if problem.similarity.holds(tag, target.tag)]
        if values and wish.bound is not None and not any(is_met(attribute, wish, value) for value in values):
            is_low = attribute.better is Better.LOWER
            reached = min(values) if is_low else max(values)
            return (
                f"target {target.label} asks for {attribute.name} of {'at most' if is_low else 'at least'} "
                f"{units(wish.bound):f}, but the best that any wiring reaches is {units(reached):f}"
            )
    return None


def _best_values(problem: Problem, name: str) -> dict[str, int]:
    """For each offered tag the best value that a stream with it can have: rules are monotone, so best feeds best."""
    environment = problem.environment
    attribute = environment.quality[name]
    best: dict[str, int] = {}
    rounds = len(environment.units) + sum(problem.most_new(t) for t in environment.library)
    for _ in range(rounds):
        before = dict(best)
        for transformation in environment.library:
            inputs: list[int] = []
            for port in transformation.inputs:
                fit = [value for tag, value in before.items() if problem.similarity.holds(tag, port.tag)]
                if not port.feedback:
                    inputs += [min(fit) if attribute.better is Better.LOWER else max(fit)] if fit else []
            if len(inputs) < sum(not port.feedback for port in transformation.inputs):
                continue
            for output in transformation.outputs:
                stated = {c.attribute: c for c in output.quality}.get(name)
                value = propagated(attribute, stated, inputs)
                if output.tag not in best or attribute.is_better(value, best[output.tag]):
                    best[output.tag] = value
        if best == before:
            break
    return best
