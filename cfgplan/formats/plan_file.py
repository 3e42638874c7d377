"""Plans as JSON, written by `solve --out` and read by every command that applies a plan.

Costs are integers in microseconds; the keys that end in `_s` say the same in CPU seconds for people, and are not read
back. `environment` is the digest of the environment that the plan was made for.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path as FilePath
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from cfgplan.costs import seconds
from cfgplan.domain import CPU, MEMORY, ChangeSet, ComputationUnit, Environment, Objective
from cfgplan.errors import InputError, InvalidValueError
from cfgplan.facts import FactValue
from cfgplan.figures import cost_parts, loads, qualities_of_targets, transfers
from cfgplan.formats.dump import changes_of, plain_unit
from cfgplan.formats.files import read_text
from cfgplan.formats.json_text import read_json
from cfgplan.formats.places import Source
from cfgplan.formats.schema_faults import schema_faults
from cfgplan.planning import Measured, Plan, Problem, Status
from cfgplan.qualities import units

FORMAT_VERSION = 1
_MADE_BY = "`cfgplan solve --out` or `cfgplan ctl plan --out`"


class _PlanPart(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)


class PlannedUnit(_PlanPart):
    """A unit as it is after the update."""

    id: str
    transformation: str
    inputs: dict[str, str | list[str]] = Field(
        default={}, description="input port to the stream (unit/port) that feeds it, or to a list of several"
    )
    topics: dict[str, list[str]] = Field(default={}, description="output port to the topics it is published on")
    labor_us: int = Field(default=0, ge=0, description="CPU time of its start; 0 if it runs already")
    upkeep_us: int = Field(default=0, ge=0, description="CPU time that it takes each second")
    host: str | None = Field(default=None, description="where it runs")
    standby: bool = Field(default=False, description="it is a cold spare: ready, but not running")


class ChangeSetPart(_PlanPart):
    """Definition 6: units to start, to rewire and to stop."""

    started: list[PlannedUnit] = []
    rewired: list[PlannedUnit] = []
    stopped: list[str] = []


class MeasuredPart(_PlanPart):
    """An objective; rent and cost are in microseconds."""

    objective: Literal["rent", "cost", "units", "hosts", "rewired", "started"]
    value: int = Field(ge=0)
    bound: int = Field(ge=0, description="no update that is as good in what comes before has less")


class FactUsed(_PlanPart):
    """A fact of the world."""

    declared: Any = Field(description="what the environment file says: a number, true, false or a word")
    used: Any = Field(description="what the plan was made with")


class QualityUsed(_PlanPart):
    """The own part of an output, in units of the attribute."""

    declared: Any = Field(description="what the environment file says")
    used: Any = Field(description="what the plan was made with, as streams were observed")


class PlanPart(_PlanPart):
    """A planner's answer and the environment it holds for."""

    model_config = ConfigDict(extra="forbid", strict=True, title="cfgplan plan")

    format_version: Literal[1]
    environment: str = Field(description="digest of the environment that the plan was made for")
    planner: str
    status: Literal["optimal", "feasible", "infeasible", "too expensive", "unknown"]
    horizon_s: int = Field(ge=0)
    max_cost_us: int | None = None
    cost_us: int | None = None
    cost_s: Any = Field(default=None, description="cost_us in CPU seconds")
    bound_us: int = Field(description="no update is cheaper than this")
    bound_s: Any = Field(default=None, description="bound_us in CPU seconds")
    gap: Any = Field(default=None, description="how far the cost may be above the optimum, as a share of the cost")
    change_set: ChangeSetPart | None = Field(default=None, description="there if the status is optimal or feasible")
    reasons: dict[str, str] = Field(
        default={}, description="why a target can't be met, by its label, or a pinned unit can't be fed, by its id"
    )
    unused_required: list[str] = []
    ties_proven: bool = Field(default=False, description="no plan of this cost rewires, or then starts, fewer units")
    required_proven: bool = Field(default=False, description="no configuration uses more required transformations")
    undecided: list[tuple[str, str]] = Field(
        default=[], description="undecided pairs of tags (offered, demanded) on which the bound depends"
    )
    objectives: list[MeasuredPart] = Field(
        default=[], description="the objectives, in order, if they are more than the cost"
    )
    seconds: dict[str, Any] = Field(default={}, description="wall time of each phase")
    counts: dict[str, int] = Field(default={}, description="the planner's own figures")
    survive: Literal["units", "hosts"] | None = Field(default=None, description="single failures that it bears")
    figures: Any = Field(default=None, description="cost by parts, quality, hosts and transfers, beyond the paper")
    facts: dict[str, FactUsed] = Field(default={}, description="the facts of the world that the plan was made with")
    qualities: dict[str, QualityUsed] = Field(
        default={},
        description="`transformation/port attribute`, with hosts ` on HOST` too: observed qualities in the plan",
    )
    basis: dict[str, dict[str, str]] = Field(
        default={},
        description="of a run's plan: a digest of each unit, transformation, target and setting it is for, and of the "
        "side of each comparison of a fact",
    )


