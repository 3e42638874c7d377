"""Transformations as written, and the ones that their templates stand for."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from math import prod
from typing import Any

from cfgplan.domain import CPU, MEMORY, START_MODES, InputPort, OutputPort, RunOptions, Transformation
from cfgplan.errors import MatchingError, TagError, UnknownNameError, did_you_mean
from cfgplan.formats.fields import (
    DEFAULT_UPKEEP_US,
    ConflictsPart,
    DefaultsPart,
    InputPart,
    OutputPart,
    TransformationPart,
)
from cfgplan.formats.fleet import FleetReader
from cfgplan.formats.left_out import LeftOut
from cfgplan.formats.places import Passage
from cfgplan.formats.tags import TagChecker, TagVocabulary
from cfgplan.formats.templates import (
    MOST_EXPANSIONS,
    BadTemplateError,
    Variable,
    assignments,
    shown,
    substitute,
    substitute_all,
    texts,
    variables,
)
from cfgplan.transformations import DEFAULT_LABOR_US

VariableValues = Mapping[Variable, str]
_PORT_TYPES: dict[Any, Any] = {"inputs": InputPort, "outputs": OutputPort}


class Expander:
    """Makes transformations from their written form; what is wrong is noted where it stands."""

    def __init__(
        self,
        defaults: DefaultsPart | None,
        vocabulary: TagVocabulary,
        tags: TagChecker,
        fleet: FleetReader,
        left_out: LeftOut,
    ) -> None:
        self._costs_us = {
            "labor_us": DEFAULT_LABOR_US,
            "upkeep_us": DEFAULT_UPKEEP_US,
            **(defaults.values() if defaults else {}),
        }
        self._vocabulary = vocabulary
        self._tags = tags
        self._fleet = fleet
        self._left_out = left_out
        self._instances: dict[str, tuple[str, ...] | MatchingError] = {}

    def expand(self, entry: Passage, part: TransformationPart) -> Iterator[Transformation]:
        """The transformations that one written transformation stands for; none if it has faults."""
        if "$" not in str(vars(part)):
            yield from self._filled(entry, part, part, {})
            return
        instances = self._variable_instances(entry, part)
        if instances is None:
            self._left_out.add("transformations", part.label)
            self._check_plain_tags(entry, part)
            return
        for values in assignments(instances):
            yield from self._filled(entry, part, substitute_all(part, values), values)

    def _variable_instances(self, entry: Passage, part: TransformationPart) -> dict[Variable, tuple[str, ...]] | None:
        """What each variable of a template ranges over, or None if the template has faults."""
        found = _variables(entry, part)
        if found is None:
            return None
        in_label = {variable for variable, _ in variables(part.label)}
        missing = [variable for variable in found if variable not in in_label]
        if missing:
            names = " and ".join(map(shown, missing))
            mend = f"add it, such as `label: {part.label}({', '.join(map(shown, missing))})`"
            entry.at("label").note(f"the label does not mention {names}", mend)
        instances: dict[Variable, tuple[str, ...]] = {}
        for variable, (place, column) in found.items():
            individuals = self._individuals(variable[0])
            if isinstance(individuals, MatchingError):
                place.note(individuals.message, individuals.mend, text_column=column)
            else:
                instances[variable] = individuals
        if missing or len(instances) < len(found):
            return None
        count = prod(map(len, instances.values()))
        if count > MOST_EXPANSIONS:
            message = f"this template stands for {count:,} transformations, more than {MOST_EXPANSIONS:,}"
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
        self, entry: Passage, part: TransformationPart, filled: TransformationPart, values: VariableValues
    ) -> Iterator[Transformation]:
        """The transformation of a part with all variables filled in; none if it has faults."""
        names = [substitute(name, values) for key in _PORT_TYPES for name in getattr(part, key) or ()]
        if len(set(names)) != len(names):
            self._check_plain_tags(entry, part)
            _note_repeated_port(entry, part, names, values)
            self._left_out.add("transformations", filled.label)
            return
        ports = {key: tuple(self._ports(entry.at(key), key, part, filled, values)) for key in _PORT_TYPES}
        hosts = self._hosts(entry.at("host"), filled.host)
        if not (_is_well_numbered(entry, part) & self._fleet.is_selector(entry.at("on"), filled.on)):
            self._left_out.add("transformations", filled.label)
            return
        run = _run_options(entry.at("run", "start"), filled)
        said = {"conflicts": (), **filled.conflicts.values()} if isinstance(filled.conflicts, ConflictsPart) else {}
        yield Transformation(**{**self._costs_us, **filled.values(), **ports, **hosts, **said, "run": run})

    def _hosts(self, entry: Passage, written: str | list[str] | None) -> dict[str, Any]:
        if isinstance(written, list) or written in self._fleet.copies:
            named = written if isinstance(written, list) else [written]
            for index, name in enumerate(named):
                if name not in self._fleet.copies:
                    self._fleet.check_host(entry.at(index), name, is_choice=True)
            return {"host": None, "hosts": self._fleet.choice(named)}
        if written is not None:
            self._fleet.check_host(entry, written)
        return {}

    def _ports(
        self, entry: Passage, key: str, part: TransformationPart, filled: TransformationPart, values: VariableValues
    ) -> Iterator[InputPort | OutputPort]:
        templates, ports = getattr(part, key) or {}, getattr(filled, key) or {}
        for (written, template), (name, port) in zip(templates.items(), ports.items(), strict=True):
            at = entry.at(written)
            place, tag = _tag_of(port, at)
            self._tags.check(tag, place, _tag_of(template, at)[1], values)
            said: dict[str, Any] = {"tag": tag} if isinstance(port, str) else port.values()
            if isinstance(port, InputPart) and port.worth and not port.optional:
                at.at("worth").note(f"the input `{written}` is never unfed", "add `optional: true`, or remove `worth`")
            if "quality" in said:
                said["quality"] = self._fleet.contributions(at.at("quality"), said["quality"])
            yield _PORT_TYPES[key](name, **said)

    def _check_plain_tags(self, entry: Passage, part: TransformationPart) -> None:
        """Check the plain tags of a template that can't be expanded, so that all its faults are told at once."""
        for key in _PORT_TYPES:
            for name, written in (getattr(part, key) or {}).items():
                place, tag = _tag_of(written, entry.at(key, name))
                if "$" not in tag:
                    self._tags.check(tag, place)


