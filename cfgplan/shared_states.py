"""States that two units would save at once: `run: {state: NAME}` of modes that are meant to replace each other.

Each of the two units overwrites the state of the other, and a new unit continues with the state saved last.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator
from dataclasses import replace

from cfgplan.domain import Environment
from cfgplan.onward import grouped
from cfgplan.planning import Problem
from cfgplan.reasons import Providers, startable
from cfgplan.summary import some

_HARM = "each overwrites the state of the other"
_MEND = "give them different state names, or let them exclude each other by `conflicts`"


def double_owners(environment: Environment) -> Iterator[str]:
    """Yield a warning for each state that several running units save."""
    library = environment.transformation
    running = [unit for unit in environment.units if not unit.standby and unit.transformation in library]
    for state, units in sorted(grouped((library[u.transformation].state_name or "", u.id) for u in running).items()):
        if state and len(units) > 1:
            yield f"units {some(sorted(units))} save state {state} at once: {_HARM}; {_MEND}"


def shared_states(problem: Problem) -> Iterator[str]:
    """Yield a warning for each state that several units save in every configuration that meets the targets.

    Bounds of qualities and limits of resources may force further units; they are not considered.
    """
    library = problem.environment.library
    named = grouped((t.state_name or "", t.label) for t in library)
    for state, labels in sorted(named.items()):
        if state and not any(_is_enough(problem, label, {*labels} - {label}) for label in labels):
            who = some(sorted(labels))
            yield (
                f"{who} {'share' if len(labels) > 1 else 'has'} state {state}, and the targets need two units with it "
                f"at once: {_HARM}; {_MEND}"
            )


def _is_enough(problem: Problem, label: str, others: Collection[str]) -> bool:
    """Whether one unit of a transformation may meet all targets that can be met, without any of the `others`."""
    environment = problem.environment
    library = environment.transformation
    if library[label].min_instances > 1 or any(library[other].min_instances for other in others):
        return False
    left = tuple(t for t in environment.library if t.label not in others)
    while (less := tuple(t for t in left if {t.label for t in left}.issuperset(t.beside))) != left:
        left = less
    less_environment = replace(environment, library=left)
    return _met(problem, environment, {}) <= _met(problem, less_environment, {label: 1})


def _met(problem: Problem, environment: Environment, units: dict[str, int]) -> set[str]:
    """Return the targets that some configuration with at most these numbers of units may meet."""
    running = Counter(unit.transformation for unit in environment.units)
    most = {t.label: problem.most_new(t) + running[t.label] for t in environment.library} | units
    providers = Providers(environment.library, problem.similarity.optimistic)
    possible = startable(environment, providers, units=most)
    return {target.label for target in environment.targets if not possible.isdisjoint(providers.of(target.tag))}
