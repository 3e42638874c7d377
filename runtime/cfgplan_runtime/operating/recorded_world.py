"""The environment of a run as its recording keeps it: a file of the environment, and a file of its ontology."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from cfgplan.api import World
from cfgplan.formats.dump import dump_yaml, plain_environment
from cfgplan.transformations import Transformation
from cfgplan_runtime.operating.recorded import ENVIRONMENT, ONTOLOGY


def world_files(world: World, folder: Path) -> Iterator[tuple[str, str]]:
    """Yield names and texts of files from which a world can be loaded again: no templates, includes or imports are
    left.

    Unit code in `folder` is named by its whole path. The ontology has the axioms that reasoners got.
    """
    environment = world.environment
    library = tuple(replace(one, source=_whole(one, folder)) for one in environment.library)
    ontology, preferred = world.ontology, () if world.file is None else world.file.preferred
    plain = plain_environment(
        replace(environment, library=library),
        horizon_s=world.horizon_s,
        max_cost_us=world.max_cost_us,
        ontology=() if ontology.is_open else (ONTOLOGY,),
        survive=world.survive,
        preferred=preferred,
    )
    yield ENVIRONMENT, dump_yaml(plain)
    if not ontology.is_open:
        prefixes = "".join(f"Prefix({name}:=<{iri}>)\n" for name, iri in sorted(ontology.prefixes.items()))
        axioms = "\n".join(sorted(ontology.axioms))
        yield ONTOLOGY, f"{prefixes}Ontology(\n{axioms}\n)\n"


def _whole(transformation: Transformation, folder: Path) -> str | None:
    """A source whose files have their whole paths."""
    source = transformation.source
    if source is None:
        return None
    program = "program:./"
    if source.startswith(program):
        return f"program:{folder / source.removeprefix(program)}"
    file, colon, name = source.rpartition(":")
    return f"{folder / file}:{name}" if colon and file.endswith(".py") else source
