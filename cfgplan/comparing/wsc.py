"""The sets of the Web Service Challenge 2008 as instances, from wherever a copy of them lies."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from cfgplan.comparing.instances import Instance
from cfgplan.errors import InputError
from cfgplan.planning import Problem

Objective = Literal["services", "length"]


def wsc_sets(folder: Path) -> list[Instance]:
    """Two instances for each set in a folder of sets: fewest services at all, and at the shortest length.

    Raises InputError if there is no set.
    """
    sets = sorted(path.parent for path in folder.glob("*/services.xml"))
    if not sets:
        raise InputError.of("there is no set of the Web Service Challenge", file=str(folder), mend="name their folder")
    return [_instance(path, objective) for path in sets for objective in _OBJECTIVES]


_OBJECTIVES: tuple[Objective, ...] = ("services", "length")


def _instance(folder: Path, objective: Objective) -> Instance:
    def make() -> Problem:
        from cfgplan.formats.wsc import read_wsc

        world, similarity = read_wsc(folder, objective)
        return Problem(world.environment, similarity, world.horizon_s, world.max_cost_us)

    return Instance(f"wsc({folder.name}, {objective})", "wsc", {"set": folder.name, "kind": objective}, None, make)
