"""Reports and snapshots as plain records, for the control socket, JSON lines and recordings.

Times are in seconds, costs in microseconds of CPU time, and names say so. Every `kind` is the name of a type in
`cfgplan_runtime.lifecycle` or `cfgplan_runtime.supervision.events`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from typing import Any

import msgspec

from cfgplan.domain import ChangeSet, ComputationUnit, Environment, Stream
from cfgplan.facts import value_text
from cfgplan.formats.dump import plain_unit
from cfgplan.qualities import MICRO
from cfgplan.unmet import reason_record
from cfgplan_runtime.lifecycle import reports
from cfgplan_runtime.lifecycle.kinds import Urgency, kind_of, review_sentence
from cfgplan_runtime.lifecycle.perturbations import Perturbation
from cfgplan_runtime.lifecycle.review_sentences import unmet_says
from cfgplan_runtime.operating.protocol import Record
from cfgplan_runtime.supervision.run_log import RunLog


def snapshot_record(snapshot: reports.Snapshot, flows: Mapping[str, Record] | None = None) -> Record:
    """The state of a run; `flows` has rate and latency by topic, where they are measured."""
    return {
        "phase": snapshot.phase.value,
        "horizon_s": snapshot.horizon_s,
        "horizon_left_s": _number(snapshot.horizon_left_s),
        "cost_us": snapshot.cost_us,
        "saving_us": snapshot.saving_us,
        "targets": [_target(target, (flows or {}).get(target.topic)) for target in snapshot.targets],
        "units": [_unit(unit, snapshot.environment) for unit in snapshot.units],
        "transformations": [transformation.label for transformation in snapshot.environment.library],
        "pending": [plain(perturbation) for perturbation in snapshot.pending],
        "reviews": [review_record(review) for review in snapshot.reviews],
        "backing_off": [plain(backing_off) for backing_off in snapshot.backing_off],
        "hosts": [host.name for host in snapshot.environment.hosts],
        "lost_hosts": list(snapshot.lost_hosts),
        "facts": {fact.key: value_text(fact.value) for fact in snapshot.facts},
        "facts_heard_s": {name: round(ago_s, 3) for name, ago_s in snapshot.facts_heard_s.items()},
        "left_out": dict(snapshot.left_out),
        "barred": {label: dict(hosts) for label, hosts in snapshot.barred.items()},
        "qualities_now": dict(snapshot.qualities_now),
        "qualities": [_quality(view) for view in snapshot.qualities],
        "clocks_ahead_us": dict(snapshot.clocks_ahead_us),
        "declared": list(snapshot.declared),
        "removed": list(snapshot.removed),
        "faults": [plain(fault) for fault in snapshot.faults],
        "old_code": {file: list(units) for file, units in snapshot.old_code.items()},
    }


def _quality(view: reports.QualityView) -> Record:
    """The learned quality of an output, in units of the attribute."""
    return {
        "output": f"{view.transformation}/{view.output}",
        "attribute": view.attribute,
        **({"host": view.host} if view.host is not None else {}),
        **{
            key: value / MICRO
            for key, value in (
                ("declared", view.stated),
                ("planned", view.planned),
                ("estimate", view.estimate),
                ("error", view.error),
            )
        },
        "ago_s": round(view.ago_s, 3),
    }


def review_record(review: reports.Review) -> Record:
    """A review as a record; `says` is its sentence, `unmet_says` has each reason of unmet targets once, and its change
    set is as `change_record` gives it.
    """
    record = _fields(review)
    record["unmet_says"] = unmet_says(review.unmet)
    record["says"] = review_sentence(review)
    record["change_set"] = None if review.change_set is None else change_record(review.change_set)
    return record


def change_record(changes: ChangeSet) -> Record:
    """A change set as the plan file says it."""
    return {
        "started": [wired(unit) for unit in changes.started],
        "rewired": [wired(unit) for unit in changes.rewired],
        "stopped": list(changes.stopped),
    }


def report_record(report: reports.Report) -> Record:
    """A report as a record: its `kind` and its fields."""
    match report:
        case reports.UnitEvent(event, host):
            return {**_with_kind(event), **({} if host is None else {"host": host})}
        case reports.Reviewed(review):
            return {"kind": "Reviewed", **review_record(review)}
    return _with_kind(report)


def plain(value: Any) -> Any:
    """A value of the life-cycle as JSON data; infinite and unknown values are null."""
    match value:
        case Enum():
            return value.value
        case bool() | int() | None:
            return value
        case str():
            return str(value)  # a `Reason` keeps its data nowhere in JSON
        case float():
            return _number(value)
        case Stream():
            return str(value)
        case bytes():
            return len(value)
        case ChangeSet():
            return change_record(value)
        case Mapping():
            return {str(key): plain(item) for key, item in value.items()}
        case Perturbation():
            return _with_kind(value)
        case msgspec.Struct():
            return _fields(value)
        case list() | tuple() | set() | frozenset():
            return [plain(item) for item in value]
    if is_dataclass(value) and not isinstance(value, type):
        # `kind` is needed only if a value may be of several types. Faults and observations have it nevertheless.
        return _with_kind(value)
    return str(value)


def _with_kind(value: Any) -> Record:
    return {"kind": type(value).__name__, **_fields(value)}


def _fields(value: Any) -> Record:
    is_struct = isinstance(value, msgspec.Struct)
    names = value.__struct_fields__ if is_struct else [field.name for field in fields(value)]
    return {name: plain(getattr(value, name)) for name in names}


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _target(target: reports.TargetView, flow: Record | None) -> Record:
    record = {
        "label": target.label,
        "topic": target.topic or None,
        "tag": target.tag,
        "priority": target.priority,
        "met": target.is_met,
        "stream": None if target.stream is None else str(target.stream),
        "unit": target.unit,
        "reason": str(target.reason),
        "why": reason_record(target.reason) if target.reason else None,
    }
    return {**record, **(flow or {})}


def _unit(view: reports.UnitView, environment: Environment) -> Record:
    record = {**wired(view.unit), "host": view.host}
    transformation = environment.transformation.get(view.unit.transformation)
    if transformation is not None:
        record["outputs"] = [port.name for port in transformation.outputs]
    if view.unit.standby:
        record["prepared"] = view.is_prepared
    elif transformation is not None:
        feeds = view.unit.feeds
        record["unfed"] = [port.name for port in transformation.inputs if not port.takes(len(feeds.get(port.name, ())))]
    seen = view.observation
    if seen is not None:
        record |= {
            "pid": seen.pid,
            "labor_us": seen.labor_us,
            "upkeep_us": seen.upkeep_us,
            "memory_bytes": seen.memory_bytes,
            "steps": seen.steps,
            "steps_per_s": round(seen.steps_per_s, 3),
            "errors": seen.errors,
            "last_error": seen.last_error,
            "dropped": seen.dropped,
        }
    return record


def wired(unit: ComputationUnit) -> Record:
    return {"id": unit.id, "transformation": unit.transformation, "inputs": {}, "topics": {}, **plain_unit(unit)}


def logging_to(log: RunLog) -> Callable[[reports.Report], None]:
    """A listener for `Manager.listen` that writes every report but signs, such as the observations of each second."""

    def write(report: reports.Report) -> None:
        if kind_of(report).urgency is not Urgency.SIGN:
            says = report_record(report)
            log.write_line(says.pop("kind"), says)

    return write
