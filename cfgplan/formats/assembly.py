"""From a document to an environment: templates expanded, every tag and every reference checked."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from functools import reduce
from math import prod
from operator import attrgetter, getitem
from typing import Any, Protocol, TypeAlias, TypeVar

from cfgplan.canonical import unchecked
from cfgplan.domain import (
    CPU,
    MEMORY,
    START_MODES,
    Environment,
    InputPort,
    Objective,
    OutputPort,
    RunOptions,
    Target,
    Transformation,
    observing,
)
from cfgplan.errors import Fault, InputError, MatchingError, TagError, UnknownNameError, did_you_mean
from cfgplan.facts import variables
from cfgplan.formats import fields, templates
from cfgplan.formats.document import Document, File
from cfgplan.formats.environment_file import EnvironmentFile
from cfgplan.formats.fleet import FleetReader
from cfgplan.formats.garbage import no_garbage_collection
from cfgplan.formats.left_out import LeftOut
from cfgplan.formats.places import Passage, Path
from cfgplan.formats.references import UnitChecker
from cfgplan.formats.templates import Variable, original_column
from cfgplan.transformations import DEFAULT_LABOR_US, transformation_of


class TagVocabulary(Protocol):
    """An ontology as the formats see it."""

    def instances(self, class_name: str) -> tuple[str, ...]:
        """The names of the individuals of a class, asserted or inferred; raises TagError and UnknownNameError."""

    def check_tag(self, text: str) -> None:
        """Return if `text` is a tag over known names; raises TagError."""


class TagChecker:
    """Checks the tags of one document, each distinct one once."""

    def __init__(self, vocabulary: TagVocabulary) -> None:
        self._vocabulary = vocabulary
        self.good: set[str] = set()
        """The tags that were checked and have no fault."""
        self._reported: set[tuple[str, Path]] = set()

    def check(
        self, tag: str, entry: Passage, template: str | None = None, values: Mapping[Variable, str] | None = None
    ) -> None:
        """Note the fault of a tag, which may be a template's expansion, once for each place."""
        place = (entry.source.file, entry.path)
        if tag in self.good or place in self._reported:
            return
        try:
            self._vocabulary.check_tag(tag)
        except TagError as error:
            self._reported.add(place)
            column = original_column(template, values, error.column) if template and values else error.column
            message = f"{error.message}, in the expansion {tag!r}" if values else error.message
            entry.note(message, error.mend, text_column=column)
        else:
            self.good.add(tag)


VariableValues = Mapping[templates.Variable, str]
_NO_VARIABLES: VariableValues = {}
PartT = TypeVar("PartT", fields.TransformationPart, fields.TargetPart)
_name_of = attrgetter("name")
_PORT_TYPES: dict[Any, Any] = {"inputs": InputPort, "outputs": OutputPort}


Expandable: TypeAlias = fields.TransformationPart | fields.TargetPart


