"""Environment files with their includes, read and validated before any expansion."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import reduce
from itertools import count
from operator import getitem
from pathlib import Path as FilePath
from typing import Any, TypeVar

from cfgplan.errors import Fault, InputError
from cfgplan.formats import fields
from cfgplan.formats.environment_file import ANY_IMPORT, FoundImports
from cfgplan.formats.files import SUFFIXES, is_folder, read_source
from cfgplan.formats.forms import RefusedError
from cfgplan.formats.garbage import no_garbage_collection
from cfgplan.formats.places import Path, Source, Spot

_BEGINS = "a file is a mapping that begins with `format: cfgplan/1`"
_LAUNCH_FILE = "a launch file", "make an environment of it: `cfgplan import ros2 FILE --out env.yaml`"
_ONTOLOGY = "an ontology", "name it under `ontology:` of an environment file"
_OTHER_KINDS = {
    **dict.fromkeys((".ttl", ".owl", ".rdf", ".jsonld", ".omn", ".ofn"), _ONTOLOGY),
    ".launch": ("a launch file", "make an environment of it: `cfgplan import ros1 FILE --out env.yaml`"),
    ".launch.py": _LAUNCH_FILE,
    ".launch.xml": _LAUNCH_FILE,
    ".mcap": ("a recording", "take the environment of its run: `cfgplan replay FILE --extract FOLDER`"),
    ".py": ("Python code", "name its classes under `source:` of an environment file"),
}
"""Files that are mistaken for an environment, by their ending, each with its mend."""
P = TypeVar("P", bound=fields.Part)

Indexed = tuple[int, P]
"""A part and its position in its file's list."""


@dataclass(frozen=True)
class Broken:
    """A part with faults. Its index is None if the whole list is broken, its name if it has none."""

    index: int | None = None
    name: str | None = None


@dataclass(frozen=True)
class File:
    """The valid parts of one file, and the broken ones by list."""

    source: Source
    transformations: tuple[Indexed[fields.TransformationPart], ...] = ()
    units: tuple[Indexed[fields.UnitPart], ...] = ()
    targets: tuple[Indexed[fields.TargetPart], ...] = ()
    broken: Mapping[str, tuple[Broken, ...]] = field(default_factory=dict)


@dataclass(frozen=True)
class Document:
    """An environment as written in its files; `faults` are those of syntax and schema."""

    path: FilePath
    header: fields.EnvironmentPart
    files: tuple[File, ...]
    faults: tuple[Fault, ...]

    @property
    def ontology_paths(self) -> tuple[FilePath, ...]:
        """The ontology files, relative to the working folder."""
        names = self.header.ontology or []
        return tuple(self.path.parent / name for name in ([names] if isinstance(names, str) else names))

    @property
    def imports(self) -> FoundImports:
        """The file of each IRI under `imports:`, relative to the working folder; None if the import is ignored."""
        written = self.header.imports or {}
        named = {ANY_IMPORT: written} if isinstance(written, str) else written
        folder = self.path.parent
        return tuple((iri, None if name == fields.IGNORE else folder / name) for iri, name in sorted(named.items()))

    @property
    def ignores_rules(self) -> bool:
        """Whether the rules of the ontology are left out."""
        return self.header.rules == fields.IGNORE

    @property
    def preferred(self) -> tuple[tuple[str, Path], ...]:
        """The prefixes and namespaces under `prefer:`, each with its entry."""
        written = self.header.prefer or []
        if isinstance(written, str):
            return ((written, ("prefer",)),)
        return tuple((each, ("prefer", number)) for number, each in enumerate(written))

    def at_ontology(self, fault: Fault) -> Fault:
        """Move a fault of a whole ontology file to the entry that names the file; any other stays as it is."""
        source = self.files[0].source
        written: Any = source.data
        named: list[tuple[FilePath | None, Path]] = [(path, ("imports", iri)) for iri, path in self.imports]
        is_one = isinstance(self.header.ontology, str)
        named += [(path, ("ontology",) if is_one else ("ontology", n)) for n, path in enumerate(self.ontology_paths)]
        entry = next((entry for path, entry in named if path is not None and str(path) == fault.file), None)
        if entry is None:
            return fault
        return _at_entry(fault, reduce(getitem, entry, written), source, entry)


