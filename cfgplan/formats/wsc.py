"""Sets of the Web Service Challenge 2008 as environments.

A service is a transformation that costs 1 CPU second of labor; a provided instance is one that costs nothing; each
wanted instance is a target. So the cheapest update is the composition with the fewest services.

For the shortest length the services are unrolled by layers: a service at layer k uses instances available by layer k -
1. Its tags are intersections such as `con12 and by3`, where by0 is below by1, by1 below by2, and so on. A forward
closure gives the number of layers; the cheapest update is then the composition with the fewest services among the
shortest ones.
"""

from __future__ import annotations

import os
from collections import defaultdict
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Literal

from cfgplan.domain import Environment, InputPort, OutputPort, Similarity, Target, Transformation
from cfgplan.formats.dump import dump_yaml, plain_environment
from cfgplan.formats.environment_file import EnvironmentFile
from cfgplan.formats.wsc_files import Service, TestSet, read_test_set

WscObjective = Literal["services", "length"]
SERVICE_LABOR_US = 1_000_000
_WSC_IRI = "urn:cfgplan:wsc#"


def read_wsc(
    folder: str | os.PathLike[str], objective: WscObjective = "services"
) -> tuple[EnvironmentFile, Similarity]:
    """The environment of a set (a folder with taxonomy.xml, services.xml, problem.xml) and its matching relation.

    With the objective "length" only compositions of the shortest length are possible; where none is possible at
    all, the environment is that of "services". Raises InputError.
    """
    test_set = read_test_set(Path(folder))
    environment = _environment(test_set, objective)
    return EnvironmentFile(Path(folder), environment, horizon_s=0), _similarity(environment, test_set)


def wsc_texts(
    folder: str | os.PathLike[str], objective: WscObjective = "services", *, ontology: str = "taxonomy.ofn"
) -> tuple[str, str]:
    """A set as an environment file (YAML) and the ontology file (OWL functional syntax) that it refers to.

    `ontology` is the ontology file as the environment file is to name it. Raises InputError.
    """
    test_set = read_test_set(Path(folder))
    environment = _environment(test_set, objective)
    plain = plain_environment(environment, horizon_s=0, ontology=[ontology])
    return dump_yaml(plain), _ontology(test_set, environment)


def shortest_length(test_set: TestSet) -> int | None:
    """Return the fewest layers of services that make all wanted instances; None if no composition does."""
    first = _first_layers(test_set)
    layers = [first.get(test_set.concept[instance]) for instance in test_set.wanted]
    return None if None in layers else max((layer for layer in layers if layer is not None), default=0)


def _environment(test_set: TestSet, objective: WscObjective) -> Environment:
    length = shortest_length(test_set) if objective == "length" else None
    last = "" if length is None else _by(length)
    return Environment(
        library=(_provided(test_set, length), *_services(test_set, length)),
        targets=tuple(
            Target(instance, test_set.concept[instance] + last, f"/wanted/{instance}") for instance in test_set.wanted
        ),
    )


def _provided(test_set: TestSet, length: int | None) -> Transformation:
    start = "" if length is None else _by(0)
    taken = {service.name for service in test_set.services}
    label = next(label for label in _labels("provided") if label not in taken)
    given = tuple(OutputPort(instance, test_set.concept[instance] + start) for instance in test_set.provided)
    return Transformation(label, outputs=given, labor_us=0)


def _labels(label: str) -> Iterator[str]:
    while True:
        yield label
        label += "_"


def _services(test_set: TestSet, length: int | None) -> Iterator[Transformation]:
    """One transformation for each service, or one for each layer from which the wanted can still be reached in time."""
    if length is None:
        for service in test_set.services:
            yield _transformation(service, test_set, service.name, "", "")
        return
    first, last = _first_layers(test_set), _last_layers(test_set, length)
    for service in test_set.services:
        ready = [first.get(test_set.concept[instance]) for instance in service.inputs]
        if None in ready:
            continue
        begin = 1 + max((layer for layer in ready if layer is not None), default=0)
        end = max((last.get(c, 0) for i in service.outputs for c in test_set.above(test_set.concept[i])), default=0)
        for layer in range(begin, end + 1):
            yield _transformation(service, test_set, f"{service.name}@{layer}", _by(layer - 1), _by(layer))


