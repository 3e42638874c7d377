"""Transformations as written, and the ones that their templates stand for."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from math import prod
from typing import Any

from cfgplan.domain import CPU, MEMORY, START_MODES, InputPort, OutputPort, RunOptions, Transformation
from cfgplan.errors import Fault
from cfgplan.formats.fields import (
    DEFAULT_LABOR_US,
    DEFAULT_UPKEEP_US,
    DefaultsPart,
    InputPart,
    OutputPart,
    TransformationPart,
)
from cfgplan.formats.fleet import FleetReader
from cfgplan.formats.left_out import LeftOut
from cfgplan.formats.places import Path, Source
from cfgplan.formats.suggestions import did_you_mean
from cfgplan.formats.tags import BadClassError, TagChecker, TagVocabulary
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

VariableValues = Mapping[Variable, str]
_PORT_TYPES: dict[Any, Any] = {"inputs": InputPort, "outputs": OutputPort}


class Expander:
    """Makes transformations from their written form; what is wrong goes into `faults`."""

    def __init__(
        self,
        defaults: DefaultsPart | None,
        vocabulary: TagVocabulary,
        tags: TagChecker,
        fleet: FleetReader,
        left_out: LeftOut,
        faults: list[Fault],
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
        self._faults = faults
        self._instances: dict[str, tuple[str, ...] | BadClassError] = {}

    def expand(self, source: Source, path: Path, part: TransformationPart) -> Iterator[Transformation]:
        """The transformations that one written transformation stands for; none if it has faults."""
        if "$" not in str(vars(part)):
            yield from self._filled(source, path, part, part, {})
            return
        templates = [(place, text) for place, text in texts(part, path) if "$" in text]
        instances = self._variable_instances(source, path, part, templates)
        if instances is None:
            self._left_out.add("transformations", part.label)
            self._check_plain_tags(source, path, part)
            return
        for values in assignments(instances):
            yield from self._filled(source, path, part, substitute_all(part, values), values)

    def _variable_instances(
        self, source: Source, path: Path, part: TransformationPart, templates: list[tuple[Path, str]]
    ) -> dict[Variable, tuple[str, ...]] | None:
        """What each variable of a template ranges over, or None if the template has faults."""
        found = self._variables(source, templates)
        if found is None:
            return None
        in_label = {variable for variable, _ in variables(part.label)}
        missing = [variable for variable in found if variable not in in_label]
        if missing:
            names = " and ".join(map(shown, missing))
            mend = f"add it, such as `label: {part.label}({', '.join(map(shown, missing))})`"
            self._faults.append(source.fault((*path, "label"), f"the label does not mention {names}", mend))
        instances = self._instances_of(source, found)
        if missing or instances is None:
            return None
        count = prod(len(names) for names in instances.values())
        if count > MOST_EXPANSIONS:
            message = f"this template stands for {count:,} transformations, more than {MOST_EXPANSIONS:,}"
            self._faults.append(source.fault((*path, "label"), message, "use fewer variables or smaller classes"))
            return None
        return instances

    def _variables(self, source: Source, templates: list[tuple[Path, str]]) -> dict[Variable, tuple[Path, int]] | None:
        """Each variable with the place of its first mention, or None if a `${` is wrong."""
        found: dict[Variable, tuple[Path, int]] = {}
        is_good = True
        for path, text in templates:
            try:
                for variable, column in variables(text):
                    found.setdefault(variable, (path, column))
            except BadTemplateError as error:
                is_good = False
                mend = "write ${Class}, ${Class:name}, or $${ for a plain ${"
                self._faults.append(source.fault(path, str(error), mend, text_column=error.column))
        return found if is_good else None

    def _instances_of(
        self, source: Source, found: Mapping[Variable, tuple[Path, int]]
    ) -> dict[Variable, tuple[str, ...]] | None:
        instances: dict[Variable, tuple[str, ...]] = {}
        for variable, (path, column) in found.items():
            names = self._individuals(variable[0])
            if isinstance(names, BadClassError):
                self._faults.append(source.fault(path, names.message, names.mend, text_column=column))
            else:
                instances[variable] = names
        return instances if len(instances) == len(found) else None

    def _individuals(self, class_name: str) -> tuple[str, ...] | BadClassError:
        if class_name not in self._instances:
            try:
                names = self._vocabulary.instances(class_name)
            except BadClassError as error:
                self._instances[class_name] = error
            else:
                empty = BadClassError(
                    f"the class {class_name} has no individuals", "assert one in an ontology that `ontology:` names"
                )
                self._instances[class_name] = names or empty
        return self._instances[class_name]

    def _filled(
        self, source: Source, path: Path, part: TransformationPart, filled: TransformationPart, values: VariableValues
    ) -> Iterator[Transformation]:
        """The transformation of a part with all variables filled in; none if it has faults."""
        names = [substitute(name, values) for key in _PORT_TYPES for name in getattr(part, key) or ()]
        if len(set(names)) != len(names):
            self._check_plain_tags(source, path, part)
            self._note_repeated_port(source, path, part, names, values)
            self._left_out.add("transformations", filled.label)
            return
        ports = {key: tuple(self._ports(source, path, key, part, filled, values)) for key in _PORT_TYPES}
        hosts = self._hosts(source, (*path, "host"), filled.host)
        if self._is_misnumbered(source, path, part) or self._needs_twice(source, path, part):
            self._left_out.add("transformations", filled.label)
            return
        run = self._run_options(source, (*path, "run", "start"), filled)
        yield Transformation(**{**self._costs_us, **filled.values(), **ports, **hosts, "run": run})

    def _hosts(self, source: Source, path: Path, written: str | list[str] | None) -> dict[str, Any]:
        if isinstance(written, list):
            for index, name in enumerate(written):
                self._fleet.check_host(source, (*path, index), name, is_choice=True)
            return {"host": None, "hosts": tuple(dict.fromkeys(written))}
        if written is not None:
            self._fleet.check_host(source, path, written)
        return {}

    def _is_misnumbered(self, source: Source, path: Path, part: TransformationPart) -> bool:
        wrong = part.max_instances is not None and part.max_instances < part.min_instances
        if wrong:
            message = f"it asks for {part.min_instances} units, but allows {part.max_instances}"
            self._faults.append(source.fault((*path, "max_instances"), message, "raise max_instances"))
        return wrong

    def _needs_twice(self, source: Source, path: Path, part: TransformationPart) -> bool:
        wrong = {CPU} if part.memory is None else {CPU, MEMORY}
        for resource in sorted(wrong.intersection(part.needs or ())):
            message = f"the {resource} that a unit takes is said by `{'upkeep' if resource == CPU else resource}`"
            self._faults.append(source.fault((*path, "needs", resource), message, "remove it here", at_key=True))
        return not wrong.isdisjoint(part.needs or ())

    def _run_options(self, source: Source, path: Path, filled: TransformationPart) -> RunOptions:
        if filled.run is None:
            return RunOptions()
        start, known = filled.run.start, [*START_MODES, *(filled.inputs or ())]
        if start not in known:
            mend = did_you_mean(start, known, f"write {', '.join(START_MODES)}, or the name of an input port")
            self._faults.append(source.fault(path, f"no step starts on `{start}`", mend))
        return RunOptions(**filled.run.values())

    def _ports(
        self,
        source: Source,
        path: Path,
        key: str,
        part: TransformationPart,
        filled: TransformationPart,
        values: VariableValues,
    ) -> Iterator[InputPort | OutputPort]:
        templates, ports = getattr(part, key) or {}, getattr(filled, key) or {}
        for (at, template), (name, port) in zip(templates.items(), ports.items(), strict=True):
            place, tag = _tag_of(port, (*path, key, at))
            self._tags.check(tag, source, place, _tag_of(template, place)[1], values)
            said: dict[str, Any] = {"tag": tag} if isinstance(port, str) else port.values()
            if "quality" in said:
                said["quality"] = self._fleet.contributions(source, (*path, key, at, "quality"), said["quality"])
            yield _PORT_TYPES[key](name, **said)

    def _check_plain_tags(self, source: Source, path: Path, part: TransformationPart) -> None:
        """Check the plain tags of a template that can't be expanded, so that all its faults are told at once."""
        for key in _PORT_TYPES:
            for name, written in (getattr(part, key) or {}).items():
                place, tag = _tag_of(written, (*path, key, name))
                if "$" not in tag:
                    self._tags.check(tag, source, place)

    def _note_repeated_port(
        self, source: Source, path: Path, part: TransformationPart, names: list[str], values: VariableValues
    ) -> None:
        twice = next(name for name in names if names.count(name) > 1)
        keys = [(*path, key, name) for key in _PORT_TYPES for name in (getattr(part, key) or {})]
        second = [key for key in keys if substitute(str(key[-1]), values) == twice][1]
        message = (
            f"the port name `{twice}` is taken: the ports of a transformation, inputs and outputs, share their names"
        )
        self._faults.append(source.fault(second, message, "rename one of the two", at_key=True))


def _tag_of(written: str | InputPart | OutputPart, path: Path) -> tuple[Path, str]:
    """The tag of a port as written, and its place."""
    return (path, written) if isinstance(written, str) else ((*path, "tag"), written.tag)