def dump_plan(plan: Plan, problem: Problem, digest: str, basis: Mapping[str, Mapping[str, str]] | None = None) -> str:
    """The JSON text of a plan for `problem`, whose environment has the digest `EnvironmentFile.digest`.

    A run's plan has a `basis`: digests by kind and name. Raises InvalidValueError for a change set over
    transformations or targets: planners change units.
    """
    document = {
        "format_version": FORMAT_VERSION,
        "environment": digest,
        "planner": plan.planner,
        "status": plan.status.value,
        "horizon_s": problem.horizon_s,
        "max_cost_us": problem.max_cost_us,
        "cost_us": plan.cost_us,
        "cost_s": None if plan.cost_us is None else float(seconds(plan.cost_us)),
        "bound_us": plan.bound_us,
        "bound_s": float(seconds(plan.bound_us)),
        "gap": plan.gap,
        "change_set": None if plan.change_set is None else _change_set(plan.change_set, problem),
        "reasons": dict(plan.reasons),
        "unused_required": list(plan.unused_required),
        "ties_proven": plan.ties_proven,
        "required_proven": plan.required_proven,
        "undecided": [list(pair) for pair in plan.undecided],
        "seconds": dict(plan.seconds),
        "counts": dict(plan.counts),
        **_beyond_the_paper(plan, problem),
        **({"facts": facts} if (facts := _facts(problem.environment)) else {}),
        **({"qualities": qualities} if (qualities := _qualities(problem.environment)) else {}),
        **({} if basis is None else {"basis": basis}),
    }
    return json.dumps(document, indent=2, ensure_ascii=False) + "\n"


def load_plan(path: str | os.PathLike[str], digest: str | None = None) -> Plan:
    """Return the plan in a file; raises InputError, also if it was made for another environment than `digest`.

    Only the form is checked, and the environment if `digest` is given; costs, wiring and proofs are not. To carry out a
    plan, call `cfgplan.load_plan`, which asks the judge.
    """
    source = read_json(read_text(FilePath(path)), str(path), _MADE_BY)
    part = _plan_part(source)
    if digest is not None and part.environment != digest:
        message = "the plan is stale: it was made for another environment, or this one has changed since"
        raise InputError([source.fault(("environment",), message, "solve again to get a plan for this environment")])
    return _plan_in(source, part)


def read_run_plan(text: str, name: str) -> tuple[Plan, Mapping[str, Mapping[str, str]]]:
    """The plan in the text of a file `name` and the basis that it was made for; empty if it was made for no run.

    Raises InputError. Only the form is checked.
    """
    source = read_json(text, name, _MADE_BY)
    part = _plan_part(source)
    return _plan_in(source, part), part.basis


def _plan_part(source: Source) -> PlanPart:
    if source.faults:
        raise InputError(source.faults)
    try:
        return PlanPart.model_validate(source.data)
    except ValidationError as error:
        raise InputError(schema_faults(source, (), error.errors(include_url=False), PlanPart)) from None


