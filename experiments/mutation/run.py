"""Breaks rules one at a time and says which survive: `python experiments/mutation/run.py`.

Each mutant is written into a copy of the project, where the tests of its room run until one fails. Ends with 1 if a
mutant survived, and before anything is run if the text that one replaces is not found exactly once.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from table import MUTANTS, Mutant

PROJECT = Path(__file__).parents[2]
PARTS = ("cfgplan", "runtime", "tests", "models", "experiments", "pyproject.toml", "README.md")
KILLED, SURVIVED = 1, 0
"""What pytest ends with where a test failed, and where none did."""
PATIENCE_S = 600


def stale() -> list[str]:
    """The mutants whose text is not there, or not once."""
    found = []
    for mutant in MUTANTS:
        times = (PROJECT / mutant.file).read_text(encoding="utf-8").count(mutant.old)
        if times != 1:
            found.append(f"{mutant.file}: {mutant.broken}: its text is there {times} times")
    return found


def verdict(tree: Path, mutant: Mutant | None, tests: tuple[str, ...]) -> int:
    """What pytest ends with in a copied tree, with a mutant in it or none; a test that takes too long has failed."""
    path = tree / mutant.file if mutant is not None else None
    whole = path.read_text(encoding="utf-8") if path is not None else ""
    if path is not None and mutant is not None:
        path.write_text(whole.replace(mutant.old, mutant.new), encoding="utf-8")
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-n", "0", "-p", "no:cacheprovider", *tests]
    paths = os.pathsep.join([str(tree), str(tree / "runtime")])
    setting = {**os.environ, "PYTHONPATH": paths, "PYTHONDONTWRITEBYTECODE": "1"}
    try:
        ended = subprocess.run(command, cwd=tree, env=setting, capture_output=True, timeout=PATIENCE_S, check=False)
        return ended.returncode
    except subprocess.TimeoutExpired:
        return KILLED
    finally:
        if path is not None:
            path.write_text(whole, encoding="utf-8")


def survivors(mutants: list[Mutant], processes: int) -> list[Mutant]:
    """Run the tests of each mutant, several at a time; what is neither killed nor survives raises."""
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(processes) as pool:
        trees = [Path(folder) / str(number) for number in range(processes)]
        for tree in trees:
            for part in PARTS:
                source = PROJECT / part
                if source.is_dir():
                    shutil.copytree(source, tree / part, ignore=shutil.ignore_patterns("__pycache__", ".hypothesis"))
                else:
                    shutil.copy(source, tree / part)
        for tests in dict.fromkeys(mutant.tests for mutant in mutants):
            if verdict(trees[0], None, tests) != SURVIVED:
                sys.exit(f"{' '.join(tests)} fail without any mutant")
        shares = [
            list(zip(range(n, len(mutants), processes), mutants[n::processes], strict=True)) for n in range(processes)
        ]
        parts = pool.map(
            lambda one: [(number, *_judged(one[0], mutant)) for number, mutant in one[1]],
            zip(trees, shares, strict=True),
        )
        return [
            mutant
            for _, mutant, survives in sorted((row for part in parts for row in part), key=lambda row: row[0])
            if survives
        ]


def _judged(tree: Path, mutant: Mutant) -> tuple[Mutant, bool]:
    code = verdict(tree, mutant, mutant.tests)
    if code not in (KILLED, SURVIVED):
        raise RuntimeError(f"{mutant.file}: {mutant.broken}: pytest ended with {code}")
    print(f"{'SURVIVES' if code == SURVIVED else 'killed'}  {mutant.file}: {mutant.broken}", flush=True)
    return mutant, code == SURVIVED


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="", help="mutants whose file or name has this text")
    parser.add_argument("--processes", type=int, default=2, help="default 2")
    chosen = parser.parse_args()
    if missing := stale():
        sys.exit("\n".join(missing))
    mutants = [mutant for mutant in MUTANTS if chosen.only in f"{mutant.file}: {mutant.broken}"]
    alive = survivors(mutants, chosen.processes)
    print(f"{len(mutants)} mutants, {len(alive)} survive")
    sys.exit(1 if alive else 0)


if __name__ == "__main__":
    main()
