"""`cfgplan compare`: planners side by side on the user's own files or on a suite of generated instances."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory, TemporaryFile
from typing import TYPE_CHECKING

from cfgplan.cli import options as shared
from cfgplan.cli.exits import Exit
from cfgplan.cli.screen import Screen
from cfgplan.errors import InputError

if TYPE_CHECKING:
    from rich.console import RenderableType

    from cfgplan.comparing import Instance, Row
    from cfgplan.comparing.report import Table


def add_to(parser: argparse.ArgumentParser) -> None:
    from cfgplan.comparing.suites import SUITES

    parser.epilog = (
        "example:\n"
        "  cfgplan compare models/nao/2-segmenter-lost.yaml models/building/office.yaml\n"
        "  cfgplan compare --instance 'random_library(transformations=50, depth=8)#7' --timeout 2\n"
        "  cfgplan compare --suite short --planner cpsat --planner branch-and-bound --report build/compare"
    )
    parser.add_argument("envs", metavar="ENV", nargs="*", help="environment files to plan for")
    parser.add_argument("--suite", choices=SUITES, help="generated instances to plan for")
    parser.add_argument(
        "--instance",
        action="append",
        default=[],
        metavar="NAME",
        help="a generated instance, such as 'nao(robots=2)#0' (repeat)",
    )
    parser.add_argument("--wsc", metavar="DIR", help="folder with sets of the Web Service Challenge 2008 to plan for")
    parser.add_argument(
        "--planner",
        action="append",
        metavar="NAME",
        help="only this planner; one of your own as module:function (repeat)",
    )
    parser.add_argument("--timeout", type=shared.positive, default=10.0, metavar="S", help="seconds for each run (10)")
    parser.add_argument(
        "--memory", type=shared.whole_seconds, metavar="MB", help="largest address space of a run, in megabytes"
    )
    parser.add_argument(
        "--results", metavar="FILE", help="keep every run as a JSON line; what is there already is not run again"
    )
    parser.add_argument("--report", metavar="DIR", help="write tables and plots to DIR (needs matplotlib)")
    shared.add_matching(parser)
    shared.add_json(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace, screen: Screen) -> Exit:
    from rich.console import Console

    from cfgplan import comparing
    from cfgplan.comparing.invariants import breaches
    from cfgplan.comparing.runner import progress_bar

    entrants = [comparing.entrant(name) for name in options.planner or comparing.REGISTERED]
    limits = comparing.Limits(time_limit_s=options.timeout, memory_mb=options.memory)
    for planner in entrants:
        if planner.function:
            comparing.require(planner, limits)
    if options.report:
        _require_report(Path(options.report))
    instances = _instances(options, screen)
    with TemporaryDirectory() as folder, progress_bar(Console(stderr=True)) as watch:
        results = Path(options.results or Path(folder, "results.jsonl"))
        rows = comparing.run(instances, entrants, limits, results, watch=watch)
    found = breaches(rows)
    if screen.json:
        screen.show_json({"runs": [asdict(row) for row in rows], "contradictions": found})
    else:
        _show(rows, found, screen)
    if options.report:
        _write_report(rows, Path(options.report), screen)
    return Exit.INVALID if found else Exit.OK


def _instances(options: argparse.Namespace, screen: Screen) -> list[Instance]:
    from cfgplan import api, comparing
    from cfgplan.comparing.suites import SUITES, wsc_sets

    instances = []
    for env in options.envs:
        with screen.phase("load"):
            world = api.load(env)
        instances.append(comparing.given(env, shared.problem(options, screen, world)))
    if options.suite:
        instances += SUITES[options.suite]()
    instances += map(comparing.named, options.instance)
    if options.wsc:
        instances += wsc_sets(Path(options.wsc))
    if not instances:
        raise InputError.of(
            "there is nothing to compare planners on", mend="name environment files, a --suite or --wsc"
        )
    return instances


def _show(rows: list[Row], found: list[str], screen: Screen) -> None:
    from rich.text import Text

    from cfgplan.comparing.report import detail, overview

    for table in (detail(rows), overview(rows)):
        if sys.stdout.isatty():
            screen.show(_drawn(table))
        else:
            screen.write(table.markdown() + "\n")
    for text in found:
        screen.show(Text(f"contradiction: {text}", style="bold red"))
    if not found and any(row.proven for row in rows):
        screen.show(Text("All proofs agree, and every plan passes the judge.", style="bold green"))


def _drawn(table: Table) -> RenderableType:
    from rich import box
    from rich.table import Table as Drawn

    drawn = Drawn(title=table.title, title_justify="left", box=box.SIMPLE)
    for head in table.heads:
        drawn.add_column(head, overflow="fold")
    for line in table.lines:
        drawn.add_row(*line)
    return drawn


def _require_report(folder: Path) -> None:
    """Check before the runs that a report can be written to the folder. Raises InputError."""
    if find_spec("matplotlib") is None:
        raise InputError.of("the report can't be drawn without matplotlib", mend="pip install 'cfgplan[plots]'")
    with _writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        with TemporaryFile(dir=folder):
            pass


def _write_report(rows: list[Row], folder: Path, screen: Screen) -> None:
    from cfgplan.comparing.report import write_report

    with _writing(folder):
        files = write_report(rows, folder)
    screen.note(f"Wrote {', '.join(map(str, files))}.")


@contextmanager
def _writing(folder: Path) -> Iterator[None]:
    """Raises InputError where the report can't be written to the folder."""
    try:
        yield
    except OSError as error:
        mend = "name a folder that may be written to"
        raise InputError.of(f"the report can't be written: {error.strerror}", file=str(folder), mend=mend) from None
