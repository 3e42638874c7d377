"""The instances of the comparison at scale."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from types import MappingProxyType

from experiments.study.instances import Instance, generated

SCALE: Mapping[str, Mapping[str, float]] = MappingProxyType(
    {
        "50": {"transformations": 50, "targets": 3},
        "500": {"transformations": 500, "targets": 1},
        "500, branching 2": {"transformations": 500, "targets": 1, "branching": 2},
        "500, branching 50": {"transformations": 500, "targets": 1, "branching": 50},
        "500, 8 targets": {"transformations": 500, "targets": 8},
        "500, 2 outputs, 8 targets": {"transformations": 500, "targets": 8, "outputs": 2},
        "500, a third running, 8 targets": {"transformations": 500, "targets": 8, "running": 0.3},
        "500, arity 3, back .4": {"transformations": 500, "targets": 3, "arity": 3, "back": 0.4},
        "1,000, 5 targets": {"transformations": 1000, "targets": 5},
        "1,000, 60 targets": {"transformations": 1000, "targets": 60},
        "2,000, 3 targets": {"transformations": 2000, "targets": 3},
        "5,000": {"transformations": 5000, "targets": 1},
        "5,000, branching 20": {"transformations": 5000, "targets": 1, "branching": 20},
        "50,000, branching 20": {"transformations": 50000, "targets": 1, "branching": 20},
    }
)
"""Families of random libraries by name: sizes, branching, cycles, outputs, running units."""
OTHERS: Mapping[str, tuple[str, Mapping[str, int]]] = MappingProxyType(
    {
        "NAO, 10 of 20 robots fused": ("nao", {"robots": 20, "fusion": 10}),
        "transport, 6 crates": ("transport", {"crates": 6}),
        "transport, 10 crates": ("transport", {"places": 5, "trucks": 3, "crates": 10}),
        "fleet, 60 on 3 hosts": ("fleet", {"transformations": 60, "hosts": 3}),
        "fleet, 150 on 3 hosts": ("fleet", {"transformations": 150, "hosts": 3}),
        "deployment, 6 hosts, 2 replicas": ("deployment", {"hosts": 6, "replicas": 2}),
        "deployment, 20 hosts, 6 replicas": ("deployment", {"hosts": 20, "replicas": 6}),
    }
)
"""The other families by name; fleets and deployments start from nothing."""
SCALE_SEEDS = tuple(range(7400, 7410))
"""Other ones than those that the planner's constants were chosen on."""


def families() -> dict[str, tuple[str, Mapping[str, float]]]:
    """Return the generator and the parameters of each family, by name."""
    return {**{name: ("random_library", parameters) for name, parameters in SCALE.items()}, **OTHERS}


def scale() -> Iterator[Instance]:
    """Yield random libraries of 50 to 50,000 transformations, robots, transports, fleets, deployments: one of each
    family for each of ten seeds, so that an interrupted comparison has all families.
    """
    for seed in SCALE_SEEDS:
        for family, parameters in families().values():
            yield generated(family, seed, **parameters)
