"""From a document to an environment: templates expanded, every tag and every reference checked."""

from __future__ import annotations

from collections.abc import Iterator

from cfgplan.domain import Environment, Target, Transformation
from cfgplan.errors import Fault, InputError
from cfgplan.formats.document import Document, File
from cfgplan.formats.environment_file import EnvironmentFile
from cfgplan.formats.expansion import Expander
from cfgplan.formats.fleet import FleetReader
from cfgplan.formats.garbage import no_garbage_collection
from cfgplan.formats.left_out import LeftOut
from cfgplan.formats.places import Path, Source
from cfgplan.formats.references import UnitChecker
from cfgplan.formats.suggestions import did_you_mean
from cfgplan.formats.tags import TagChecker, TagVocabulary

Origins = dict[tuple[str, str], tuple[Source, Path]]


def build(document: Document, vocabulary: TagVocabulary) -> EnvironmentFile:
    """The environment that a document describes; raises InputError with every fault of both stages."""
    with no_garbage_collection():
        return _build(document, vocabulary)


def _build(document: Document, vocabulary: TagVocabulary) -> EnvironmentFile:
    faults = list(document.faults)
    origins: Origins = {}
    left_out = LeftOut(document)
    tags = TagChecker(vocabulary, faults)
    fleet = FleetReader(document, left_out, faults)
    expander = Expander(document.header.defaults, vocabulary, tags, fleet, left_out, faults)
    library = _library(document, expander, origins, faults)
    targets = _targets(document, tags, fleet, origins, faults)
    units = UnitChecker(document, left_out, library, targets, fleet, origins, faults).units()
    _check_conflicts(library, left_out, origins, faults)
    for file in document.files:
        _check_broken_tags(file, tags)
    if faults:
        raise InputError(_in_file_order(faults, document))
    environment = Environment(
        tuple(units),
        tuple(library.values()),
        tuple(targets.values()),
        tuple(fleet.hosts.values()),
        tuple(fleet.attributes.values()),
        document.header.transfer,
    )
    return EnvironmentFile(
        document.path,
        environment,
        document.header.horizon,
        document.header.max_cost,
        document.ontology_paths,
        fleet.survive,
        document.imports,
        origins,
    )


def _library(
    document: Document, expander: Expander, origins: Origins, faults: list[Fault]
) -> dict[str, Transformation]:
    library: dict[str, Transformation] = {}
    for file in document.files:
        for index, part in file.transformations:
            path = ("transformations", index)
            for transformation in expander.expand(file.source, path, part):
                if _is_new(("transformation", transformation.label), file.source, path, "label", origins, faults):
                    library[transformation.label] = transformation
    return library


def _targets(
    document: Document, tags: TagChecker, fleet: FleetReader, origins: Origins, faults: list[Fault]
) -> dict[str, Target]:
    targets: dict[str, Target] = {}
    topics: Origins = {}
    for file in document.files:
        for index, part in file.targets:
            path = ("targets", index)
            tags.check(part.tag, file.source, (*path, "tag"))
            is_new = _is_new(("target", part.label), file.source, path, "label", origins, faults)
            if _is_new(("topic", part.topic), file.source, path, "topic", topics, faults) and is_new:
                wishes = fleet.wishes(file.source, path, part)
                if part.host is not None:
                    fleet.check_host(file.source, (*path, "host"), part.host, is_choice=True)
                targets[part.label] = Target(**{**part.values(), "quality": wishes})
    return targets


def _check_conflicts(
    library: dict[str, Transformation], left_out: LeftOut, origins: Origins, faults: list[Fault]
) -> None:
    for transformation in library.values():
        for other in transformation.conflicts:
            source, path = origins["transformation", transformation.label]
            if other == transformation.label:
                mend = "write `max_instances: 1` if only one unit may be there"
                faults.append(source.fault((*path, "conflicts"), f"`{other}` conflicts with itself", mend))
            elif other not in library and not left_out.may_have("transformations", other):
                mend = did_you_mean(other, library, "write the label of another transformation, templates expanded")
                faults.append(source.fault((*path, "conflicts"), f"there is no transformation `{other}`", mend))


def _check_broken_tags(file: File, tags: TagChecker) -> None:
    """Check the plain tags of parts that were left out, so that all their faults are told at once."""
    for kind, parts in file.broken.items():
        for part in parts:
            if part.index is not None:
                raw = file.source.data[kind][part.index]  # type: ignore[index]
                for path, tag in _tags_in(raw, (kind, part.index)):
                    if isinstance(tag, str) and tag and "$" not in tag:
                        tags.check(tag, file.source, path)


def _tags_in(raw: object, path: Path) -> Iterator[tuple[Path, object]]:
    if isinstance(raw, dict):
        yield (*path, "tag"), raw.get("tag")
        for key in ("inputs", "outputs"):
            ports = raw.get(key)
            for name, port in ports.items() if path[0] == "transformations" and isinstance(ports, dict) else ():
                yield (
                    ((*path, key, name, "tag"), port.get("tag"))
                    if isinstance(port, dict)
                    else ((*path, key, name), port)
                )


def _is_new(name: tuple[str, str], source: Source, path: Path, key: str, origins: Origins, faults: list[Fault]) -> bool:
    if name not in origins:
        origins[name] = (source, path)
        return True
    first_source, first_path = origins[name]
    first = first_source.place(first_path)
    what = "topic" if name[0] == "topic" else f"{name[0]} label"
    message = f"the {what} `{name[1]}` is taken: it stands in {first.file}, line {first.line} already"
    if (first_source.file, first_path) == (source.file, path):
        message = f"several expansions of this template have the label `{name[1]}`"
    faults.append(source.fault((*path, key), message, "give each a name of its own"))
    return False


def _in_file_order(faults: list[Fault], document: Document) -> list[Fault]:
    order: dict[str, int] = {}
    for file in document.files:
        order.setdefault(file.source.file, len(order))
    last = len(order)
    return sorted(dict.fromkeys(faults), key=lambda f: (order.get(f.file or "", last), f.line or 0, f.column or 0))