def _variables(entry: Passage, part: TransformationPart) -> dict[Variable, tuple[Passage, int]] | None:
    """Each variable of a part with the place of its first mention, or None if a `${` is wrong."""
    found: dict[Variable, tuple[Passage, int]] = {}
    is_good = True
    for path, text in texts(part, ()):
        place = entry.at(*path)
        try:
            for variable, column in variables(text):
                found.setdefault(variable, (place, column))
        except BadTemplateError as error:
            is_good = False
            place.note(str(error), "write ${Class}, ${Class:name}, or $${ for a plain ${", text_column=error.column)
    return found if is_good else None


def _is_well_numbered(entry: Passage, part: TransformationPart) -> bool:
    """Whether a part does not ask for more units than it allows, nor for a resource in two places."""
    fits = part.max_instances is None or part.min_instances <= part.max_instances
    if not fits:
        message = f"it asks for {part.min_instances} units, but allows {part.max_instances}"
        entry.at("max_instances").note(message, "raise max_instances")
    said = {CPU} if part.memory is None else {CPU, MEMORY}
    twice = sorted(said.intersection(part.needs or ()))
    for resource in twice if fits else ():
        message = f"how much {resource} a unit takes is written under `{'upkeep' if resource == CPU else resource}`"
        entry.at("needs", resource).note(message, "remove it here", at_key=True)
    return fits and not twice


def _run_options(entry: Passage, filled: TransformationPart) -> RunOptions:
    if filled.run is None:
        return RunOptions()
    start, known = filled.run.start, [*START_MODES, *(filled.inputs or ())]
    if start not in known:
        mend = did_you_mean(start, known, f"write {', '.join(START_MODES)}, or the name of an input port")
        entry.note(f"no step starts on `{start}`", mend)
    return RunOptions(**filled.run.values())


def _note_repeated_port(entry: Passage, part: TransformationPart, names: list[str], values: VariableValues) -> None:
    twice = next(name for name in names if names.count(name) > 1)
    written = [entry.at(key, name) for key in _PORT_TYPES for name in (getattr(part, key) or {})]
    second = [place for place in written if substitute(str(place.path[-1]), values) == twice][1]
    message = f"the port name `{twice}` is taken: the ports of a transformation, inputs and outputs, share their names"
    second.note(message, "rename one of the two", at_key=True)


def _tag_of(written: str | InputPart | OutputPart, entry: Passage) -> tuple[Passage, str]:
    """The tag of a port as written, and its place."""
    return (entry, written) if isinstance(written, str) else (entry.at("tag"), written.tag)