def read_document(path: str | os.PathLike[str], also: Sequence[str | os.PathLike[str]] = ()) -> Document:
    """Read an environment file (YAML, JSON or XML) and its includes, or a folder of the paper's XML.

    The files `also` (relative to the working folder) are read as its includes, too.
    Faults are collected in the document, for `build` to report together with those it finds;
    InputError is raised only where there is nothing to go on with: a file that can't be read or parsed.
    """
    if not os.fspath(path):
        raise InputError.of("the name of the environment file is empty", mend="name a file")
    with no_garbage_collection():
        document = _read_document(FilePath(path))
        there = {_identity(document.path), *(_identity(FilePath(file.source.file)) for file in document.files)}
        for name in also:
            if _identity(FilePath(name)) in there:
                raise InputError.of(
                    "this file is a part of the environment already", file=str(name), mend="leave it out"
                )
            there.add(_identity(FilePath(name)))
        more = [_read_file(FilePath(name), fields.IncludedPart)[1:] for name in also]
        return replace(
            document,
            files=(*document.files, *(file for file, _ in more)),
            faults=(*document.faults, *(fault for _, faults in more for fault in faults)),
        )


def _read_document(main: FilePath) -> Document:
    if is_folder(main):
        return _folder_of_xml(main)
    header, file, faults = _read_file(main, fields.EnvironmentPart)
    files, more = _included(main, file.source, header.include or [])
    return Document(main, header, (file, *files), (*faults, *more))


def read_declared(name: str, data: Mapping[str, Any]) -> tuple[File, list[Fault]]:
    """Read a declaration at run-time like an included file. Returns its parts and faults. Raises InputError."""
    source = Source(name, dict(data), lambda _path, _at_key: Spot(1, 1))
    _, file, faults = _read_source(source, fields.IncludedPart)
    return file, faults


def _read_file(path: FilePath, part: type[P]) -> tuple[P, File, list[Fault]]:
    kind = next((kind for ending, kind in _OTHER_KINDS.items() if path.name.endswith(ending)), None)
    if kind is not None and path.is_file():
        raise InputError.of(f"this is {kind[0]}, not an environment", file=str(path), mend=kind[1])
    return _read_source(read_source(path), part)


def _read_source(source: Source, part: type[P]) -> tuple[P, File, list[Fault]]:
    data = source.data
    if data is None:
        raise InputError.of("the file is empty", file=source.file, mend=_BEGINS)
    if not isinstance(data, dict):
        raise InputError([*source.faults, source.fault((), "this is not an environment", _BEGINS)])
    if "format" not in data and (kind := _other_kind(data)):
        raise InputError([source.fault((), f"this is {kind[0]}, not an environment", kind[1])])
    faults = list(source.faults)
    bad: dict[Any, set[int]] = {}
    try:
        read = part.reader()(data)
    except RefusedError:
        from cfgplan.formats.models import refusals
        from cfgplan.formats.schema_faults import schema_faults

        errors = refusals(part, data)
        told = {(fault.line, fault.column) for fault in source.faults}
        faults += (f for f in schema_faults(source, (), errors, part) if (f.line, f.column) not in told)
        bad = _bad_entries([e["loc"] for e in errors])
        read = part.reader()(_good_entries(data, bad))
    return read, _file(source, read, data, bad), faults


def _other_kind(data: Mapping[str, object]) -> tuple[str, str] | None:
    """Return the kind of a mapping that does not declare an environment, with a mend; None if it may be one."""
    if "format_version" in data and "change_set" in data:
        return "a plan", "name the environment that it was made of; `cfgplan ctl apply` takes a plan"
    if "services" in data and "transformations" not in data:
        return "a file of Docker Compose", f"name an environment: {_BEGINS}"
    if "launch" in data and "transformations" not in data:
        return _LAUNCH_FILE
    return None


def _bad_entries(paths: list[Path]) -> dict[Any, set[int]]:
    """The positions of the bad entries by top-level key with faults; empty if the whole value is bad."""
    bad: dict[Any, set[int]] = {}
    wholly = set()
    for path in paths:
        bad.setdefault(path[0], set())
        if path[0] in ("transformations", "units", "targets") and len(path) > 1 and isinstance(path[1], int):
            bad[path[0]].add(path[1])
        else:
            wholly.add(path[0])
    return {key: set() if key in wholly else entries for key, entries in bad.items()}


