"""Deployments: replicated services on rented machines, with many identical units and hosts.

They follow published deployments of OpenStack: 17 components, some replicated, on machines of a few sizes.
"""

from __future__ import annotations

import random
from dataclasses import replace

from cfgplan.domain import Environment, Host, InputPort, Objective, OutputPort, Similarity, Target, Transformation
from cfgplan.planning import Problem

COMPONENTS = 17


def deployment(
    seed: int, *, hosts: int = 6, replicas: int = 2, minimise: tuple[Objective, ...] = (Objective.COST,)
) -> Problem:
    """Return a deployment of 17 components on machines of two sizes.

    About a third of the components run `replicas` times. Each needs streams of one to three earlier components, some
    from several units. Some serve a limited number of consumers, some never share a machine, and one accompanies
    others.
    """
    rng = random.Random(seed)
    library: list[Transformation] = []
    for number in range(COMPONENTS - 1):
        is_replicated = number % 3 == 2
        feeders = rng.sample(library, min(len(library), rng.randint(1, 3)))
        inputs = tuple(
            InputPort(f"i{n}", f"S{feeder.label}", count=rng.randint(2, replicas) if feeder.min_instances > 1 else 1)
            for n, feeder in enumerate(feeders)
        )
        library.append(
            Transformation(
                f"c{number:02}",
                inputs,
                (OutputPort("o", f"Sc{number:02}", serves=rng.choice([None, None, 3 * replicas])),),
                labor_us=rng.randint(1, 20) * 100_000,
                upkeep_us=rng.randint(1, 50) * 1_000,
                memory_mb=rng.choice([250, 500, 500, 1000, 2000]),
                min_instances=replicas if is_replicated else 0,
                max_instances=replicas + 2 if is_replicated else 2,
                per_host=rng.choice([1, 2]) if is_replicated else None,
                conflicts_on_host=(rng.choice(library).label,) if number and rng.random() < 0.25 else (),
                beside=("agent",) if rng.random() < 0.3 else (),
            )
        )
    library.append(Transformation("agent", outputs=(OutputPort("o", "Sagent"),), upkeep_us=500, memory_mb=100))
    used = {port.tag for kind in library for port in kind.inputs}
    ends = [kind for kind in library[:-1] if f"S{kind.label}" not in used]
    sizes = [(4_000, 40_000, "small"), (8_000, 70_000, "large")]
    machines = [
        Host(f"{sizes[n % 2][2]}{n:03}", memory_mb=sizes[n % 2][0], rent_us=sizes[n % 2][1]) for n in range(hosts)
    ]
    tags = used | {f"S{kind.label}" for kind in ends}
    targets = [Target(f"t{n}", f"S{kind.label}", f"/t{n}") for n, kind in enumerate(ends)]
    environment = Environment((), tuple(library), tuple(targets), tuple(machines), minimise=minimise)
    return Problem(environment, Similarity({tag: frozenset({tag}) for tag in tags}), 3600)


def with_one_word(problem: Problem, **said: object) -> Problem:
    """Return the deployment with one more input at a component, which has the given fields."""
    library = list(problem.environment.library)
    more = InputPort("more", "Sc00", **said)  # type: ignore[arg-type]
    library[5] = replace(library[5], inputs=(*library[5].inputs, more))
    return replace(problem, environment=replace(problem.environment, library=tuple(library)))


def with_a_ring(problem: Problem) -> Problem:
    """Return the deployment with two more components that may feed each other or use an expensive source."""
    library = list(problem.environment.library)
    offers = dict(problem.similarity.offers)
    for reader, provider in ((5, 8), (8, 5)):
        port = InputPort("ring", f"R{library[reader].label}")
        offers[port.tag] = frozenset({f"S{library[provider].label}", "Ssource"})
        library[reader] = replace(library[reader], inputs=(*library[reader].inputs, port))
    library.append(Transformation("source", outputs=(OutputPort("o", "Ssource"),), upkeep_us=60_000, memory_mb=2_000))
    environment = replace(problem.environment, library=tuple(library))
    return replace(problem, environment=environment, similarity=Similarity(offers))
