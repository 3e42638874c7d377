"""Environments as plain data in the environment file's form: the way back from the domain."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from decimal import Decimal
from typing import Any

from cfgplan.costs import seconds
from cfgplan.domain import (
    ComputationUnit,
    Environment,
    Host,
    InputPort,
    OutputPort,
    RunOptions,
    Target,
    Transformation,
)
from cfgplan.formats.environment_file import ANY_IMPORT
from cfgplan.formats.schema import FORMAT, IGNORE
from cfgplan.formats.templates import escape
from cfgplan.planning import Failures
from cfgplan.qualities import Better, Contribution, Over, QualityAttribute, Wish, units


def plain_environment(
    environment: Environment,
    *,
    horizon_s: int,
    max_cost_us: int | None = None,
    ontology: Iterable[str] = (),
    survive: Failures | None = None,
    imports: Mapping[str, str | None] | None = None,
) -> dict[str, Any]:
    """What an environment file says, as mappings and lists; costs are Decimal or int.

    Loading it gives the same environment back. `ontology` holds paths as the file is to name them, `imports` the path
    of each IRI, or None where that import is ignored, with ANY_IMPORT for every one that can't be found.
    """
    ontologies = list(ontology)
    return _without_nothing(
        {
            "format": FORMAT,
            "ontology": ontologies[0] if len(ontologies) == 1 else ontologies,
            "imports": _imports(imports or {}),
            "horizon": horizon_s,
            "max_cost": None if max_cost_us is None else plain_cost(max_cost_us),
            "hosts": [_host(host) for host in environment.hosts],
            "transfer": plain_cost(environment.transfer_us) if environment.transfer_us else None,
            "qualities": [_attribute(attribute) for attribute in environment.qualities],
            "survive": None if survive is None else survive.value,
            "transformations": [_transformation(t, environment) for t in environment.library],
            "units": [plain_unit(unit) for unit in environment.units],
            "targets": [_target(target, environment) for target in environment.targets],
        }
    )


def _imports(imports: Mapping[str, str | None]) -> str | dict[str, str]:
    if ANY_IMPORT in imports:
        return IGNORE
    return {iri: IGNORE if path is None else path for iri, path in imports.items()}


def plain_cost(cost_us: int) -> Decimal | int:
    """A cost in CPU seconds, whole where it is."""
    value = seconds(cost_us)
    return int(value) if value == value.to_integral_value() else value


def plain_quality(micro: int) -> Decimal | int:
    """A value of a quality attribute, whole where it is."""
    value = units(micro)
    return int(value) if value == value.to_integral_value() else value


def _transformation(transformation: Transformation, environment: Environment) -> dict[str, Any]:
    return _without_nothing(
        {
            "label": escape(transformation.label),
            "source": _escaped(transformation.source),
            "kind": _escaped(transformation.kind),
            "host": _escaped(transformation.host) or [escape(host) for host in transformation.hosts],
            "params": _escaped_inside(dict(transformation.params)),
            "labor": plain_cost(transformation.labor_us),
            "upkeep": plain_cost(transformation.upkeep_us),
            "pinned": transformation.pinned,
            "required": transformation.required,
            "memory": transformation.memory_mb,
            "conflicts": [escape(other) for other in transformation.conflicts],
            "min_instances": transformation.min_instances or None,
            "max_instances": transformation.max_instances,
            "standby": None if transformation.standby_us is None else plain_cost(transformation.standby_us),
            "run": _run_options(transformation.run),
            "inputs": {escape(port.name): _input(port) for port in transformation.inputs},
            "outputs": {escape(port.name): _output(port, environment) for port in transformation.outputs},
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


def _output(port: OutputPort, environment: Environment) -> Any:
    if not (port.quality or port.rate_uhz or port.size_bytes):
        return escape(port.tag)
    return _without_nothing(
        {
            "tag": escape(port.tag),
            "quality": {q.attribute: _contribution(q, environment) for q in port.quality},
            "rate": plain_quality(port.rate_uhz) if port.rate_uhz else None,
            "size": port.size_bytes or None,
        }
    )


def _contribution(contribution: Contribution, environment: Environment) -> Any:
    attribute = environment.quality.get(contribution.attribute)
    value = plain_quality(contribution.value)
    if attribute is not None and attribute.rule is contribution.rule and contribution.over is Over.WORST:
        return value
    over = {} if contribution.over is Over.WORST else {"of": contribution.over.value}
    return {contribution.rule.value: value, **over}


def _host(host: Host) -> dict[str, Any]:
    cpu = None if host.cpu_us is None else plain_cost(host.cpu_us)
    return _without_nothing({"name": host.name, "cpu": cpu, "memory": host.memory_mb})


def _attribute(attribute: QualityAttribute) -> dict[str, Any]:
    usual = QualityAttribute(attribute.name, attribute.better)
    return _without_nothing(
        {
            "name": attribute.name,
            "better": attribute.better.value,
            "rule": None if attribute.rule is usual.rule else attribute.rule.value,
            "unit": attribute.unit,
            "worst": None if attribute.worst == usual.worst else plain_quality(attribute.worst),
            "best": None if attribute.best == usual.best else plain_quality(attribute.best),
        }
    )


def _wish(wish: Wish, environment: Environment) -> dict[str, Any]:
    is_low = environment.quality[wish.attribute].better is Better.LOWER
    return _without_nothing(
        {
            "at_most" if is_low else "at_least": None if wish.bound is None else plain_quality(wish.bound),
            "weight": plain_cost(wish.weight_us) if wish.weight_us else None,
        }
    )


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
            "host": unit.host,
            "standby": unit.standby,
        }
    )


def _target(target: Target, environment: Environment) -> dict[str, Any]:
    return _without_nothing(
        {
            "label": target.label,
            "topic": target.topic,
            "tag": target.tag,
            "priority": target.priority if target.priority else None,
            "quality": {wish.attribute: _wish(wish, environment) for wish in target.quality},
            "host": target.host,
            "silent": None if target.silent_us is None else plain_cost(target.silent_us),
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