def _good_entries(data: Mapping[str, Any], bad: Mapping[Any, set[int]]) -> dict[str, Any]:
    good: dict[str, Any] = {"format": fields.FORMAT}
    for key, value in data.items():
        if key not in bad:
            good[key] = value
        elif bad[key]:
            good[key] = [item for index, item in enumerate(value) if index not in bad[key]]
    return good


def _file(source: Source, read: Any, data: Mapping[str, Any], bad: Mapping[Any, set[int]]) -> File:
    def indexed(key: str) -> Iterator[Any]:
        positions = (index for index in count() if index not in bad.get(key, ()))
        return zip(positions, getattr(read, key, None) or (), strict=False)

    names = {"transformations": "label", "units": "id", "targets": "label"}
    broken = {
        key: tuple(Broken(index, _name(data[key][index], names[key])) for index in sorted(bad[key])) or (Broken(),)
        for key in names
        if key in bad
    }
    broken |= {key: (Broken(),) for key in ("hosts", "qualities", "facts") if key in bad}
    return File(source, tuple(indexed("transformations")), tuple(indexed("units")), tuple(indexed("targets")), broken)


def _name(item: object, key: str) -> str | None:
    name = item.get(key) if isinstance(item, dict) else None
    return name if isinstance(name, str) else None


def _folder_of_xml(folder: FilePath) -> Document:
    names = sorted(path.name for path in folder.iterdir() if path.suffix == ".xml" and path.is_file())
    if not names:
        there = [path for path in sorted(folder.iterdir()) if path.suffix in SUFFIXES and path.is_file()]
        usual = next((path for path in there if path.stem == "env" or len(there) == 1), None)
        none = "" if there else "; only a folder of XML files loads as a whole"
        mend = f"name the file in it{none}" if usual is None else f"did you mean `{usual}`?"
        raise InputError.of("this is a folder, not a file", file=str(folder), mend=mend)
    whole = Source(str(folder), {}, lambda _path, _at_key: Spot(1, 1))
    files, faults = _included(folder / "whole", whole, names)
    return Document(folder, fields.EnvironmentPart(format=fields.FORMAT), tuple(files), tuple(faults))


def _included(main: FilePath, source: Source, said: str | list[str]) -> tuple[list[File], list[Fault]]:
    files: list[File] = []
    faults: list[Fault] = []
    seen = {_identity(main)}
    for index, name in enumerate([said] if isinstance(said, str) else said):
        entry: Path = ("include",) if isinstance(said, str) else ("include", index)
        path = main.parent / name
        try:
            members = _members(path, main)
        except OSError as error:
            members = []
            faults.append(source.fault(entry, f"{name} can't be read: {error.strerror}", "check the path"))
        if is_folder(path) and not members:
            mend = f"put files into it that end in {', '.join(SUFFIXES)}, or remove this entry"
            faults.append(source.fault(entry, f"the folder {name} has no environment files", mend))
        for member in members:
            if _identity(member) in seen:
                itself = _identity(member) == _identity(main)
                what = f"{member} is this file itself" if itself else f"{member} is included twice"
                faults.append(source.fault(entry, what, "remove this entry"))
                continue
            seen.add(_identity(member))
            try:
                _, file, more = _read_file(member, fields.IncludedPart)
            except InputError as error:
                shown = name if member == path else str(FilePath(name) / member.name)
                faults += (_at_entry(fault, shown, source, entry) for fault in error.faults)
                files.append(File(source, broken={"transformations": (Broken(),), "targets": (Broken(),)}))
                continue
            files.append(file)
            faults += more
    return files, faults


def _at_entry(fault: Fault, name: str, source: Source, entry: Path) -> Fault:
    """Move a fault of a whole file to the entry that names the file, if one does."""
    has_entry = isinstance(source.data, dict) and entry[0] in source.data
    return (
        fault
        if fault.line is not None or not has_entry
        else source.fault(entry, f"{name}: {fault.message}", fault.mend)
    )


def _members(path: FilePath, main: FilePath) -> list[FilePath]:
    if not is_folder(path):
        return [path]
    found = sorted(p for p in path.iterdir() if p.suffix in SUFFIXES and p.is_file())
    return [p for p in found if _identity(p) != _identity(main)]


def _identity(path: FilePath) -> str:
    return os.path.realpath(path)
