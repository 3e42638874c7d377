"""Compares the planner with the oracle on random environments of each kind: `python experiments/planning/night.py`.

Cost, rewired and started units, status and the judge's word are compared. Environments are drawn a hundred at a time,
each time from a seed. `--record` is a file with a line for each compared seed; these are not compared again: delete the
file to start over. Ends with 1 on any difference. With `--seed` the hundred of one seed of one kind are compared, and
the smallest environment that differs is shown.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import sys
import time
from collections import defaultdict
from collections.abc import Iterator
from itertools import count, islice
from pathlib import Path
from typing import Any

from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import seed as from_seed

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parents[1] / "tests" / "planners"))
os.environ["CFGPLAN_SHARE"] = "1"  # the oracle may take all its steps

from kinds import KINDS, LeftOpenError  # noqa: E402

AT_A_TIME = 100


def compared(kind: str, seed: int, *, shrinks: bool = False) -> dict[str, Any]:
    """Return the number of environments of one seed that were compared, the number left undecided, and the differences.

    With `shrinks` it raises an error with the smallest environment that differs.
    """
    number, left_open, wrong = 0, 0, []

    @from_seed(seed)
    @settings(
        max_examples=AT_A_TIME,
        database=None,
        deadline=None,
        phases=[Phase.generate, Phase.shrink] if shrinks else [Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(KINDS[kind].drawn)
    def compare(drawn: Any) -> None:
        nonlocal number, left_open
        try:
            found = KINDS[kind].differences(drawn)
        except LeftOpenError:
            found, left_open = [], left_open + 1
        except (AssertionError, ArithmeticError, LookupError, TypeError, ValueError, RuntimeError) as error:
            found = [f"{type(error).__name__}: {error}"]
        number += 1
        wrong.extend(found)
        assert not (shrinks and found), found

    compare()
    return {"kind": kind, "seed": seed, "compared": number, "open": left_open, "differences": wrong}


def _of_task(task: tuple[str, int]) -> dict[str, Any]:
    return compared(*task)


def known(record: Path) -> Iterator[dict[str, Any]]:
    if record.exists():
        yield from map(json.loads, record.read_text(encoding="utf-8").splitlines())


def run(kinds: list[str], each: int, processes: int, record: Path) -> int:
    """Compare the missing seeds of each kind; returns the number of seeds with differences."""
    numbers: dict[str, int] = defaultdict(int)
    left_open: dict[str, int] = defaultdict(int)
    seen: dict[str, set[int]] = defaultdict(set)
    bad = 0
    for line in known(record):
        numbers[line["kind"]] += line["compared"]
        left_open[line["kind"]] += line.get("open", 0)
        seen[line["kind"]].add(line["seed"])
        bad += line["kind"] in kinds and bool(line["differences"])
    with multiprocessing.get_context("spawn").Pool(processes) as pool, record.open("a", encoding="utf-8") as lines:
        for kind in kinds:
            began, before = time.monotonic(), numbers[kind]
            while numbers[kind] < each:
                seeds = (seed for seed in count() if seed not in seen[kind])
                missing = -(-(each - numbers[kind]) // AT_A_TIME)
                for line in pool.imap_unordered(_of_task, [(kind, seed) for seed in islice(seeds, missing)]):
                    print(json.dumps(line), file=lines, flush=True)
                    seen[kind].add(line["seed"])
                    numbers[kind] += line["compared"]
                    left_open[kind] += line["open"]
                    if line["differences"]:
                        bad += 1
                        print(f"\n{kind} --seed {line['seed']}: {line['differences'][0]}")
                    pace = (numbers[kind] - before) / (time.monotonic() - began)
                    text = f"\r{kind}: {numbers[kind]:,} of {each:,}, {pace:.0f} a second, {bad} seeds with differences"
                    print(text, end="", file=sys.stderr, flush=True)
            print(file=sys.stderr)
    for kind in kinds:
        print(f"{kind}: {numbers[kind]:,} environments compared with the oracle, {left_open[kind]} of them left open")
    print(f"{bad} seeds with differences" if bad else "0 differences")
    return bad


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kinds", nargs="+", choices=list(KINDS), default=list(KINDS), help="default: all")
    parser.add_argument("--each", type=int, default=10_000, help="environments of each kind (default 10,000)")
    parser.add_argument("--processes", type=int, default=2, help="default 2")
    parser.add_argument(
        "--record", type=Path, default=HERE / "night.jsonl", help="default night.jsonl beside this file"
    )
    parser.add_argument("--seed", type=int, help="only this one, of the first of the kinds")
    chosen = parser.parse_args()
    if chosen.seed is not None:
        print(compared(chosen.kinds[0], chosen.seed, shrinks=True))
        return
    sys.exit(1 if run(chosen.kinds, chosen.each, chosen.processes, chosen.record) else 0)


if __name__ == "__main__":
    main()
