"""A checked environment, ready to be matched and planned."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path as FilePath
from typing import Any, TypeAlias

from cfgplan.canonical import fields_of
from cfgplan.domain import Environment
from cfgplan.formats.places import Passage, Place
from cfgplan.planning import Failures
from cfgplan.rows import planned

ANY_IMPORT = ""
"""The key that stands for every imported IRI that is not found."""

FoundImports: TypeAlias = tuple[tuple[str, FilePath | None], ...]
"""The file of each IRI that an ontology imports, sorted by IRI; None: the import is ignored."""


@dataclass(frozen=True)
class EnvironmentFile:
    """An environment, the other inputs of planning, and the places of its parts.

    `origins` maps kinds and names to places, such as ("transformation", label), ("unit", id), ("target", label) and
    ("host", name).
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

    @property
    def folder(self) -> FilePath:
        """The folder that names of unit code are relative to; a folder of XML files is its own."""
        return self.path if self.path.is_dir() else self.path.parent

    @cached_property
    def digest(self) -> str:
        """SHA-256 (hex) of all input of a plan, including the ontology files, `imports`, `rules` and `prefer`.

        For facts, only the transformations that they leave out, or bar from hosts, count, not their values. Comments,
        the order of lists and fields that planning does not use don't count, nor do imported files that `imports` does
        not name: to find them would take reading ontologies.
        """
        environment = self.environment
        limits = self.horizon_s, self.max_cost_us, self.survive
        barred = sorted((label, sorted(hosts)) for label, hosts in environment.barred.items())
        content = [*limits, planned(environment), sorted(environment.left_out), *([barred] if barred else [])]
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


def _file_digest(path: FilePath) -> bytes:
    return hashlib.sha256(path.read_bytes()).digest() if path.is_file() else b""
