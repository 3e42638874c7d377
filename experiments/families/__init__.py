"""Families of instances, by name: functions from a seed and parameters to a planning problem.

The same seed and parameters give the same problem on every machine.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

from cfgplan.planning import Problem
from experiments.families.adversarial import adversarial
from experiments.families.deployments import deployment
from experiments.families.fleets import fleet
from experiments.families.nao import nao
from experiments.families.random_library import random_library, replanning
from experiments.families.transport import transport

FAMILIES: Mapping[str, Callable[..., Problem]] = MappingProxyType(
    {
        "adversarial": adversarial,
        "deployment": deployment,
        "fleet": fleet,
        "nao": nao,
        "random_library": random_library,
        "replanning": replanning,
        "transport": transport,
    }
)
"""Each is called with a seed and keyword parameters; see its docstring for what these mean."""

__all__ = ["FAMILIES", "adversarial", "deployment", "fleet", "nao", "random_library", "replanning", "transport"]
