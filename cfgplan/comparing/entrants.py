"""The planners of a comparison: registered ones by name, and any others that can be imported."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from pkgutil import iter_modules
from types import MappingProxyType

from cfgplan.errors import known
from cfgplan.planners import PLANNERS, function_at
from cfgplan.planning import Planner


@dataclass(frozen=True)
class Entrant:
    """A planner by name.

    `function` is empty for a registered planner, else `module:function`. The `engines` are modules to import
    before the clock starts.
    """

    name: str
    function: str = ""
    engines: tuple[str, ...] = ()

    def planner(self) -> Planner:
        """The planner itself, its engines imported. Raises ImportError where an engine or the function is missing."""
        for engine in self.engines:
            import_module(engine)
        if not self.function:
            return PLANNERS[self.name]
        planner: Planner = function_at(self.function)
        return planner


_FOLDERS = ("networks", "reducing", "bounding", "closing", "solving", "exact")
"""The folders of `cpsat`, which imports most of their modules when it first needs them."""


def _modules_of(package: str) -> list[str]:
    found = find_spec(package)
    folders = None if found is None else found.submodule_search_locations
    return sorted(f"{package}.{module.name}" for module in iter_modules(folders or ()))


def _registered(name: str) -> Entrant:
    module = f"cfgplan.planners.{name.replace('-', '_')}"
    if name == "cpsat":
        parts = (part for folder in _FOLDERS for part in _modules_of(f"cfgplan.planners.{folder}"))
        return Entrant(name, engines=("networkx", "numpy", "ortools.linear_solver.pywraplp", module, *parts))
    return Entrant(name, engines=(module,) if find_spec(module) else ())


REGISTERED: Mapping[str, Entrant] = MappingProxyType({name: _registered(name) for name in PLANNERS})
"""An entrant for each planner of the registry."""


def entrant(name: str) -> Entrant:
    """The registered planner of that name, or the one at `module:function`. Raises InputError."""
    if all(name.partition(":")):
        return Entrant(name, function=name)
    return REGISTERED[known(name, REGISTERED, "planner", f"name one of {', '.join(REGISTERED)}, or module:function")]
