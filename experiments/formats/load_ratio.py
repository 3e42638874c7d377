"""The cost of loading before and after a change: `python experiments/formats/load_ratio.py BEFORE AFTER`.

Each checkout in turn loads libraries of three sizes by `cfgplan.load`, each in a new process that has loaded a small
file before. Prints the medians of CPU seconds and of peak memory, and the median of the ratios of the pairs. The
libraries have no ontology. The last row is a whole process of `cfgplan solve` on the README's case, with compiled
files and cached answers about tags.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

from cfgplan.formats.dump import dump_yaml, plain_environment
from experiments.families.random_library import random_library

SIZES = (1_000, 10_000, 100_000)
SOLVED = "import sys; from cfgplan.cli import main; sys.exit(main())"
LOADED = """
import re, sys, time
import cfgplan
cfgplan.load(sys.argv[1])
began = time.process_time()
world = cfgplan.load(sys.argv[2])
took = time.process_time() - began
print(took, int(re.search(r"VmHWM:\\s+(\\d+)", open("/proc/self/status").read())[1]) / 1024)
"""


def loaded(checkout: Path, small: Path, file: Path) -> tuple[float, float]:
    """Return the CPU seconds of a load, and the peak memory of its process in MiB."""
    search = {"PYTHONPATH": f"{checkout}:{checkout / 'runtime'}"}
    command = [sys.executable, "-c", LOADED, str(small), str(file)]
    done = subprocess.run(command, env=os.environ | search, stdout=subprocess.PIPE, text=True, check=True, cwd=checkout)
    seconds, peak = map(float, done.stdout.split())
    return seconds, peak


def solved(checkout: Path, folder: Path) -> tuple[float, float]:
    """Return the CPU seconds of a process that solves the README's case, and 0: its memory is not measured."""
    kept = folder / checkout.name
    search = {"PYTHONPATH": f"{checkout}:{checkout / 'runtime'}", "XDG_CACHE_HOME": str(kept / "answers")}
    environment = {**os.environ, **search, "PYTHONPYCACHEPREFIX": str(kept / "compiled")}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [sys.executable, "-c", SOLVED, "solve", "models/nao/2-segmenter-lost.yaml"]
    subprocess.run(command, env=environment, capture_output=True, check=True, cwd=checkout)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, 0


def print_row(what: str, pairs: list[tuple[tuple[float, float], tuple[float, float]]]) -> None:
    """Print the medians of pairs of seconds and MiB, before and after."""
    (old_s, old_mib), (new_s, new_mib) = ([*map(median, zip(*side, strict=True))] for side in zip(*pairs, strict=True))
    ratio = median(new / old for (old, _), (new, _) in pairs)
    memory = f" {old_mib:>5.0f} MiB {new_mib:>5.0f} MiB" if new_mib else ""
    print(f"{what:>15} {old_s:>7.2f} s {new_s:>7.2f} s {ratio:>6.2f}{memory}")


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("before", type=Path)
    parser.add_argument("after", type=Path)
    parser.add_argument("--pairs", type=int, default=5)
    parser.add_argument("--sizes", type=int, nargs="+", default=SIZES)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    before, after = options.before.resolve(), options.after.resolve()
    print(f"{'transformations':>15} {'before':>9} {'after':>9} {'ratio':>6} {'before':>9} {'after':>9}")
    with TemporaryDirectory() as folder:
        small, file = Path(folder, "small.yaml"), Path(folder, "library.yaml")
        small.write_text("format: cfgplan/1\nhorizon: 1\ntransformations: []\n")
        for size in options.sizes:
            problem = random_library(options.seed, transformations=size, depth=10, targets=1)
            file.write_text(dump_yaml(plain_environment(problem.environment, horizon_s=60)))
            pairs = [(loaded(before, small, file), loaded(after, small, file)) for _ in range(options.pairs)]
            print_row(f"{size:,}", pairs)
        for checkout in (before, after):  # compiles, and keeps the answers
            solved(checkout, Path(folder))
        print_row("solve", [(solved(before, Path(folder)), solved(after, Path(folder))) for _ in range(options.pairs)])


if __name__ == "__main__":
    main()