class Expander:
    """Makes transformations and targets from their written form; each fault is noted at its place in the file."""

    def __init__(
        self,
        defaults: fields.DefaultsPart | None,
        vocabulary: TagVocabulary,
        tags: TagChecker,
        fleet: FleetReader,
        left_out: LeftOut,
    ) -> None:
        self._costs_us = {
            "labor_us": DEFAULT_LABOR_US,
            "upkeep_us": fields.DEFAULT_UPKEEP_US,
            **(defaults.values() if defaults else {}),
        }
        self._vocabulary = vocabulary
        self._tags = tags
        self._fleet = fleet
        self._left_out = left_out
        self._instances: dict[str, tuple[str, ...] | MatchingError] = {}
        self._plain_ports: dict[tuple[str, str, object], InputPort | OutputPort] = {}

    def expand(self, entry: Passage, part: fields.TransformationPart) -> list[Transformation]:
        """Return the transformations that one written transformation expands to, without those that have faults."""
        made = (
            self._filled(entry, part, filled, values)
            for filled, values in self._expansions(entry, part, "transformations")
        )
        return [transformation for transformation in made if transformation is not None]

    def expand_target(self, entry: Passage, part: fields.TargetPart) -> Iterator[fields.TargetPart]:
        """Yield the targets that one written target expands to, and check their tags; none if it has faults."""
        for filled, values in self._expansions(entry, part, "targets"):
            if part.tag is not None and filled.tag is not None:
                self._tags.check(filled.tag, entry.at("tag"), part.tag, values)
            yield filled

    def _expansions(self, entry: Passage, part: PartT, kind: str) -> Iterable[tuple[PartT, VariableValues]]:
        """Return the part with its variables filled in, in each way; if it has faults, check its plain tags instead."""
        if entry.source.is_plain or "$" not in repr(_at(entry)):
            return ((part, _NO_VARIABLES),)
        instances = self._variable_instances(entry, part, kind)
        if instances is None:
            self._left_out.add(kind, part.label)
            self._check_plain_tags(entry, part)
            return ()
        return ((templates.substitute_all(part, values), values) for values in templates.assignments(instances))

    def _variable_instances(
        self, entry: Passage, part: Expandable, kind: str
    ) -> dict[templates.Variable, tuple[str, ...]] | None:
        """The instances of each variable of a template, or None if the template has faults."""
        found = _variables(entry, part)
        if found is None:
            return None
        in_label = {variable for variable, _ in templates.variables(part.label)}
        missing = [variable for variable in found if variable not in in_label]
        if missing:
            names = " and ".join(map(templates.shown, missing))
            mend = f"add it, such as `label: {part.label}({', '.join(map(templates.shown, missing))})`"
            entry.at("label").note(f"the label does not mention {names}", mend)
        instances: dict[templates.Variable, tuple[str, ...]] = {}
        for variable, (place, column) in found.items():
            individuals = self._individuals(variable[0])
            if isinstance(individuals, MatchingError):
                place.note(individuals.message, individuals.mend, text_column=column)
            else:
                instances[variable] = individuals
        if missing or len(instances) < len(found):
            return None
        count = prod(map(len, instances.values()))
        if count > templates.MOST_EXPANSIONS:
            message = f"this template stands for {count:,} {kind}, more than {templates.MOST_EXPANSIONS:,}"
            entry.at("label").note(message, "use fewer variables or smaller classes")
            return None
        return instances

    def _individuals(self, class_name: str) -> tuple[str, ...] | MatchingError:
        if class_name not in self._instances:
            try:
                names = self._vocabulary.instances(class_name)
            except (TagError, UnknownNameError) as error:
                self._instances[class_name] = error
            else:
                empty = UnknownNameError(
                    f"the class {class_name} has no individuals", "assert one in an ontology that `ontology:` names"
                )
                self._instances[class_name] = names or empty
        return self._instances[class_name]

    def _filled(
        self, entry: Passage, part: fields.TransformationPart, filled: fields.TransformationPart, values: VariableValues
    ) -> Transformation | None:
        """The transformation of a part with all variables filled in; None if it has faults."""
        names = [*(part.inputs or ()), *(part.outputs or ())]
        if filled is not part:
            names = [templates.substitute(name, values) for name in names]
        if len(set(names)) != len(names):
            self._check_plain_tags(entry, part)
            _note_repeated_port(entry, part, names, values)
            self._left_out.add("transformations", filled.label)
            return None
        said = {**self._costs_us, **filled.values()}
        for key in _PORT_TYPES:
            if key in said:
                ports = self._ports(entry, key, part, filled, values)
                said[key] = tuple(sorted(ports, key=_name_of) if len(ports) > 1 else ports)
        if filled.host is not None:
            said |= self._hosts(entry.at("host"), filled.host)
        if not (
            _is_well_numbered(entry, part)
            & self._fleet.are_selectors(entry, filled)
            & (filled.requires is None or self._fleet.is_requirement(entry.at("requires"), filled.requires))
        ):
            self._left_out.add("transformations", filled.label)
            return None
        if filled.run is not None:
            said["run"] = _run_options(entry.at("run"), filled)
        if isinstance(filled.conflicts, fields.ConflictsPart):
            said |= {"conflicts": (), **filled.conflicts.values()}
        return transformation_of(said)

    def _hosts(self, entry: Passage, written: str | list[str]) -> dict[str, Any]:
        if isinstance(written, list) or written in self._fleet.copies:
            named = written if isinstance(written, list) else [written]
            for index, name in enumerate(named):
                if name not in self._fleet.copies:
                    self._fleet.check_host(entry.at(index), name, is_choice=True)
            return {"host": None, "hosts": self._fleet.choice(named)}
        self._fleet.check_host(entry, written)
        return {}

    def _ports(
        self,
        entry: Passage,
        key: str,
        part: fields.TransformationPart,
        filled: fields.TransformationPart,
        values: VariableValues,
    ) -> list[InputPort | OutputPort]:
        """The ports under a key. Equal ones that are only a tag are one object, made when the tag is checked."""
        written, ports = getattr(part, key), getattr(filled, key)
        known = self._plain_ports.get
        found = [known((key, name, port)) for name, port in ports.items()]
        if all(found):
            return found  # type: ignore[return-value]
        for index, (template, name) in enumerate(zip(written, ports, strict=True)):
            if found[index] is None:
                found[index] = self._port(entry.at(key, template), key, name, written[template], ports[name], values)
        return found  # type: ignore[return-value]

    def _port(
        self, entry: Passage, key: str, name: str, template: Any, port: Any, values: VariableValues
    ) -> InputPort | OutputPort:
        """The port that stands at `entry`, a text or a part, filled in from a template."""
        place, tag = _tag_of(port, entry)
        self._tags.check(tag, place, _tag_of(template, entry)[1], values)
        if isinstance(port, str):
            made: InputPort | OutputPort = unchecked(_PORT_TYPES[key], {"name": name, "tag": tag})
            if tag in self._tags.good:
                self._plain_ports[key, name, tag] = made
            return made
        said = port.values()
        if isinstance(port, fields.InputPart) and port.worth and not port.optional:
            entry.at("worth").note(
                f"`worth` is only for optional inputs, and `{entry.path[-1]}` is not optional",
                "add `optional: true`, or remove `worth`",
            )
        if "quality" in said:
            said["quality"] = self._fleet.contributions(entry.at("quality"), said["quality"])
        return _made(key, name, said)

    def _check_plain_tags(self, entry: Passage, part: Expandable) -> None:
        """Check the plain tags of a template that can't be expanded, so that all its faults are told at once."""
        if isinstance(part, fields.TargetPart):
            if part.tag is not None and "$" not in part.tag:
                self._tags.check(part.tag, entry.at("tag"))
            return
        for key in _PORT_TYPES:
            for name, written in (getattr(part, key) or {}).items():
                place, tag = _tag_of(written, entry.at(key, name))
                if "$" not in tag:
                    self._tags.check(tag, place)