def _plan_in(source: Source, part: PlanPart) -> Plan:
    try:
        return _plan(part)
    except InvalidValueError as error:
        mend = "write the plan again with `solve --out` or `ctl plan --out`"
        raise InputError([source.fault(("change_set",), str(error), mend)]) from None


def _facts(environment: Environment) -> dict[str, dict[str, object]]:
    found = environment.variable.items()
    return {key: {"declared": _plain(fact.declared), "used": _plain(fact.value)} for key, fact in found}


def _qualities(environment: Environment) -> dict[str, dict[str, object]]:
    """The declared and used values of the qualities that observed streams have changed."""
    found = {
        str(statement): stated
        for some in environment.taught.values()
        for statement in some
        if (stated := environment.stated(statement)) is not None
    }
    return {name: {"declared": _plain(one.stated), "used": _plain(one.value)} for name, one in found.items()}


def _plain(value: FactValue) -> bool | float | str:
    return value if isinstance(value, bool | str) else float(units(value))


def _change_set(change_set: ChangeSet, problem: Problem) -> dict[str, Any]:
    units = ChangeSet(change_set.started, change_set.rewired, change_set.stopped)
    if units != change_set:
        raise InvalidValueError("a plan file holds changes of units, not of transformations or targets")
    return {
        "started": [_unit(unit, problem, starts=True) for unit in change_set.started],
        "rewired": [_unit(unit, problem, starts=False) for unit in change_set.rewired],
        "stopped": list(change_set.stopped),
    }


def _unit(unit: ComputationUnit, problem: Problem, *, starts: bool) -> dict[str, Any]:
    transformation = problem.environment.transformation.get(unit.transformation)
    if transformation is None:  # a run keeps it although it starts no more of them
        return plain_unit(unit)
    return {
        **plain_unit(unit),
        "labor_us": transformation.labor_us if starts and not unit.standby else 0,
        "upkeep_us": (transformation.standby_us or 0) if unit.standby else transformation.upkeep_us,
    }


def _beyond_the_paper(plan: Plan, problem: Problem) -> dict[str, Any]:
    """Figures for people and other programs, where a problem asks for them; they are not read back."""
    if problem.is_plain:
        return {}
    found: dict[str, Any] = {"survive": None if problem.survive is None else problem.survive.value}
    if plan.objectives:
        found["objectives"] = [asdict(one) for one in plan.objectives]
    if plan.change_set is not None:
        found["figures"] = _figures(problem, problem.environment.update(plan.change_set))
    return found


def _figures(problem: Problem, after: Environment) -> dict[str, Any]:
    parts = cost_parts(problem, after.units)
    reached = qualities_of_targets(after, after.units)
    return {
        "cost_us": {
            "labor": parts.labor_us,
            "upkeep": parts.upkeep_us,
            "standby": parts.standby_us,
            "transfers": parts.transfer_us,
            "quality": parts.quality_us,
            **({"rent": parts.rent_us} if parts.rent_us else {}),
            **({"unfed": parts.unfed_us} if parts.unfed_us else {}),
        },
        "quality": {
            label: {name: float(units(value)) for name, value in values.items()} for label, values in reached.items()
        },
        "hosts": {
            name: {{CPU: "cpu_us", MEMORY: "memory_mb"}.get(resource, resource): load[resource] for resource in load}
            for name, load in loads(after, after.units).items()
        },
        "transfers": [
            {"stream": str(t.stream), "from": t.origin, "to": t.to, "cost_us": t.cost_us}
            for t in transfers(problem, after.units)
        ],
    }


def _plan(part: PlanPart) -> Plan:
    return Plan(
        part.planner,
        Status(part.status),
        None if part.change_set is None else changes_of(part.change_set.model_dump()),
        part.cost_us,
        part.bound_us,
        part.reasons,
        tuple(part.unused_required),
        part.ties_proven,
        part.required_proven,
        tuple(part.undecided),
        _floats(part.seconds),
        part.counts,
        tuple(Measured(Objective(one.objective), one.value, one.bound) for one in part.objectives),
    )


def _floats(values: Mapping[str, Any]) -> dict[str, float]:
    return {name: float(value) for name, value in values.items() if not isinstance(value, str | list | dict | None)}
