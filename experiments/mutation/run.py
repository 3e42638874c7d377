"""Breaks one rule at a time, and lists the mutants that no test notices: `python experiments/mutation/run.py`.

Each mutant is written into a copy of the project, where the tests of its room run until one fails. The exit code is 1
if a mutant survived; also, before any test runs, if the text that a mutant replaces is not found exactly once.
"""

from __future__ import annotations

import argparse
import os
import shutil
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from queue import Queue

import hypothesis.strategies  # noqa: F401
import networkx  # noqa: F401
import numpy  # noqa: F401
import ortools.sat.python.cp_model  # noqa: F401
import pydantic  # noqa: F401
import pytest
from table import MUTANTS, Mutant

PROJECT = Path(__file__).parents[2]
PARTS = ("cfgplan", "runtime", "tests", "models", "experiments", "pyproject.toml", "README.md")
KILLED, SURVIVED = 1, 0
"""What pytest ends with where a test failed, and where none did."""
PATIENCE_S = 600


def stale() -> list[str]:
    """Return the mutants whose text does not occur in their file exactly once."""
    found = []
    for mutant in MUTANTS:
        times = (PROJECT / mutant.file).read_text(encoding="utf-8").count(mutant.old)
        if times != 1:
            found.append(f"{mutant.file}: {mutant.broken}: its text is there {times} times")
    return found


def verdict(tree: Path, mutant: Mutant | None, tests: tuple[str, ...]) -> int | None:
    """Return pytest's exit code in a copied tree, with a mutant or without; a timeout counts as a failure."""
    path = tree / mutant.file if mutant is not None else None
    whole = path.read_text(encoding="utf-8") if path is not None else ""
    if path is not None and mutant is not None:
        path.write_text(whole.replace(mutant.old, mutant.new), encoding="utf-8")
    child = get_context("fork").Process(target=_run_tests, args=(tree, tests))
    child.start()
    child.join(PATIENCE_S)
    code = KILLED if child.is_alive() else child.exitcode
    child.kill()
    child.join()
    if path is not None:
        path.write_text(whole, encoding="utf-8")
    return code


def _run_tests(tree: Path, tests: tuple[str, ...]) -> None:
    """In a process of its own, to which the heavy packages are known already, but no module of the project."""
    sys.path[:0] = paths = [str(tree), str(tree / "runtime")]
    os.environ["PYTHONPATH"] = os.pathsep.join(paths)
    sys.dont_write_bytecode = True
    os.chdir(tree)
    with Path(os.devnull).open("w", encoding="utf-8") as nowhere:
        os.dup2(nowhere.fileno(), 1)
        os.dup2(nowhere.fileno(), 2)
        code = pytest.main(["-q", "-x", "-n", "0", "-p", "no:cacheprovider", *tests])
    os._exit(int(code))


def survivors(mutants: list[Mutant], processes: int) -> list[Mutant]:
    """Return the mutants that no test kills, running several at a time; raises if pytest fails otherwise."""
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
        free: Queue[Path] = Queue()
        for tree in trees:
            free.put(tree)
        verdicts = pool.map(lambda mutant: _survives(free, mutant), mutants)
        return [mutant for mutant, survives in zip(mutants, verdicts, strict=True) if survives]


def _survives(free: Queue[Path], mutant: Mutant) -> bool:
    tree = free.get()
    code = verdict(tree, mutant, mutant.tests)
    free.put(tree)
    if code not in (KILLED, SURVIVED):
        raise RuntimeError(f"{mutant.file}: {mutant.broken}: pytest ended with {code}")
    print(f"{'SURVIVES' if code == SURVIVED else 'killed'}  {mutant.file}: {mutant.broken}", flush=True)
    return code == SURVIVED


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