def _at(entry: Passage) -> Any:
    """The plain data at an entry."""
    return reduce(getitem, entry.path, entry.source.data)  # type: ignore[arg-type]


def _made(key: str, name: str, said: dict[str, Any]) -> InputPort | OutputPort:
    return InputPort(name, **said) if key == "inputs" else OutputPort(name, **said)


def _variables(entry: Passage, part: Expandable) -> dict[templates.Variable, tuple[Passage, int]] | None:
    """Each variable of a part with the place of its first mention, or None if a `${` is wrong."""
    found: dict[templates.Variable, tuple[Passage, int]] = {}
    is_good = True
    for path, text in templates.texts(part, ()):
        place = entry.at(*path)
        try:
            for variable, column in templates.variables(text):
                found.setdefault(variable, (place, column))
        except templates.BadTemplateError as error:
            is_good = False
            place.note(str(error), "write ${Class}, ${Class:name}, or $${ for a plain ${", text_column=error.column)
    return found if is_good else None


def _is_well_numbered(entry: Passage, part: fields.TransformationPart) -> bool:
    """Whether a part does not ask for more units than it allows, nor for a resource in two places."""
    if part.max_instances is None and not part.needs:
        return True
    fits = part.max_instances is None or part.min_instances <= part.max_instances
    if not fits:
        message = f"`min_instances` is {part.min_instances}, but `max_instances` is {part.max_instances}"
        entry.at("max_instances").note(message, "raise max_instances")
    said = {CPU} if part.memory is None else {CPU, MEMORY}
    twice = sorted(said.intersection(part.needs or ()))
    for resource in twice if fits else ():
        message = f"how much {resource} a unit takes is written under `{'upkeep' if resource == CPU else resource}`"
        entry.at("needs", resource).note(message, "remove it here", at_key=True)
    return fits and not twice


def _run_options(entry: Passage, filled: fields.TransformationPart) -> RunOptions:
    if filled.run is None:
        return RunOptions()
    start, known = filled.run.start, [*START_MODES, *(filled.inputs or ())]
    if start not in known:
        mend = did_you_mean(start, known, f"write {', '.join(START_MODES)}, or the name of an input port")
        entry.at("start").note(f"no step starts on `{start}`", mend)
    if filled.run.rate is not None and filled.inputs:
        mend = "remove it: elements of its inputs start its steps; `run: {start: ...}` says which"
        entry.at("rate").note("`rate` is only for sources, and this transformation has inputs", mend)
        return RunOptions()
    return RunOptions(**filled.run.values())