def _transformation(service: Service, test_set: TestSet, label: str, needs: str, gives: str) -> Transformation:
    # Some services give an instance that they need: the ports of a transformation share their names.
    return Transformation(
        label,
        tuple(InputPort(f"in_{instance}", test_set.concept[instance] + needs) for instance in service.inputs),
        tuple(OutputPort(f"out_{instance}", test_set.concept[instance] + gives) for instance in service.outputs),
        SERVICE_LABOR_US,
    )


def _by(layer: int) -> str:
    return f" and by{layer}"


def _first_layers(test_set: TestSet) -> dict[str, int]:
    """Return, for each reachable concept, the first layer after which it is available (0: provided)."""
    first: dict[str, int] = {}
    fresh = {c for instance in test_set.provided for c in test_set.above(test_set.concept[instance])}
    needing: dict[str, list[Service]] = defaultdict(list)
    missing: dict[str, int] = {}
    ahead = [service for service in test_set.services if not service.inputs]
    for service in test_set.services:
        needs = {test_set.concept[instance] for instance in service.inputs}
        missing[service.name] = len(needs)
        for concept in needs:
            needing[concept].append(service)
    layer = 0
    while fresh or ahead:
        first.update(dict.fromkeys(fresh, layer))
        for concept in fresh:
            for service in needing[concept]:
                missing[service.name] -= 1
                if not missing[service.name]:
                    ahead.append(service)
        made = {c for service in ahead for i in service.outputs for c in test_set.above(test_set.concept[i])}
        fresh, ahead, layer = made - first.keys(), [], layer + 1
    return first


def _last_layers(test_set: TestSet, length: int) -> dict[str, int]:
    """For each concept of use, the last layer whose services may still make it."""
    last = {test_set.concept[instance]: length for instance in test_set.wanted}
    makers: dict[str, list[Service]] = defaultdict(list)
    for service in test_set.services:
        for concept in {c for i in service.outputs for c in test_set.above(test_set.concept[i])}:
            makers[concept].append(service)
    for layer in range(length, 1, -1):
        useful = (service for concept in [c for c, at in last.items() if at == layer] for service in makers[concept])
        for service in useful:
            for instance in service.inputs:
                last.setdefault(test_set.concept[instance], layer - 1)
    return last


def _similarity(environment: Environment, test_set: TestSet) -> Similarity:
    """The similarity by taxonomy and order of layers, read off the tags."""
    offered: dict[str, dict[int, str]] = defaultdict(dict)
    for transformation in environment.library:
        for port in transformation.outputs:
            concept, layer = _parts(port.tag)
            offered[concept][layer] = port.tag
    below: dict[str, list[Mapping[int, str]]] = defaultdict(list)
    for concept, tags in offered.items():
        for higher in test_set.above(concept):
            below[higher].append(tags)
    demanded = {port.tag for transformation in environment.library for port in transformation.inputs}
    demanded.update(target.tag for target in environment.targets)
    offers = {}
    for tag in demanded:
        concept, by = _parts(tag)
        offers[tag] = frozenset(text for tags in below.get(concept, ()) for layer, text in tags.items() if layer <= by)
    return Similarity(offers)


def _parts(tag: str) -> tuple[str, int]:
    concept, _, layer = tag.partition(" and by")
    return concept, int(layer or 0)


def _ontology(test_set: TestSet, environment: Environment) -> str:
    """The taxonomy and the order of the layers in OWL functional syntax."""
    tags = {port.tag for transformation in environment.library for port in transformation.outputs}
    tags.update(target.tag for target in environment.targets)
    layers = range(1 + max(layer for _, layer in map(_parts, tags))) if any(" and by" in tag for tag in tags) else ()
    names = [*test_set.parent, *(f"by{layer}" for layer in layers)]
    orders = [(concept, higher) for concept, higher in test_set.parent.items() if higher is not None]
    orders += [(f"by{layer - 1}", f"by{layer}") for layer in layers[1:]]
    lines = [f"Prefix(:=<{_WSC_IRI}>)", "Ontology(<urn:cfgplan:wsc>"]
    lines += (f"  Declaration(Class(:{name}))" for name in names)
    lines += (f"  SubClassOf(:{lower} :{higher})" for lower, higher in orders)
    return "\n".join([*lines, ")", ""])
