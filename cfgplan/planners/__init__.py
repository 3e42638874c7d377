"""The planners, each a function of a problem (`planning.Planner`), by the name the user writes.

* `cpsat`: exact, by constraint programming with lazily added groundedness.
* `exhaustive`: the oracle, which tries every set of units and every wiring; about ten transformations.
* `branch-and-bound`: the paper's Algorithms 1 and 2 with the merging of section IV-D; not optimal.

None of them gets open pairs of tags: `undecided` calls them with each pair as matching or not. `planner_of` finds
a planner of the user's own.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from importlib import import_module
from inspect import signature
from pathlib import Path
from types import MappingProxyType
from typing import Any

from cfgplan.errors import InputError, known
from cfgplan.planners.undecided import Deciding
from cfgplan.planning import OnProgress, OwnPlannerError, Plan, Planner, PlannerFaultError, Problem


def _deciding(found: Callable[[], Planner]) -> Planner:
    """Return a planner that calls `found()` for the planner to use, inside a `Deciding` if pairs are open."""

    def planner(problem: Problem, *, time_limit_s: float | None = None, report: OnProgress | None = None) -> Plan:
        plan = Deciding(found()) if problem.similarity.open else found()
        return plan(problem, time_limit_s=time_limit_s, report=report)

    return planner


def _imported_on_use(module: str) -> Planner:
    """The module's function `plan`; the module is imported at the first call."""
    return _deciding(lambda: import_module(module).plan)


IGNORING_REQUIRED = frozenset({"branch-and-bound"})
"""Planners that do not try to use required transformations."""
PLANNERS: Mapping[str, Planner] = MappingProxyType(
    {
        "cpsat": _imported_on_use("cfgplan.planners.cpsat"),
        "exhaustive": _imported_on_use("cfgplan.planners.exhaustive"),
        "branch-and-bound": _imported_on_use("cfgplan.planners.branch_and_bound"),
    }
)


def planner_of(planner: str | Planner) -> Planner:
    """Return the registered planner of a name, or the user's own planner: `module:function`, or the function itself.

    Raises InputError for an unknown name, and OwnPlannerError if the module of the user's own planner raises an
    exception. If that planner fails, the returned one raises OwnPlannerError.
    """
    if not isinstance(planner, str):
        if _is_of_cfgplan(planner):
            return _deciding(lambda: planner)
        return _own(f"{planner.__module__}:{planner.__qualname__}" if hasattr(planner, "__qualname__") else "", planner)
    if ":" not in planner:
        return PLANNERS[known(planner, PLANNERS, "planner", f"name one of {', '.join(PLANNERS)}, or module:function")]
    try:
        return _own(planner, function_at(planner))
    except ImportError as error:
        mend = "name it as module:function; the module is looked for where Python looks, and here"
        file, _, function = planner.partition(":")
        if file.endswith(".py") and Path(file).stem.isidentifier():
            folder = "" if Path(file).parent == Path() else f", in the folder {Path(file).parent}"
            mend = f"write {Path(file).stem}:{function or 'plan'}{folder}: a module has no ending"
        elif error.name is not None and not f"{file}.".startswith(f"{error.name}."):
            mend = f"{file} imports it: correct that line, or install the package"
        raise InputError.of(f"the planner {planner!r} can't be used: {error}", mend=mend) from error
    except (Exception, SystemExit) as error:
        raise OwnPlannerError(f"the planner {planner} can't be imported: {_said(error)}") from error


def _said(error: BaseException) -> str:
    return f"{type(error).__name__}: {error}"


def _is_of_cfgplan(planner: Planner) -> bool:
    """Return whether a planner's code is cfgplan's, as that of a session. `functools.wraps` copies `__module__`."""
    module = getattr(planner, "__globals__", {}).get("__name__", "")
    return f"{module}.".startswith(f"{__name__}.")


def function_at(name: str) -> Callable[..., Any]:
    """The function at `module:function`. Raises ImportError."""
    module, _, function = name.partition(":")
    if not (function and all(part.isidentifier() for part in module.split("."))):
        raise ImportError(f"{name!r} is not module:function")
    found = getattr(import_module(module), function, None)
    if not callable(found):
        raise ImportError(f"module {module} has no function {function}")
    return found  # type: ignore[no-any-return]


def _own(name: str, function: Planner) -> Planner:
    """Return a function as a planner of this name, whose faults raise OwnPlannerError.

    InputError is a planner's way to refuse a problem, and the errors of other planners that it calls are theirs.
    """
    deciding = _deciding(lambda: function)

    def planner(problem: Problem, **how: Any) -> Plan:
        try:
            signature(function).bind(problem, **how)
        except TypeError as error:
            mend = "write it as `def plan(problem, *, time_limit_s=None, report=None)`"
            raise OwnPlannerError(f"the planner {name} can't be called: {error}", mend=mend) from error
        except ValueError:  # a function of C that has no signature
            pass
        try:
            found = deciding(problem, **how)
        except (InputError, OwnPlannerError, PlannerFaultError):
            raise
        except (Exception, SystemExit) as error:
            raise OwnPlannerError(f"the planner {name} failed: {_said(error)}") from error
        if not isinstance(found, Plan):
            mend = "return a cfgplan.Plan, with the status UNKNOWN if none is found"
            raise OwnPlannerError(f"the planner {name} returned {found!r:.60}, not a cfgplan.Plan", mend=mend)
        return replace(found, planner=name) if name else found

    return planner
