"""Environments as plain data in the environment file's form: the way back from the domain."""

from __future__ import annotations

from collections.abc import Iterable
from decimal import Decimal
from typing import Any

from cfgplan.costs import seconds
from cfgplan.domain import ComputationUnit, Environment, InputPort, RunOptions, Target, Transformation
from cfgplan.formats.schema import FORMAT
from cfgplan.formats.templates import escape


def plain_environment(
    environment: Environment, *, horizon_s: int, max_cost_us: int | None = None, ontology: Iterable[str] = ()
) -> dict[str, Any]:
    """What an environment file says, as mappings and lists; costs are Decimal or int.

    Loading it gives the same environment back. `ontology` holds paths as the file is to name them.
    """
    ontologies = list(ontology)
    return _without_nothing(
        {
            "format": FORMAT,
            "ontology": ontologies[0] if len(ontologies) == 1 else ontologies,
            "horizon": horizon_s,
            "max_cost": None if max_cost_us is None else plain_cost(max_cost_us),
            "transformations": [_transformation(t) for t in environment.library],
            "units": [plain_unit(unit) for unit in environment.units],
            "targets": [_target(target) for target in environment.targets],
        }
    )


def plain_cost(cost_us: int) -> Decimal | int:
    """A cost in CPU seconds, whole where it is."""
    value = seconds(cost_us)
    return int(value) if value == value.to_integral_value() else value


def _transformation(transformation: Transformation) -> dict[str, Any]:
    return _without_nothing(
        {
            "label": escape(transformation.label),
            "source": _escaped(transformation.source),
            "kind": _escaped(transformation.kind),
            "host": _escaped(transformation.host),
            "params": _escaped_inside(dict(transformation.params)),
            "labor": plain_cost(transformation.labor_us),
            "upkeep": plain_cost(transformation.upkeep_us),
            "pinned": transformation.pinned,
            "required": transformation.required,
            "run": _run_options(transformation.run),
            "inputs": {escape(port.name): _input(port) for port in transformation.inputs},
            "outputs": {escape(port.name): escape(port.tag) for port in transformation.outputs},
        }
    )


def _run_options(run: RunOptions) -> dict[str, Any]:
    usual = RunOptions()
    return _without_nothing(
        {
            "start": None if run.start == usual.start else escape(run.start),
            "tolerance": plain_cost(run.tolerance_us) if run.tolerance_us else None,
            "rate": None if run.rate_hz is None else Decimal(repr(run.rate_hz)),
            "queue": None if run.queue == usual.queue else run.queue,
            "when_full": "block" if run.blocks else None,
            "hang": None if run.hang_us is None else plain_cost(run.hang_us),
            "memory": run.memory_mb,
            "state": run.state,
        }
    )


def _input(port: InputPort) -> Any:
    if port.distinct is None and not port.feedback:
        return escape(port.tag)
    return _without_nothing({"tag": escape(port.tag), "distinct": _escaped(port.distinct), "feedback": port.feedback})


def plain_unit(unit: ComputationUnit) -> dict[str, Any]:
    """A unit as an environment file says it."""
    topics: dict[str, list[str]] = {}
    for publication in unit.publications:
        topics.setdefault(publication.port, []).append(publication.topic)
    return _without_nothing(
        {
            "id": unit.id,
            "transformation": unit.transformation,
            "inputs": {subscription.port: str(subscription.stream) for subscription in unit.subscriptions},
            "topics": topics,
        }
    )


def _target(target: Target) -> dict[str, Any]:
    return _without_nothing(
        {
            "label": target.label,
            "topic": target.topic,
            "tag": target.tag,
            "priority": target.priority if target.priority else None,
        }
    )


def _escaped(text: str | None) -> str | None:
    return None if text is None else escape(text)


def _escaped_inside(value: Any) -> Any:
    if isinstance(value, str):
        return escape(value)
    if isinstance(value, dict):
        return {escape(key): _escaped_inside(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_escaped_inside(item) for item in value]
    return value


def _without_nothing(mapping: dict[str, Any]) -> dict[str, Any]:
    """A mapping without the keys that say what is so anyway."""
    return {key: value for key, value in mapping.items() if not (value is None or value is False or value in ([], {}))}
