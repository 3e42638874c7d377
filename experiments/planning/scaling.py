"""Additions to the comparison at scale: the loading times of files, and its report."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter

from cfgplan.formats.dump import dump_yaml, plain_environment
from experiments.planning import ALL_SEEDS
from experiments.planning.scale_tables import scale_text
from experiments.study.instances import Instance
from experiments.study.plots import performance_profile
from experiments.study.rows import Row


def measure_loads(instances: Iterable[Instance], folder: Path) -> None:
    """Write the seconds to load the file of each instance to `loads.json`; known times are not measured again."""
    file = folder / "loads.json"
    known = read_loads(folder)
    for instance in instances:
        if instance.name not in known:
            known[instance.name] = load_s(instance)
            folder.mkdir(parents=True, exist_ok=True)
            file.write_text(json.dumps(known, indent=2) + "\n")


def read_loads(folder: Path) -> dict[str, float]:
    """Return the loading times in seconds, by the name of the instance."""
    file = folder / "loads.json"
    known: dict[str, float] = json.loads(file.read_text()) if file.exists() else {}
    return known


def load_s(instance: Instance) -> float:
    """Return the seconds of `cfgplan.load` without an ontology, in a process that has loaded a small file before."""
    problem = instance.problem
    with TemporaryDirectory() as folder:
        small, file = Path(folder, "small.yaml"), Path(folder, "environment.yaml")
        small.write_text("format: cfgplan/1\nhorizon: 1\ntransformations: []\n")
        file.write_text(dump_yaml(plain_environment(problem.environment, horizon_s=problem.horizon_s)))
        code = f"from {__name__} import timed; print(timed({str(small)!r}, {str(file)!r}))"
        done = subprocess.run([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True, check=True)
    return round(float(done.stdout), 4)


def timed(small: str, file: str) -> float:
    import cfgplan

    cfgplan.load(small)
    began = perf_counter()
    cfgplan.load(file)
    return perf_counter() - began


def write_scale(rows: Sequence[Row], folder: Path) -> list[Path]:
    """Write `tables.md` and the performance profile into the folder; returns the files.

    Planners that did not run on all seeds are left out of the profile, where missing runs would look unproven.
    """
    import matplotlib

    matplotlib.use("Agg")
    folder.mkdir(parents=True, exist_ok=True)
    tables, picture = folder / "tables.md", folder / "performance.png"
    tables.write_text(scale_text(rows, read_loads(folder)), encoding="utf-8")
    figure = performance_profile([row for row in rows if row.planner in ALL_SEEDS])
    if figure is None:
        return [tables]
    figure.savefig(picture, dpi=110, metadata={"Software": None})
    return [tables, picture]
