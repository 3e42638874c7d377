"""From a document to an environment: templates expanded, every tag and every reference checked."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from typing import Any

from cfgplan.domain import Environment, Objective, Target, Transformation
from cfgplan.errors import Fault, InputError, did_you_mean
from cfgplan.formats.document import Document, File
from cfgplan.formats.environment_file import EnvironmentFile
from cfgplan.formats.expansion import Expander
from cfgplan.formats.fields import OF_A_STREAM, TargetPart
from cfgplan.formats.fleet import FleetReader
from cfgplan.formats.garbage import no_garbage_collection
from cfgplan.formats.left_out import LeftOut
from cfgplan.formats.places import Passage
from cfgplan.formats.references import UnitChecker
from cfgplan.formats.tags import TagChecker, TagVocabulary


def build(document: Document, vocabulary: TagVocabulary) -> EnvironmentFile:
    """The environment that a document describes; raises InputError with every fault of both stages."""
    with no_garbage_collection():
        return _build(document, vocabulary)


def _build(document: Document, vocabulary: TagVocabulary) -> EnvironmentFile:
    faults = list(document.faults)
    left_out, tags = LeftOut(document), TagChecker(vocabulary)
    fleet = FleetReader(document, left_out, faults)
    expander = Expander(document.header.defaults, vocabulary, tags, fleet, left_out)
    names = _Names()
    library: dict[str, Transformation] = {}
    for entry, part in _parts(document, "transformations", faults):
        for transformation in expander.expand(entry, part):
            if names.is_new("transformation", transformation.label, entry, "label"):
                library[transformation.label] = transformation
    targets: dict[str, Target] = {}
    for entry, part in _parts(document, "targets", faults):
        is_new = names.is_new("target", part.label, entry, "label") & _wants_one_thing(entry, part)
        if part.tag is not None:
            tags.check(part.tag, entry.at("tag"))
        if part.topic is not None:
            is_new &= names.is_new("topic", part.topic, entry, "topic")
        if part.host is not None:
            fleet.check_host(entry.at("host"), part.host, is_choice=True)
        _check_labels(entry.at("run"), [part.run] if part.run else (), library, left_out)
        if is_new:
            targets[part.label] = Target(**{**part.values(), "quality": fleet.wishes(entry.at("quality"), part)})
    running = {
        part.id: (entry, part)
        for entry, part in _parts(document, "units", faults)
        if names.is_new("unit", part.id, entry, "id")
    }
    topics = {target.topic for target in targets.values() if target.run is None}
    units = UnitChecker(running, library, topics, fleet, left_out).units()
    _check_named(library, left_out, names.origins)
    for file in document.files:
        _check_broken_tags(file, tags, faults)
    if faults:
        raise InputError(_in_file_order(faults, document))
    environment = Environment(
        tuple(units),
        tuple(library.values()),
        tuple(targets.values()),
        tuple(fleet.hosts.values()),
        tuple(fleet.attributes.values()),
        document.header.transfer,
        fleet.links,
        tuple(map(Objective, dict.fromkeys(document.header.minimise))),
    )
    return EnvironmentFile(
        document.path,
        environment,
        document.header.horizon,
        document.header.max_cost,
        document.ontology_paths,
        fleet.survive,
        document.imports,
        names.origins,
    )


def _parts(document: Document, kind: str, faults: list[Fault]) -> Iterator[tuple[Passage, Any]]:
    """The transformations, targets or units of all files, each with where it stands."""
    for file in document.files:
        for index, part in getattr(file, kind):
            yield Passage(file.source, (kind, index), faults), part


def _wants_one_thing(entry: Passage, part: TargetPart) -> bool:
    """Whether a target says `topic` and `tag`, or else `run` and nothing that is said of a stream."""
    said = [key for key in OF_A_STREAM if getattr(part, key) is not None]
    if part.run is not None:
        for key in said:
            entry.at(key).note(f"a target with `run` wants no stream, so it has no `{key}`", "remove it", at_key=True)
        return not said
    missing = [key for key in ("topic", "tag") if key not in said]
    for key in missing:
        mend = f"add `{key}:` here" + ("" if said else ", or `run:` with the transformation that is to run")
        entry.note(f"the key `{key}` is missing", mend)
    return not missing


class _Names:
    """The names that are taken, by kind and name, with who took them."""

    def __init__(self) -> None:
        self.origins: dict[tuple[str, str], Passage] = {}

    def is_new(self, kind: str, name: str, entry: Passage, key: str) -> bool:
        """Take a name; False, and a fault, if it is taken."""
        if (kind, name) not in self.origins:
            self.origins[kind, name] = entry
            return True
        first = self.origins[kind, name]
        what = {"topic": "topic", "unit": "unit id"}.get(kind, f"{kind} label")
        message = f"the {what} `{name}` is taken: it stands in {first.place.file}, line {first.place.line} already"
        if first == entry:
            message = f"several expansions of this template have the label `{name}`"
        entry.at(key).note(message, "give each a name of its own")
        return False


def _check_named(
    library: dict[str, Transformation], left_out: LeftOut, origins: Mapping[tuple[str, str], Passage]
) -> None:
    for t in library.values():
        _check_labels(origins["transformation", t.label].at("with"), t.beside, library, left_out)
        entry = origins["transformation", t.label].at("conflicts")
        in_all = entry.at("system") if t.conflicts_on_host else entry
        for other in {t.label}.intersection(t.conflicts):
            in_all.note(f"`{other}` conflicts with itself", "write `max_instances: 1` if only one unit may be there")
        for other in {t.label}.intersection(t.conflicts_on_host):
            entry.at("host").note(f"`{other}` conflicts with itself", "write `per_host: 1`")
        for at, others in ((in_all, t.conflicts), (entry.at("host"), t.conflicts_on_host)):
            _check_labels(at, others, library, left_out)


def _check_labels(entry: Passage, labels: Iterable[str], library: Collection[str], left_out: LeftOut) -> None:
    """Note the labels that no transformation has."""
    for label in labels:
        if label not in library and not left_out.may_have("transformations", label):
            mend = did_you_mean(label, library, "write the label of a transformation, templates expanded")
            entry.note(f"there is no transformation `{label}`", mend)


def _check_broken_tags(file: File, tags: TagChecker, faults: list[Fault]) -> None:
    """Check the plain tags of parts that were left out, so that all their faults are told at once."""
    for kind, parts in file.broken.items():
        for part in parts:
            if part.index is not None:
                raw = file.source.data[kind][part.index]  # type: ignore[index]
                for entry, tag in _tags_in(raw, Passage(file.source, (kind, part.index), faults)):
                    if isinstance(tag, str) and tag and "$" not in tag:
                        tags.check(tag, entry)


def _tags_in(raw: object, entry: Passage) -> Iterator[tuple[Passage, object]]:
    if isinstance(raw, dict):
        yield entry.at("tag"), raw.get("tag")
        for key in ("inputs", "outputs") if entry.path[0] == "transformations" else ():
            ports = raw.get(key)
            for name, port in ports.items() if isinstance(ports, dict) else ():
                at = entry.at(key, name)
                yield (at.at("tag"), port.get("tag")) if isinstance(port, dict) else (at, port)


def _in_file_order(faults: Collection[Fault], document: Document) -> list[Fault]:
    order: dict[str, int] = {}
    for file in document.files:
        order.setdefault(file.source.file, len(order))
    last = len(order)
    return sorted(dict.fromkeys(faults), key=lambda f: (order.get(f.file or "", last), f.line or 0, f.column or 0))
