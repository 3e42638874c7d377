"""Transformations as written, and the ones that their templates stand for."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from math import prod
from typing import cast

from cfgplan.domain import START_MODES, InputPort, OutputPort, RunOptions, Transformation
from cfgplan.errors import Fault
from cfgplan.formats.fleet import Fleet
from cfgplan.formats.left_out import LeftOut
from cfgplan.formats.places import Path, Source
from cfgplan.formats.schema import (
    DEFAULT_LABOR_US,
    DEFAULT_UPKEEP_US,
    DefaultsPart,
    InputPart,
    OutputPart,
    TransformationPart,
)
from cfgplan.formats.suggestions import did_you_mean
from cfgplan.formats.tags import TagChecker
from cfgplan.formats.templates import (
    MOST_EXPANSIONS,
    BadTemplateError,
    Variable,
    assignments,
    shown,
    substitute,
    substitute_all,
    variables,
)
from cfgplan.formats.vocabulary import BadClassError, Vocabulary


class Expander:
    """Makes transformations from their written form; what is wrong goes into `faults`."""

    def __init__(
        self,
        defaults: DefaultsPart,
        vocabulary: Vocabulary,
        tags: TagChecker,
        fleet: Fleet,
        left_out: LeftOut,
        faults: list[Fault],
    ) -> None:
        self._labor_us = DEFAULT_LABOR_US if defaults.labor is None else defaults.labor
        self._upkeep_us = DEFAULT_UPKEEP_US if defaults.upkeep is None else defaults.upkeep
        self._vocabulary = vocabulary
        self._tags = tags
        self._fleet = fleet
        self._left_out = left_out
        self._faults = faults
        self._instances: dict[str, tuple[str, ...] | BadClassError] = {}

    def expand(self, source: Source, path: Path, part: TransformationPart) -> Iterator[Transformation]:
        """The transformations that one written transformation stands for; none if it has faults."""
        texts = list(_texts(part, path))
        if not any("$" in text for _, text in texts):
            yield from self._filled(source, path, part, {})
            return
        instances = self._variable_instances(source, path, part, texts)
        if instances is None:
            self._left_out.add("transformations", part.label)
            self._check_plain_tags(source, path, part)
            return
        for values in assignments(instances):
            yield from self._filled(source, path, part, values)

    def _variable_instances(
        self, source: Source, path: Path, part: TransformationPart, texts: list[tuple[Path, str]]
    ) -> dict[Variable, tuple[str, ...]] | None:
        """What each variable of a template ranges over, or None if the template has faults."""
        found = self._variables(source, texts)
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

    def _variables(self, source: Source, texts: list[tuple[Path, str]]) -> dict[Variable, tuple[Path, int]] | None:
        """Each variable with the place of its first mention, or None if a `${` is wrong."""
        found: dict[Variable, tuple[Path, int]] = {}
        is_good = True
        for path, text in texts:
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
        self, source: Source, path: Path, part: TransformationPart, values: Mapping[Variable, str]
    ) -> Iterator[Transformation]:
        label = substitute(part.label, values)
        inputs = tuple(
            InputPort(name, tag, substitute(written.distinct, values) if written.distinct else None, written.feedback)
            if isinstance(written, InputPart)
            else InputPort(name, tag)
            for _, name, tag, written in self._ports(source, path, "inputs", part, values)
        )
        outputs = tuple(
            self._output(source, place, name, tag, written)
            if isinstance(written, OutputPart)
            else OutputPort(name, tag)
            for place, name, tag, written in self._ports(source, path, "outputs", part, values)
        )
        names = [*(port.name for port in inputs), *(port.name for port in outputs)]
        if len(set(names)) != len(names):
            self._note_repeated_port(source, path, part, names, values)
            self._left_out.add("transformations", label)
            return
        host = part.host if isinstance(part.host, str) else None
        hosts = part.host if isinstance(part.host, list) else []
        if self._is_misnumbered(source, path, part):
            self._left_out.add("transformations", label)
            return
        yield Transformation(
            label,
            inputs,
            outputs,
            self._labor_us if part.labor is None else part.labor,
            self._upkeep_us if part.upkeep is None else part.upkeep,
            part.pinned,
            part.required,
            _optional(part.source, values),
            None if host is None else self._host(source, (*path, "host"), host, values),
            _optional(part.kind, values),
            cast("dict[str, object]", substitute_all(part.params, values)) if part.params else {},
            self._run_options(source, path, part, [port.name for port in inputs], values),
            tuple(
                dict.fromkeys(
                    self._host(source, (*path, "host", index), name, values, is_choice=True)
                    for index, name in enumerate(hosts)
                )
            ),
            part.memory,
            tuple(dict.fromkeys(substitute(other, values) for other in part.conflicts or ())),
            part.min_instances,
            part.max_instances,
            part.standby,
        )

    def _output(self, source: Source, place: Path, name: str, tag: str, part: OutputPart) -> OutputPort:
        stated = self._fleet.contributions(source, (*place, "quality"), part.quality) if part.quality else ()
        return OutputPort(name, tag, stated, part.rate, part.size)

    def _host(
        self, source: Source, path: Path, text: str, values: Mapping[Variable, str], *, is_choice: bool = False
    ) -> str:
        name = substitute(text, values)
        self._fleet.check_host(source, path, name, is_choice=is_choice)
        return name

    def _is_misnumbered(self, source: Source, path: Path, part: TransformationPart) -> bool:
        wrong = part.max_instances is not None and part.max_instances < part.min_instances
        if wrong:
            message = f"it asks for {part.min_instances} units, but allows {part.max_instances}"
            self._faults.append(source.fault((*path, "max_instances"), message, "raise max_instances"))
        return wrong

    def _run_options(
        self, source: Source, path: Path, part: TransformationPart, inputs: list[str], values: Mapping[Variable, str]
    ) -> RunOptions:
        run = part.run
        if run is None:
            return RunOptions()
        start = substitute(run.start, values)
        known = [*START_MODES, *inputs]
        if start not in known:
            mend = did_you_mean(start, known, f"write {', '.join(START_MODES)}, or the name of an input port")
            self._faults.append(source.fault((*path, "run", "start"), f"no step starts on `{start}`", mend))
        blocks = run.when_full == "block"
        return RunOptions(start, run.tolerance, run.rate, run.queue, blocks, run.hang, run.memory, run.state)

    def _ports(
        self, source: Source, path: Path, key: str, part: TransformationPart, values: Mapping[Variable, str]
    ) -> Iterator[tuple[Path, str, str, str | InputPart | OutputPart]]:
        for name, written in (getattr(part, key) or {}).items():
            tag_path, template = _tag_of(written, (*path, key, name))
            tag = substitute(template, values)
            self._tags.check(tag, source, tag_path, template, values)
            yield (*path, key, name), substitute(name, values), tag, written

    def _check_plain_tags(self, source: Source, path: Path, part: TransformationPart) -> None:
        """Check what can be checked of a template that has no expansion, so that all its faults are told at once."""
        for key in ("inputs", "outputs"):
            for name, written in (getattr(part, key) or {}).items():
                place, tag = _tag_of(written, (*path, key, name))
                if "$" not in tag:
                    self._tags.check(tag, source, place)

    def _note_repeated_port(
        self, source: Source, path: Path, part: TransformationPart, names: list[str], values: Mapping[Variable, str]
    ) -> None:
        twice = next(name for name in names if names.count(name) > 1)
        keys = [(*path, key, name) for key in ("inputs", "outputs") for name in (getattr(part, key) or {})]
        second = [key for key in keys if substitute(str(key[-1]), values) == twice][1]
        message = (
            f"the port name `{twice}` is taken: the ports of a transformation, inputs and outputs, share their names"
        )
        self._faults.append(source.fault(second, message, "rename one of the two", at_key=True))


def _optional(text: str | None, values: Mapping[Variable, str]) -> str | None:
    return None if text is None else substitute(text, values)


def _tag_of(written: str | InputPart | OutputPart, path: Path) -> tuple[Path, str]:
    """The tag of a port as written, and its place."""
    return (path, written) if isinstance(written, str) else ((*path, "tag"), written.tag)


def _texts(part: TransformationPart, path: Path) -> Iterator[tuple[Path, str]]:
    """Every text of a written transformation in which a variable may stand, with its place."""
    yield (*path, "label"), part.label
    for key in ("source", "kind", "host"):
        text = getattr(part, key)
        if isinstance(text, str):
            yield (*path, key), text
    for key, texts in (("host", part.host), ("conflicts", part.conflicts)):
        if isinstance(texts, list):
            yield from (((*path, key, index), text) for index, text in enumerate(texts))
    if part.run is not None:
        yield (*path, "run", "start"), part.run.start
    for key in ("inputs", "outputs"):
        for name, written in (getattr(part, key) or {}).items():
            yield (*path, key, name), name
            yield _tag_of(written, (*path, key, name))
            if isinstance(written, InputPart) and written.distinct is not None:
                yield (*path, key, name, "distinct"), written.distinct
    if part.params:
        yield from _texts_inside(part.params, (*path, "params"))


def _texts_inside(value: object, path: Path) -> Iterator[tuple[Path, str]]:
    if isinstance(value, str):
        yield path, value
    elif isinstance(value, dict):
        for key, item in value.items():
            yield path, key
            yield from _texts_inside(item, (*path, key))
    elif isinstance(value, list):
        for index, item in enumerate(value):
            yield from _texts_inside(item, (*path, index))
