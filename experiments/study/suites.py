"""Sets of instances: generated ones by name, and the Web Service Challenge 2008 from wherever a copy of it lies."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import MappingProxyType

from cfgplan.errors import InputError
from cfgplan.formats.wsc import WscObjective, read_wsc
from cfgplan.planning import Problem
from experiments.study.instances import Instance, generated


def tiny() -> Iterator[Instance]:
    """One of each family: for tests."""
    yield generated("nao", robots=1, event="lost")
    yield generated("random_library", 1, transformations=14, depth=3, targets=2)
    yield generated("replanning", 3, transformations=12, depth=3, targets=2)
    yield generated("adversarial", kind="dedicated", size=4)
    yield generated("adversarial", kind="ring", size=3)
    yield generated("transport", places=2, trucks=1, crates=2)


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


SUITES: Mapping[str, Callable[[], Iterator[Instance]]] = MappingProxyType({"tiny": tiny, "short": short, "full": full})

OBJECTIVES: tuple[WscObjective, ...] = ("services", "length")


def wsc_sets(folder: Path) -> list[Instance]:
    """Return two instances for each set in a folder of sets: fewest services at all, and at the shortest length.

    Raises InputError if the folder has no set.
    """
    sets = sorted(path.parent for path in folder.glob("*/services.xml"))
    if not sets:
        raise InputError.of("there is no set of the Web Service Challenge", file=str(folder), mend="name their folder")
    return [_instance(path, objective) for path in sets for objective in OBJECTIVES]


def _instance(folder: Path, objective: WscObjective) -> Instance:
    def make() -> Problem:
        world, similarity = read_wsc(folder, objective)
        return Problem(world.environment, similarity, world.horizon_s, world.max_cost_us)

    return Instance(f"wsc({folder.name}, {objective})", "wsc", {"set": folder.name, "kind": objective}, None, make)
