"""A checked environment, ready to be matched and planned."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path as FilePath
from typing import TypeAlias

from cfgplan.domain import Environment
from cfgplan.formats.fields import (
    AttributePart,
    EnvironmentPart,
    HostPart,
    InputPart,
    OutputPart,
    Part,
    TargetPart,
    TransformationPart,
    UnitPart,
    Use,
)
from cfgplan.formats.places import Path, Place, Source
from cfgplan.planning import Failures

ANY_IMPORT = ""
"""Stands for every IRI that is imported and can't be found."""

Imports: TypeAlias = tuple[tuple[str, FilePath | None], ...]
"""The file of each IRI that an ontology imports, sorted by IRI; None: the import is ignored."""


@dataclass(frozen=True)
class EnvironmentFile:
    """An environment with what planning it needs besides, and the way back to its files.

    `origins` maps ("transformation", label), ("unit", id) and ("target", label) to where that is written.
    """

    path: FilePath
    environment: Environment
    horizon_s: int
    max_cost_us: int | None = None
    ontology_paths: tuple[FilePath, ...] = ()
    survive: Failures | None = None
    imports: Imports = ()
    origins: Mapping[tuple[str, str], tuple[Source, Path]] = field(default_factory=dict, repr=False, compare=False)

    @cached_property
    def digest(self) -> str:
        """What tells this world from others, see `environment_digest`."""
        return environment_digest(
            self.environment, self.horizon_s, self.max_cost_us, self.ontology_paths, self.survive, self.imports
        )

    def place(
        self,
        *,
        unit: str | None = None,
        port: str | None = None,
        target: str | None = None,
        transformation: str | None = None,
    ) -> Place | None:
        """Where a unit, target or transformation, or a port of it, is written; None if no file has it."""
        for kind, name in (("unit", unit), ("target", target), ("transformation", transformation)):
            origin = self.origins.get((kind, name)) if name is not None else None
            if origin is not None:
                source, path = origin
                return source.place(path if port is None else _port_path(source, path, port))
        return None


def _port_path(source: Source, path: Path, port: str) -> Path:
    part = source.data
    for step in path:
        part = part[step]  # type: ignore[index]
    for key in ("inputs", "outputs", "topics"):
        ports = part.get(key) if isinstance(part, dict) else None
        if ports and port in ports:
            return (*path, key, port)
    return path


def environment_digest(
    environment: Environment,
    horizon_s: int,
    max_cost_us: int | None = None,
    ontology_paths: Sequence[FilePath] = (),
    survive: Failures | None = None,
    imports: Imports = (),
) -> str:
    """SHA-256 (hex) of all that a plan depends on, the ontology files and `imports` too.

    Comments, the order of lists and fields that planning does not use don't count. Nor does a file that is only found
    by a search for what an ontology imports: to find it would take reading ontologies.
    """
    content: list[object] = [
        horizon_s,
        max_cost_us,
        [
            [
                t.label,
                [[p.name, p.tag, p.distinct, p.feedback] for p in t.inputs],
                [[p.name, p.tag] for p in t.outputs],
                [t.labor_us, t.upkeep_us, t.pinned, t.required, t.host],
            ]
            for t in environment.library
        ],
        [
            [
                u.id,
                u.transformation,
                [[s.port, s.stream.unit, s.stream.port] for s in u.subscriptions],
                [[p.port, p.topic] for p in u.publications],
            ]
            for u in environment.units
        ],
        [[t.label, t.tag, t.topic, t.priority] for t in environment.targets],
    ]
    more = _beyond_the_paper(environment, survive)
    later = list(_later(environment))
    if any(more) or later:
        content.append(more)
    if later:
        content.append(later)
    hashed = hashlib.sha256(json.dumps(content, separators=(",", ":"), default=str).encode())
    for path in ontology_paths:
        hashed.update(_file_digest(path))
    for iri, imported in imports:
        hashed.update(hashlib.sha256(iri.encode()).digest() + (b"ignored" if imported is None else b"read"))
        hashed.update(b"" if imported is None else _file_digest(imported))
    return hashed.hexdigest()


def _file_digest(path: FilePath) -> bytes:
    return hashlib.sha256(path.read_bytes()).digest() if path.is_file() else b""


_HELD: Mapping[type[Part], str] = {
    EnvironmentPart: "format ontology imports horizon max_cost defaults include hosts transfer qualities survive "
    "transformations units targets",
    HostPart: "name cpu memory",
    AttributePart: "name better worst best",
    TransformationPart: "label host labor upkeep pinned required memory conflicts min_instances max_instances standby "
    "run inputs outputs",
    InputPart: "tag distinct feedback",
    OutputPart: "tag quality rate size",
    UnitPart: "id transformation inputs topics host standby",
    TargetPart: "label topic tag priority quality host",
}
"""The keys that digests held before fields were rows. Of every later one counts what a file says, under its key."""


def _later(environment: Environment) -> Iterator[list[object]]:
    values: Mapping[type[Part], list[tuple[str, object]]] = {
        EnvironmentPart: [("", environment)],
        HostPart: [(host.name, host) for host in environment.hosts],
        AttributePart: [(attribute.name, attribute) for attribute in environment.qualities],
        TransformationPart: [(t.label, t) for t in environment.library],
        InputPart: [(f"{t.label}/{port.name}", port) for t in environment.library for port in t.inputs],
        OutputPart: [(f"{t.label}/{port.name}", port) for t in environment.library for port in t.outputs],
        UnitPart: [(unit.id, unit) for unit in environment.units],
        TargetPart: [(target.label, target) for target in environment.targets],
    }
    for part, named in values.items():
        keys = [key for key, row in part.rows().items() if Use.PLANNING in row.use and key not in _HELD[part].split()]
        for name, value in named if keys else ():
            said = {key: plain for key in keys if (plain := part.plain(key, value)) is not None}
            if said:
                yield [part.__name__, name, said]


def _beyond_the_paper(environment: Environment, survive: Failures | None) -> list[object]:
    """What only some environments have: it counts where it is there, and is empty in all others."""
    placed = bool(environment.hosts)
    measured = bool(environment.qualities)
    return [
        survive,
        [[h.name, h.cpu_us, h.memory_mb] for h in environment.hosts],
        environment.transfer_us if placed else 0,
        [[a.name, a.better, a.worst, a.best] for a in environment.qualities],
        [[t.label, t.hosts, t.needs_mb] for t in environment.library if placed and (t.hosts or t.needs_mb)],
        [
            [t.label, t.conflicts, t.min_instances, t.max_instances]
            for t in environment.library
            if t.conflicts or t.min_instances or t.max_instances is not None
        ],
        [[t.label, t.standby_us] for t in environment.library if survive is not None and t.standby_us is not None],
        [
            [
                t.label,
                p.name,
                p.bytes_per_s if placed else 0,
                [[q.attribute, q.rule, q.value, q.over] for q in p.quality],
            ]
            for t in environment.library
            for p in t.outputs
            if (placed and p.bytes_per_s) or (measured and p.quality)
        ],
        [
            [t.label, t.host, [[w.attribute, w.bound, w.weight_us] for w in t.quality]]
            for t in environment.targets
            if t.host or t.quality
        ],
        [[u.id, u.host, u.standby] for u in environment.units if u.host or u.standby],
    ]
