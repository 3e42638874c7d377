"""A checked environment, ready to be matched and planned."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache, cached_property
from operator import attrgetter
from pathlib import Path as FilePath
from typing import Any, TypeAlias

from cfgplan.canonical import fields_of
from cfgplan.domain import Environment
from cfgplan.formats import fields
from cfgplan.formats.places import Passage, Place
from cfgplan.planning import Failures

ANY_IMPORT = ""
"""The key that stands for every imported IRI that is not found."""

FoundImports: TypeAlias = tuple[tuple[str, FilePath | None], ...]
"""The file of each IRI that an ontology imports, sorted by IRI; None: the import is ignored."""


@dataclass(frozen=True)
class EnvironmentFile:
    """An environment, the other inputs of planning, and the places of its parts.

    `origins` maps ("transformation", label), ("unit", id) and ("target", label) to their places.
    """

    path: FilePath
    environment: Environment
    horizon_s: int
    max_cost_us: int | None = None
    ontology_paths: tuple[FilePath, ...] = ()
    survive: Failures | None = None
    imports: FoundImports = ()
    ignores_rules: bool = False
    preferred: tuple[str, ...] = ()
    origins: Mapping[tuple[str, str], Passage] = field(default_factory=dict, repr=False, compare=False)

    __getstate__ = fields_of

    @cached_property
    def digest(self) -> str:
        """SHA-256 (hex) of all input of a plan, including the ontology files, `imports`, `rules` and `prefer`.

        For facts, only the transformations that they leave out count, not their values. Comments, the order of lists
        and fields that planning does not use don't count, nor do imported files that `imports` does not name: to find
        them would take reading ontologies.
        """
        content: list[object] = [
            self.horizon_s,
            self.max_cost_us,
            [
                [
                    t.label,
                    _each(t.inputs, "name tag distinct feedback"),
                    _each(t.outputs, "name tag"),
                    *_each([t], "labor_us upkeep_us pinned required host"),
                ]
                for t in self.environment.library
            ],
            [
                [
                    unit.id,
                    unit.transformation,
                    _each(unit.subscriptions, "port stream.unit stream.port"),
                    _each(unit.publications, "port topic"),
                ]
                for unit in self.environment.units
            ],
            _each(self.environment.targets, "label tag topic priority"),
        ]
        more = _beyond_the_paper(self.environment, self.survive)
        later = list(_later_parts(self.environment))
        if any(more) or later:
            content.append(more)
        if later:
            content.append(later)
        hashed = hashlib.sha256(json.dumps(content, separators=(",", ":")).encode())
        for path in self.ontology_paths:
            hashed.update(_file_digest(path))
        for iri, imported in self.imports:
            hashed.update(hashlib.sha256(iri.encode()).digest() + (b"ignored" if imported is None else b"read"))
            hashed.update(b"" if imported is None else _file_digest(imported))
        hashed.update(b"rules ignored" if self.ignores_rules else b"")
        hashed.update(f"prefers {json.dumps(self.preferred)}".encode() if self.preferred else b"")
        return hashed.hexdigest()

    def place(
        self,
        *,
        unit: str | None = None,
        port: str | None = None,
        target: str | None = None,
        transformation: str | None = None,
        key: str | None = None,
    ) -> Place | None:
        """Where a unit, target or transformation is written, or a port or the value of a key of it; None if nowhere."""
        for kind, name in (("unit", unit), ("target", target), ("transformation", transformation)):
            origin = self.origins.get((kind, name)) if name is not None else None
            if origin is not None:
                if key is not None:
                    return origin.at(key).place
                return (origin if port is None else _port_of(origin, port)).place
        return None


def _port_of(entry: Passage, port: str) -> Passage:
    part: Any = entry.source.data
    for step in entry.path:
        part = part[step]
    for key in ("inputs", "outputs", "topics"):
        ports = part.get(key) if isinstance(part, dict) else None
        if ports and port in ports:
            return entry.at(key, port)
    return entry


def _each(values: Iterable[object], names: str) -> list[Any]:
    return list(map(attrgetter(*names.split()), values))


def _file_digest(path: FilePath) -> bytes:
    return hashlib.sha256(path.read_bytes()).digest() if path.is_file() else b""


_HELD: Mapping[type[fields.Part], str] = {
    fields.EnvironmentPart: "format ontology imports rules prefer horizon max_cost defaults include hosts transfer "
    "links qualities facts survive transformations units targets",
    fields.HostPart: "name cpu memory",
    fields.LinkPart: "",
    fields.AttributePart: "name better worst best",
    fields.TransformationPart: "label host labor upkeep pinned required memory conflicts min_instances "
    "max_instances standby run inputs outputs",
    fields.ConflictsPart: "system",
    fields.InputPart: "tag distinct feedback",
    fields.OutputPart: "tag quality rate size",
    fields.UnitPart: "id transformation inputs topics host standby",
    fields.TargetPart: "label topic tag priority quality host",
}
"""The keys with a part of their own in digests. Any other key that planning uses counts if it is not default."""


def later_fields(part: type[fields.Part], value: object) -> dict[str, object]:
    """A value's later fields that planning uses, without defaults, by the domain's names."""
    rows = _later_rows(part).items()
    return {row.to: getattr(value, row.to) for key, row in rows if part.plain(key, value) is not None}


@cache
def _later_rows(part: type[fields.Part]) -> Mapping[str, fields.FieldRow]:
    held = _HELD[part].split()
    return {key: row for key, row in part.rows().items() if fields.Use.PLANNING in row.use and key not in held}


def _later_parts(environment: Environment) -> Iterator[list[object]]:
    library = environment.library
    groups: list[tuple[type[fields.Part], Iterable[tuple[str, object]]]] = [
        (fields.EnvironmentPart, [("", environment)]),
        (fields.HostPart, ((host.name, host) for host in environment.hosts)),
        (fields.LinkPart, ((str(number), link) for number, link in enumerate(environment.links))),
        (fields.AttributePart, ((attribute.name, attribute) for attribute in environment.qualities)),
        (fields.TransformationPart, ((t.label, t) for t in library)),
        (fields.ConflictsPart, ((t.label, t) for t in library)),
        (fields.InputPart, ((f"{t.label}/{port.name}", port) for t in library for port in t.inputs)),
        (fields.OutputPart, ((f"{t.label}/{port.name}", port) for t in library for port in t.outputs)),
        (fields.UnitPart, ((unit.id, unit) for unit in environment.units)),
        (fields.TargetPart, ((target.label, target) for target in environment.targets)),
    ]
    for part, values in groups:
        for name, value in values if _later_rows(part) else ():
            if said := later_fields(part, value):
                yield [part.__name__, name, said]
    if environment.left_out:
        yield ["left out", "", sorted(environment.left_out)]


def _beyond_the_paper(environment: Environment, survive: Failures | None) -> list[object]:
    """Return the values beyond the paper; every entry is empty for an environment of the paper."""
    placed, library = bool(environment.hosts), environment.library
    measured = bool(environment.qualities)
    numbered = (t for t in library if t.conflicts or t.min_instances or t.max_instances is not None)
    return [
        survive,
        _each(environment.hosts, "name cpu_us memory_mb"),
        environment.transfer_us if placed else 0,
        _each(environment.qualities, "name better worst best"),
        _each((t for t in library if placed and (t.hosts or t.needs_mb)), "label hosts needs_mb"),
        _each(numbered, "label conflicts min_instances max_instances"),
        _each((t for t in library if survive is not None and t.standby_us is not None), "label standby_us"),
        [
            [t.label, p.name, p.bytes_per_s if placed else 0, _each(p.quality, "attribute rule value over")]
            for t in library
            for p in t.outputs
            if (placed and p.bytes_per_s) or (measured and p.quality)
        ],
        [
            [t.label, t.host, _each(t.quality, "attribute bound weight_us")]
            for t in environment.targets
            if t.host or t.quality
        ],
        _each((unit for unit in environment.units if unit.host or unit.standby), "id host standby"),
    ]
