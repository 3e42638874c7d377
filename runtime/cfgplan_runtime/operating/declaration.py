"""Reading additions to a running system: text in the environment file's form, with individuals."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

from cfgplan.errors import Fault, InputError
from cfgplan.formats.json_text import read_json
from cfgplan.formats.places import Path, Source
from cfgplan.formats.yaml_text import read_yaml
from cfgplan_runtime.lifecycle.changes import Declare, Individual

_STEP = re.compile(r"\[(\d+)\]|([^.\[\]]+)")
_DECLARATION_FORM = "write `individuals: {piff: Robot}`, or `piff: {classes: [Robot], relations: {hasColour: red}}`"


@dataclass(frozen=True)
class Declared:
    """A declaration, and the text that it was read from."""

    change: Declare
    source: Source

    def placed(self, fault: Fault) -> Fault:
        """A fault that a manager has found in the declaration, with its place in the text."""
        if fault.file != f"declared by {self.change.name}":
            return fault
        steps = _STEP.findall(fault.key or "")
        path = tuple(int(index) if index else name for index, name in steps)
        spot = self.source.locate(path, False)
        return replace(fault, file=self.source.file, line=spot.line, column=spot.column)


def declaration(name: str, text: str) -> Declared:
    """Read a declaration from YAML or JSON. Raises InputError with every fault of syntax and individuals.

    The manager checks the transformations and targets when it takes the declaration in.
    """
    source = read_json(text, name) if text.lstrip().startswith("{") else read_yaml(text, name)
    faults = list(source.faults)
    data = source.data
    if not isinstance(data, dict):
        mend = "write a mapping with `transformations:`, `targets:` or `individuals:`"
        raise InputError([*faults, source.fault((), "this declares nothing", mend)])
    individuals = tuple(_individuals(source, data.get("individuals"), faults))
    if faults:
        raise InputError(faults)
    document = {key: value for key, value in data.items() if key != "individuals"}
    return Declared(Declare(name, document, individuals), source)


def _individuals(source: Source, written: Any, faults: list[Fault]) -> Iterator[Individual]:
    if written is None:
        return
    if not isinstance(written, dict):
        faults.append(source.fault(("individuals",), "this is not a mapping of individuals", _DECLARATION_FORM))
        return
    for name, said in written.items():
        path = ("individuals", name)
        if isinstance(said, dict):
            faults += (
                source.fault((*path, key), f"an individual has no `{key}`", _DECLARATION_FORM, at_key=True)
                for key in said.keys() - {"classes", "relations"}
            )
            classes, relations = said.get("classes"), said.get("relations")
        else:
            classes, relations = said, None
        yield Individual(
            name,
            tuple(_names(source, path, classes, faults)),
            tuple(_relations(source, (*path, "relations"), relations, faults)),
        )


def _relations(source: Source, path: Path, written: Any, faults: list[Fault]) -> Iterator[tuple[str, str]]:
    if written is None:
        return
    if not isinstance(written, Mapping):
        faults.append(source.fault(path, "this is not a mapping of relations", _DECLARATION_FORM))
        return
    for role, others in written.items():
        for other in _names(source, (*path, role), others, faults):
            yield role, other


def _names(source: Source, path: Path, written: Any, faults: list[Fault]) -> list[str]:
    """The names in `written`, one or a list. Notes a fault and returns [] for anything else."""
    names = [] if written is None else written if isinstance(written, list) else [written]
    if all(isinstance(name, str) and name for name in names):
        return names
    faults.append(source.fault(path, "this is neither a name nor a list of names", _DECLARATION_FORM))
    return []
