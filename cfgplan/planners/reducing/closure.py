"""The closure of a library: the givers of each demand, and the transformations that can start and may be needed."""

from __future__ import annotations

from collections.abc import Iterable

from cfgplan.domain import Environment
from cfgplan.frozen import dataclass
from cfgplan.onward import reached
from cfgplan.planners.solving.clock import Clock
from cfgplan.planning import Problem
from cfgplan.reasons import Each, Givers, startable


@dataclass(frozen=True)
class Closure:
    """`givers` has the givers of each demand; `possible` are the transformations that can be started; `relevant` those
    of them that may be needed; `asked_for` those with a unit in every plan: by a pin, a number or a target.
    """

    givers: Givers
    possible: frozenset[str]
    relevant: frozenset[str]
    asked_for: frozenset[str]

    @classmethod
    def of(cls, problem: Problem, clock: Clock, old: Closure | None = None) -> Closure:
        """The closure of a problem; `old` is one of the same library and matching. Raises OutOfTimeError."""
        environment = problem.environment
        if old is not None:
            givers, possible = old.givers, old.possible
        else:
            givers = Givers(environment.library, problem.similarity)
            possible = startable(environment, givers, clock.each)
            givers = givers.among(possible)
        asked = asked_for(environment) & possible
        return cls(givers, possible, relevant(environment, givers, possible, clock.each), asked)


def asked_for(environment: Environment) -> frozenset[str]:
    """The labels with a pinned running unit, a least number of instances, or a target that wants a unit of them."""
    running = {unit.transformation for unit in environment.units}
    asked = (t.label for t in environment.library if t.min_instances or (t.pinned and t.label in running))
    return frozenset([*asked, *environment.wanted_to_run.values()])


def relevant(environment: Environment, givers: Givers, possible: frozenset[str], each: Each) -> frozenset[str]:
    """The labels out of `possible` that a target, a pinned unit or a number asks for, directly or through others.

    An input that starts nothing asks for none.
    """
    library = environment.transformation
    found = set(with_companions(environment, asked_for(environment) & possible))
    ahead = [target.tag for target in environment.targets]
    ahead += [port.tag for label in sorted(found) for port in library[label].inputs if not port.starts_nothing]
    seen = set(ahead)
    for tag in each(ahead):
        new = [label for label in givers.of(tag) if label in possible and label not in found]
        for label in with_companions(environment, new):
            found.add(label)
            for port in library[label].inputs:
                if port.tag not in seen and not port.starts_nothing:
                    seen.add(port.tag)
                    ahead.append(port.tag)
    return frozenset(found & possible)


def with_companions(environment: Environment, labels: Iterable[str]) -> list[str]:
    """Some transformations and those that they run with, directly or through others."""
    library = environment.transformation
    if not environment.companions:
        return list(labels)
    return reached(labels, lambda label: (other for other in library[label].beside if other in library))
