"""The planner comparison with the peers: `python -m experiments.compare --short`, `--full`, `--scale` or `--instance`.

Run from the checkout with `pip install -e '.[peers,plots]'`. An interrupted comparison continues where it stopped.
`cfgplan compare` does the same for your own files, without the peers.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

from rich.console import Console

from cfgplan.comparing import REGISTERED, Limits, entrant
from cfgplan.errors import CfgplanError
from experiments.peers import LED, PEERS, SHARING
from experiments.planning import VARIANTS, takes_part
from experiments.planning.scale_suite import SCALE_SEEDS, scale
from experiments.planning.scaling import measure_loads, write_scale
from experiments.study.instances import named
from experiments.study.invariants import breaches, failures
from experiments.study.report import write_report
from experiments.study.rows import Row, read_rows
from experiments.study.runner import everyone, progress_bar, run
from experiments.study.suites import SUITES, wsc_sets

INSTANCES = {**SUITES, "scale": scale}
ENTRANTS = {**REGISTERED, SHARING.name: SHARING, **VARIANTS, **PEERS}
STUDY = (*REGISTERED, SHARING.name, *(name for name in PEERS if name not in LED))
AT_SCALE = ("cpsat", *VARIANTS, *PEERS)
REPORTS = {
    "own": Path("build", "compare"),
    "short": Path("build", "compare"),
    "full": Path(__file__).parent / "report",
    "scale": Path(__file__).parent / "planning" / "scale",
}
RESULTS = "results.jsonl"
LIMITS = {
    "own": Limits(2.0),
    "short": Limits(2.0),
    "full": Limits(5.0),
    "scale": Limits(30.0, grace_s=60.0, memory_mb=8192),
}


def main() -> int:
    options = _options()
    folder = options.report or REPORTS[options.suite]
    rows = in_order(read_rows(folder / RESULTS) if options.report_only else _rows(options, folder))
    write = write_scale if options.suite == "scale" else write_report
    for path in write(rows, folder):
        print(path)
    for text in failures(rows):
        print(text, file=sys.stderr)
    found = breaches(rows)
    for text in found:
        print(f"CONTRADICTION: {text}", file=sys.stderr)
    return 1 if found else 0


def _rows(options: argparse.Namespace, folder: Path) -> list[Row]:
    console = Console(stderr=True)
    instances = [named(name) for name in options.instance] or list(INSTANCES[options.suite]())
    if options.wsc:
        instances += wsc_sets(options.wsc)
    elif options.suite in SUITES:
        console.print("The sets of the Web Service Challenge are left out: no --wsc DIR.")
    limits = LIMITS[options.suite]
    if options.timeout:
        limits = replace(limits, time_limit_s=options.timeout)
    names = options.planner or (AT_SCALE if options.suite == "scale" else STUDY)
    entrants = [ENTRANTS.get(name) or entrant(name) for name in names]
    among = takes_part if options.suite == "scale" else everyone
    with progress_bar(console) as watch:
        rows = run(instances, entrants, limits, folder / RESULTS, takes_part=among, watch=watch)
    if options.suite == "scale":
        measure_loads((instance for instance in instances if instance.seed == SCALE_SEEDS[0]), folder)
    return rows


def in_order(rows: Iterable[Row]) -> list[Row]:
    """Return the rows sorted by planner, in the order of the registries. Repeated runs are last in the file."""
    places = {name: place for place, name in enumerate(ENTRANTS)}
    return sorted(rows, key=lambda row: places.get(row.planner, len(places)))


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    which = parser.add_mutually_exclusive_group(required=True)
    which.add_argument("--short", dest="suite", action="store_const", const="short", help="under five minutes")
    which.add_argument("--full", dest="suite", action="store_const", const="full", help="the study: half an hour")
    which.add_argument(
        "--scale", dest="suite", action="store_const", const="scale", help="50 to 50,000 transformations: two hours"
    )
    which.add_argument(
        "--instance",
        action="append",
        default=[],
        metavar="NAME",
        help="an instance by its name in the tables, such as 'nao(robots=2)#0' (repeat)",
    )
    known = f"only this planner: {', '.join(ENTRANTS)}, or module:function (repeat)"
    parser.add_argument("--planner", action="append", metavar="NAME", help=known)
    parser.set_defaults(suite="own")
    parser.add_argument("--wsc", type=Path, metavar="DIR", help="a folder with sets of the Web Service Challenge 2008")
    parser.add_argument("--timeout", type=float, metavar="S", help="seconds for a run (short: 2, full: 5, scale: 30)")
    parser.add_argument("--report", type=Path, metavar="DIR", help="where results, tables and plots go")
    parser.add_argument("--report-only", action="store_true", help="write the report again from the results there")
    return parser.parse_args()


if __name__ == "__main__":
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit("interrupted; the same command goes on from here")
    except CfgplanError as error:
        sys.exit(f"error: {error}")