def _note_repeated_port(
    entry: Passage, part: fields.TransformationPart, names: list[str], values: VariableValues
) -> None:
    twice = next(name for name in names if names.count(name) > 1)
    written = [entry.at(key, name) for key in _PORT_TYPES for name in (getattr(part, key) or {})]
    second = [place for place in written if templates.substitute(str(place.path[-1]), values) == twice][1]
    message = f"the port name `{twice}` is taken: the ports of a transformation, inputs and outputs, share their names"
    second.note(message, "rename one of the two", at_key=True)


def _tag_of(written: str | fields.InputPart | fields.OutputPart, entry: Passage) -> tuple[Passage, str]:
    """The tag of a port as written, and its place."""
    return (entry, written) if isinstance(written, str) else (entry.at("tag"), written.tag)


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
    for entry, part in _targets(document, expander, faults):
        is_new = names.is_new("target", part.label, entry, "label")
        if part.topic is not None:
            is_new &= names.is_new("topic", part.topic, entry, "topic")
        if part.host is not None:
            fleet.check_host(entry.at("host"), part.host, is_choice=True)
        if part.run:
            _check_labels(entry.at("run"), [part.run], library, left_out)
        if is_new:
            targets[part.label] = Target(**{**part.values(), "quality": fleet.wishes(entry.at("quality"), part)})
    for fact in variables(fleet.facts.values(), fleet.hosts) if fleet.facts else ():
        entry = Passage(document.files[0].source, ("facts", fact.name), faults)
        names.is_new("fact", fact.key, entry, "of" if fact.host else "declared")
        if (wanted := observing(fact)) is not None:
            tags.check(wanted.tag, entry.at("by"))
            if names.is_new("target", wanted.label, entry, "by") & names.is_new("topic", wanted.topic, entry, "by"):
                targets[wanted.label] = wanted
        elif (
            fact.topic is not None
            and fact.type is None
            and ("topic", fact.topic) not in names.origins
            and not left_out.any_of("targets")
        ):
            entry.at("topic").note(
                f"no target has the topic `{fact.topic}`", "write that of a target, or observe the fact `by: TAG`"
            )
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
        tuple(map(Objective, document.header.minimise)),
        tuple(fleet.facts.values()),
    )
    return EnvironmentFile(
        document.path,
        environment,
        document.header.horizon,
        document.header.max_cost,
        document.ontology_paths,
        fleet.survive,
        document.imports,
        document.ignores_rules,
        tuple(written for written, _ in document.preferred),
        names.origins | fleet.origins,
    )


def _parts(document: Document, kind: str, faults: list[Fault]) -> Iterator[tuple[Passage, Any]]:
    """Return the transformations, targets or units of all files, each with its place."""
    for file in document.files:
        for index, part in getattr(file, kind):
            yield Passage(file.source, (kind, index), faults), part


def _targets(
    document: Document, expander: Expander, faults: list[Fault]
) -> Iterator[tuple[Passage, fields.TargetPart]]:
    """The targets of all files, templates expanded, each with where it stands; without those that want no one thing."""
    for entry, part in _parts(document, "targets", faults):
        is_whole = _wants_one_thing(entry, part)
        yield from ((entry, filled) for filled in expander.expand_target(entry, part) if is_whole)


def _wants_one_thing(entry: Passage, part: fields.TargetPart) -> bool:
    """Return whether a target has `topic` and `tag`, or else `run` and no key about a stream; note each fault."""
    said = [key for key in fields.OF_A_STREAM if getattr(part, key) is not None]
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
    """The names in use, by kind and name, each with the place that took it."""

    def __init__(self) -> None:
        self.origins: dict[tuple[str, str], Passage] = {}

    def is_new(self, kind: str, name: str, entry: Passage, key: str) -> bool:
        """Take a name; False, and a fault, if it is taken."""
        if (kind, name) not in self.origins:
            self.origins[kind, name] = entry
            return True
        first = self.origins[kind, name]
        what = {"topic": "topic", "unit": "unit id", "fact": "fact"}.get(kind, f"{kind} label")
        message = f"the {what} `{name}` is taken: {first.place.file}, line {first.place.line} uses it"
        if first == entry:
            message = f"several expansions of this template have the {'topic' if kind == 'topic' else 'label'} `{name}`"
        entry.at(key).note(message, "give each a name of its own")
        return False


def _check_named(
    library: dict[str, Transformation], left_out: LeftOut, origins: Mapping[tuple[str, str], Passage]
) -> None:
    for t in library.values():
        if not (t.beside or t.conflicts or t.conflicts_on_host):
            continue
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
