"""Named sets of instances, from seconds to an hour of planning."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from types import MappingProxyType

from cfgplan.comparing.instances import Instance, generated


def tiny() -> Iterator[Instance]:
    """One of each family: for tests."""
    yield generated("nao", robots=1, event="lost")
    yield generated("random_library", 1, transformations=14, depth=3, targets=2)
    yield generated("replanning", 3, transformations=12, depth=3, targets=2)
    yield generated("adversarial", kind="dedicated", size=4)
    yield generated("adversarial", kind="ring", size=3)


def short() -> Iterator[Instance]:
    """A few sizes of each family: under five minutes with two seconds for a run."""
    for robots in (1, 5, 20):
        yield generated("nao", robots=robots)
    yield generated("nao", robots=10, event="lost")
    yield generated("nao", robots=4, fusion=2)
    for transformations in (25, 100, 400):
        yield generated("random_library", transformations=transformations)
    for depth in (3, 10):
        yield generated("random_library", transformations=100, depth=depth)
    yield generated("random_library", transformations=100, running=0.5)
    for failures in (1, 4):
        yield generated("replanning", transformations=200, failures=failures)
    for kind, sizes in {"dedicated": (4, 16), "tower": (4, 12), "blow-up": (4, 8), "ring": (4, 16)}.items():
        for size in sizes:
            yield generated("adversarial", kind=kind, size=size)
    yield generated("adversarial", kind="fusion", size=4)
    yield generated("adversarial", kind="cover", size=40)


def full() -> Iterator[Instance]:
    """The study: every parameter of every family is varied by itself."""
    for robots in range(1, 21):
        yield generated("nao", robots=robots)
    for robots in (2, 5, 10, 20):
        yield generated("nao", robots=robots, event="lost")
    for robots in (2, 10):
        yield generated("nao", robots=robots, event="left")
    for robots in (2, 3, 4, 6, 10):
        yield generated("nao", robots=robots, fusion=2)
    for seed in (0, 1):
        for transformations in (25, 50, 100, 200, 500, 1000, 2000):
            yield generated("random_library", seed, transformations=transformations)
    varied: Mapping[str, tuple[float, ...]] = {
        "depth": (2, 3, 5, 8, 12),
        "branching": (1, 2, 4, 8, 16),
        "arity": (1, 2, 3),
        "outputs": (1, 2, 4),
        "back": (0.0, 0.1, 0.3, 0.5),
        "sharing": (0.0, 0.5, 0.9),
        "targets": (1, 3, 10),
        "running": (0.0, 0.3, 0.6, 0.9),
        "horizon_s": (0, 60, 600, 3600),
    }
    for name, values in varied.items():
        for value in values:
            yield generated("random_library", transformations=100, **{name: value})
    yield generated("random_library", 1, transformations=500, arity=3, back=0.4)
    for transformations in (100, 500, 1000):
        for failures in (1, 4, 8):
            yield generated("replanning", transformations=transformations, targets=5, failures=failures)
    yield generated("replanning", transformations=500, targets=5, failures=4, gone=1.0)
    sizes = {
        "dedicated": (2, 4, 8, 16, 32),
        "tower": (2, 4, 6, 8, 12, 16),
        "blow-up": (2, 4, 6, 8, 10),
        "ring": (2, 4, 8, 16),
        "fusion": (2, 4, 8, 12),
        "cover": (10, 20, 40, 80),
    }
    for kind, values in sizes.items():
        for size in values:
            yield generated("adversarial", kind=kind, size=int(size))


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
SCALE_SEEDS = (10, 11, 12)
"""Other ones than those that the planner's constants were chosen on."""


def scale() -> Iterator[Instance]:
    """Random libraries of 50 to 50,000 transformations, three of each family of `SCALE`."""
    for parameters in SCALE.values():
        for seed in SCALE_SEEDS:
            yield generated("random_library", seed, **parameters)


SUITES: Mapping[str, Callable[[], Iterator[Instance]]] = MappingProxyType(
    {"tiny": tiny, "short": short, "full": full, "scale": scale}
)
