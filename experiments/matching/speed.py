"""Measures the matrix and the registration of one transformation, and writes a table.

    python experiments/matching/speed.py --out experiments/matching/speed.md

Times are CPU seconds, which other processes change little; compare mainly the ratios in one run. HermiT is measured
only at the small sizes. "Reading the changed matrix" builds the whole relation again.
"""

from __future__ import annotations

import argparse
import multiprocessing
import resource
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path

from realistic import realistic_world
from small_worlds import World

from cfgplan.matching import Matcher, match

HERMIT_UP_TO = 1000
HERMIT_PATIENCE_S = 240.0
TRANSFORMATIONS = 15


def measure(tags: int) -> dict[str, float]:
    """Return times in seconds and the peak memory in MB for one world, measured in a new process."""
    world = realistic_world(tags)
    newcomers = realistic_world(tags, seed=1)
    found: dict[str, float] = {"tags": len(world.offered) + len(world.demanded), "axioms": len(world.ontology.axioms)}
    found["reading the ontology's axioms"] = _timed(lambda: (world.ontology.trees, world.ontology.classes))
    matcher = Matcher(world.ontology)

    def matrix() -> None:
        matcher.add(offered=world.offered, demanded=world.demanded)
        matcher.matching()

    found["matrix, everything from the tags' texts"] = _timed(matrix)
    found["peak memory, MB"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    found["matches"] = sum(map(len, matcher.matching().similarity.offers.values()))
    registered, rows, removed = [], [], []
    for number in range(TRANSFORMATIONS):
        offered = newcomers.offered[2 * number : 2 * number + 2]
        demanded = newcomers.demanded[2 * number : 2 * number + 2]
        registered.append(_timed(lambda: matcher.add(offered=offered, demanded=demanded)))  # noqa: B023
        rows.append(_timed(matcher.matching))
        removed.append(_timed(lambda: matcher.remove(offered=offered, demanded=demanded)))  # noqa: B023
    found["registering one transformation, ms"] = statistics.median(registered) * 1000
    found["reading the changed matrix, ms"] = statistics.median(rows) * 1000
    found["removing one transformation, ms"] = statistics.median(removed) * 1000
    if tags <= HERMIT_UP_TO:
        found["HermiT, the same matrix"] = _timed(lambda: _by_hermit(world))
        found["HermiT / fast engine"] = (
            found["HermiT, the same matrix"] / found["matrix, everything from the tags' texts"]
        )
    return found


def _by_hermit(world: World) -> None:
    answer = match(world.offered, world.demanded, world.ontology, reasoner="hermit", time_limit_s=HERMIT_PATIENCE_S)
    if not answer.similarity.open:
        fast = match(world.offered, world.demanded, world.ontology)
        if fast.similarity != answer.similarity:
            raise SystemExit("the fast engine and HermiT disagree")


def _timed(action: Callable[[], object]) -> float:
    """CPU seconds, those of processes that were started and ended among them."""
    started = _cpu_s()
    action()
    return _cpu_s() - started


def _cpu_s() -> float:
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


def main() -> None:
    """Measure each size and print or write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tags", type=int, nargs="+", default=[200, 1000, 5000, 20000, 50000])
    parser.add_argument("--out", type=Path, default=None)
    options = parser.parse_args()
    with multiprocessing.get_context("spawn").Pool(1, maxtasksperchild=1) as pool:
        found = pool.map(measure, options.tags, chunksize=1)
    names = dict.fromkeys(name for column in found for name in column)
    lines = ["| | " + " | ".join(f"{tags:,} tags" for tags in options.tags) + " |", "|---|" + "---:|" * len(found)]
    lines += [f"| {name} | " + " | ".join(_shown(column.get(name)) for column in found) + " |" for name in names]
    text = "\n".join(lines) + "\n"
    sys.stdout.write(text)
    if options.out is not None:
        options.out.write_text(text)


def _shown(value: float | None) -> str:
    if value is None:
        return ""
    return f"{value:,.0f}" if value >= 100 or value == int(value) else f"{value:.3g}"


if __name__ == "__main__":
    main()
