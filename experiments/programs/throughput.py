"""Elements per second through one C program and through a Python unit, compared in one run.

python experiments/programs/throughput.py [--seconds 2] [--rounds 5] [--json FILE]

A source sends elements as fast as the consumer takes them. Each round measures the Python unit and the programs one
after the other. The result is the median over the rounds of a program's rate divided by that of the Python unit; the
aim is more than 0.5.
"""

from __future__ import annotations

import argparse
import json
import shutil
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from cfgplan_runtime import Runtime, subscribe

from cfgplan.domain import (
    ChangeSet,
    ComputationUnit,
    InputPort,
    OutputPort,
    Publication,
    RunOptions,
    Stream,
    Subscription,
    Target,
    Transformation,
)
from cfgplan.transformations import ProgramFormat

HERE = Path(__file__).parent
UNITS = HERE.parent / "runtime"
MASK = HERE.parents[1] / "models" / "programs" / "mask.c"
SMALL, IMAGE = 16, 460_800
TARGET = Target("t", "N", "/result")
CASES: tuple[tuple[str, int, str, ProgramFormat], ...] = (
    ("small elements, msgpack", SMALL, "program:{folder}/mask 128 y", "msgpack"),
    ("small elements, JSON", SMALL, "program:{folder}/same", "json"),
    ("images of 460 kB, msgpack", IMAGE, "program:{folder}/mask 128 y", "msgpack"),
)
PYTHON = "measured_units.py:same"


def compiled(folder: Path) -> None:
    for source in (MASK, HERE / "same.c"):
        subprocess.run(["cc", "-O3", "-o", folder / source.stem, source], check=True)


def rate(source: str, size: int, form: ProgramFormat, seconds: float) -> float:
    """Return the elements per second that a unit with the code `source` passes on; `size` is in bytes."""
    blocks = RunOptions(blocks=True, format=form)
    port, result = (InputPort("x", "N"),), (OutputPort("y", "N"),)
    library = (
        Transformation(
            "source", outputs=(OutputPort("n", "N"),), source="measured_units.py:stamped", params={"size": size}
        ),
        Transformation("work", port, result, source=source, run=blocks),
        Transformation("ages", port, result, source="measured_units.py:Ages", params={"every": 100}, run=blocks),
    )
    chain = (
        ComputationUnit("source.1", "source"),
        ComputationUnit("work.1", "work", (Subscription("x", Stream("source.1", "n")),)),
        ComputationUnit("ages.1", "ages", (Subscription("x", Stream("work.1", "y")),), (Publication("y", "/result"),)),
    )
    with Runtime(library, [TARGET], folder=UNITS) as runtime:
        runtime.apply(ChangeSet(started=chain))
        with subscribe("/result", run=runtime.id) as results:
            return _rate((received.value for received in results), seconds)


def _rate(reports: Iterator[Any], seconds: float) -> float:
    """Elements per second of reports [count, ..., time in nanoseconds], after the first one."""
    first, count = next(reports), 0
    for report in reports:
        count += report[0]
        if (passed_s := (report[-1] - first[-1]) / 1e9) >= seconds:
            return count / passed_s
    raise RuntimeError("the reports ended")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=2.0, help="how long each figure is measured")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--json", metavar="FILE", help="write all figures to FILE")
    options = parser.parse_args()
    if shutil.which("cc") is None:
        sys.exit("throughput.py: there is no C compiler: install cc")
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as folder:
        compiled(Path(folder))
        for _ in range(options.rounds):
            python = {size: rate(PYTHON, size, "json", options.seconds) for size in (SMALL, IMAGE)}
            for name, size, source, form in CASES:
                per_s = rate(source.format(folder=folder), size, form, options.seconds)
                rows.append({"what": name, "python": python[size], "program": per_s, "ratio": per_s / python[size]})
    for name, *_ in CASES:
        mine = [row for row in rows if row["what"] == name]
        middle = {key: statistics.median(row[key] for row in mine) for key in ("python", "program", "ratio")}
        ratios = ", ".join(f"{row['ratio']:.2f}" for row in mine)
        print(
            f"{name:26} {middle['program']:9,.0f} /s, a Python unit {middle['python']:9,.0f} /s: "
            f"{middle['ratio']:.2f} of it (of each round {ratios})"
        )
    if options.json:
        Path(options.json).write_text(json.dumps(rows, indent=2))


if __name__ == "__main__":
    main()
