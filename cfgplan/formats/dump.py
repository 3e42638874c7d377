"""Environments and documents as plain data in the environment file's form, and as equivalent YAML or XML."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from decimal import Decimal
from typing import Any

import yaml

from cfgplan import domain
from cfgplan.errors import InputError
from cfgplan.facts import Fact, FactValue
from cfgplan.formats import fields
from cfgplan.formats.document import Document
from cfgplan.formats.environment_file import ANY_IMPORT
from cfgplan.formats.scalars import resolve
from cfgplan.formats.schema_values import plain_cost, plain_quality
from cfgplan.formats.templates import escaped
from cfgplan.formats.xml_dump import dump_xml
from cfgplan.planning import Failures
from cfgplan.qualities import Better, Contribution, Over, QualityAttribute, Wish

_LISTS = ("transformations", "units", "targets")
_DUMPER: Any = getattr(yaml, "CSafeDumper", yaml.SafeDumper)


def dump_yaml(data: object) -> str:
    """Return plain data as YAML text; Decimal is written exactly, and a text that looks like another type is quoted."""
    text: str = yaml.dump(data, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=2**20)
    return text


def as_yaml(document: Document) -> str:
    """Return a document as one equivalent YAML file, with its includes written into it. Raises InputError."""
    return dump_yaml(plain_document(document))


def as_xml(document: Document) -> str:
    """Return a document as one equivalent XML file, with its includes written into it. Raises InputError."""
    return dump_xml(plain_document(document))


def plain_document(document: Document) -> dict[str, Any]:
    """A document and its includes as one mapping, as written: nothing is expanded. Raises InputError."""
    if document.faults:
        raise InputError(document.faults)
    whole: dict[str, Any] = {"format": fields.FORMAT}
    for number, file in enumerate(document.files):
        data = file.source.data
        assert isinstance(data, dict)
        if number == 0:
            whole |= {key: value for key, value in data.items() if key not in (*_LISTS, "include")}
        for key in _LISTS:
            if data.get(key):
                whole.setdefault(key, []).extend(data[key])
    return whole


def plain_environment(
    environment: domain.Environment,
    *,
    horizon_s: int,
    max_cost_us: int | None = None,
    ontology: Iterable[str] = (),
    survive: Failures | None = None,
    imports: Mapping[str, str | None] | None = None,
    ignores_rules: bool = False,
    preferred: Iterable[str] = (),
) -> dict[str, Any]:
    """An environment as the mappings and lists of an environment file; costs are Decimal or int.

    Loading it gives the same environment back. `ontology` holds paths as the file is to name them, `imports` the path
    of each IRI, or None where that import is ignored, with ANY_IMPORT for every one that can't be found.
    """
    return fields.EnvironmentPart.written(
        environment,
        format=fields.FORMAT,
        ontology=_one_or_all(ontology),
        imports=_imports(imports or {}),
        rules=fields.IGNORE if ignores_rules else None,
        prefer=_one_or_all(preferred),
        horizon=horizon_s,
        max_cost=None if max_cost_us is None else plain_cost(max_cost_us),
        defaults=None,
        include=None,
        hosts=[fields.HostPart.written(host, copies=None) for host in environment.hosts],
        links=[fields.LinkPart.written(link) for link in environment.links],
        qualities=[_attribute(attribute) for attribute in environment.qualities],
        facts={fact.name: _fact(fact) for fact in environment.facts},
        survive=None if survive is None else survive.value,
        transformations=[_transformation(t, environment) for t in environment.library],
        units=[plain_unit(unit) for unit in environment.units],
        targets=[
            _target(target, environment)
            for target in environment.targets
            if target not in map(domain.observing, environment.variable.values())
        ],
    )


def _fact(fact: Fact) -> dict[str, Any]:
    """A fact with its present values as the declared ones."""

    def plain(value: FactValue) -> object:
        return fields.FactPart.plain("declared", replace(fact, declared=value, hosts={}))

    hosts = {host: plain(value) for host, value in {**fact.hosts, **fact.now_on}.items() if value != fact.value}
    return fields.FactPart.written(fact, declared=plain(fact.value), hosts=hosts)


def _one_or_all(names: Iterable[str]) -> str | list[str]:
    """A single name as a text, others as a list."""
    found = list(names)
    return found[0] if len(found) == 1 else found


def _imports(imports: Mapping[str, str | None]) -> str | dict[str, str]:
    if ANY_IMPORT in imports:
        return fields.IGNORE
    return {iri: fields.IGNORE if path is None else path for iri, path in imports.items()}


def _transformation(transformation: domain.Transformation, environment: domain.Environment) -> dict[str, Any]:
    """A transformation, with every `${` in its texts escaped."""
    said: dict[str, Any] = escaped(
        fields.TransformationPart.written(
            transformation,
            host=transformation.host or list(transformation.hosts),
            conflicts=_conflicts(transformation),
            run=fields.RunPart.written(transformation.run),
            inputs={port.name: _port(_input(port)) for port in transformation.inputs},
            outputs={port.name: _port(_output(port, environment)) for port in transformation.outputs},
        )
    )
    return said


def _conflicts(transformation: domain.Transformation) -> Any:
    if transformation.conflicts_on_host:
        return fields.ConflictsPart.written(transformation)
    return list(transformation.conflicts)


def _input(port: domain.InputPort) -> dict[str, Any]:
    return fields.InputPart.written(port, **({"feedback": None} if port.service else {}))


def _output(port: domain.OutputPort, environment: domain.Environment) -> dict[str, Any]:
    return fields.OutputPart.written(port, quality={q.attribute: _contribution(q, environment) for q in port.quality})


def _port(said: dict[str, Any]) -> Any:
    return said["tag"] if len(said) == 1 else said


def _contribution(contribution: Contribution, environment: domain.Environment) -> Any:
    attribute = environment.quality.get(contribution.attribute)
    value: Any = plain_quality(contribution.value)
    if contribution.by is not None:
        points = [[plain_quality(fact), plain_quality(one)] for fact, one in contribution.by.points]
        value = fields.CurvePart.written(contribution.by, by=contribution.by.fact, points=points)
    if (
        contribution.by is None
        and attribute is not None
        and attribute.rule is contribution.rule
        and contribution.over is Over.WORST
        and contribution.observe is None
    ):
        return value
    over = {} if contribution.over is Over.WORST else {"of": contribution.over.value}
    observe = {} if contribution.observe is None else {"observe": contribution.observe}
    return {contribution.rule.value: value, **over, **observe}


def _attribute(attribute: QualityAttribute) -> dict[str, Any]:
    usual = QualityAttribute(attribute.name, attribute.better)
    scale = {key: None for key in ("worst", "best") if getattr(attribute, key) == getattr(usual, key)}
    return fields.AttributePart.written(attribute, **scale)


def _wish(wish: Wish, environment: domain.Environment) -> dict[str, Any]:
    is_low = environment.quality[wish.attribute].better is Better.LOWER
    return fields.WishPart.written(wish, **{"at_least" if is_low else "at_most": None})


def plain_unit(unit: domain.ComputationUnit) -> dict[str, Any]:
    """Return a unit in the form of an environment file."""
    topics: dict[str, list[str]] = {}
    for publication in unit.publications:
        topics.setdefault(publication.port, []).append(publication.topic)
    inputs = {port: one_or_more([str(stream) for stream in streams]) for port, streams in unit.feeds.items()}
    return fields.UnitPart.written(unit, inputs=inputs, topics=topics)


def unit_of(said: Mapping[str, Any]) -> domain.ComputationUnit:
    """The unit that a mapping describes, the reverse of `plain_unit`."""
    fed = ((port, [of] if isinstance(of, str) else of) for port, of in said.get("inputs", {}).items())
    return domain.ComputationUnit(
        said["id"],
        said["transformation"],
        tuple(domain.Subscription(port, domain.Stream.parse(stream)) for port, streams in fed for stream in streams),
        tuple(domain.Publication(port, topic) for port, topics in said.get("topics", {}).items() for topic in topics),
        said.get("host"),
        said.get("standby", False),
    )


def changes_of(said: Mapping[str, Any]) -> domain.ChangeSet:
    """The change set that a mapping describes, as a plan file has it under `change_set`."""
    started, rewired = (tuple(map(unit_of, said[key])) for key in ("started", "rewired"))
    return domain.ChangeSet(started, rewired, tuple(said["stopped"]))


def one_or_more(texts: list[str]) -> str | list[str]:
    """One text by itself, or a list."""
    return texts[0] if len(texts) == 1 else texts


def _target(target: domain.Target, environment: domain.Environment) -> dict[str, Any]:
    """A target, with every `${` in its texts escaped."""
    stream = {} if target.run is None else {"tag": None, "topic": None}
    wishes = {wish.attribute: _wish(wish, environment) for wish in target.quality}
    said: dict[str, Any] = escaped(fields.TargetPart.written(target, **stream, quality=wishes))
    return said


class _Dumper(_DUMPER):  # type: ignore[misc]
    """PyYAML's dumper, which quotes plain scalars by the rules of our reader."""

    def ignore_aliases(self, data: object) -> bool:  # noqa: ARG002
        return True


def _text(dumper: Any, text: str) -> yaml.ScalarNode:
    is_safe = isinstance(resolve(text), str) and text != "<<"
    node: yaml.ScalarNode = dumper.represent_scalar("tag:yaml.org,2002:str", text, style=None if is_safe else '"')
    return node


def _number(dumper: Any, number: Decimal) -> yaml.ScalarNode:
    text = format(number, "f")
    written = text if "." in text else f"{text}.0"
    node: yaml.ScalarNode = dumper.represent_scalar("tag:yaml.org,2002:float", written)
    return node


_Dumper.add_representer(str, _text)
_Dumper.add_representer(Decimal, _number)
