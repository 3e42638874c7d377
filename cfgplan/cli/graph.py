"""`cfgplan graph`: the update, or the running configuration, as a picture."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from cfgplan.cli import options as shared
from cfgplan.cli.exits import OF_STATUS, Exit
from cfgplan.cli.screen import Screen
from cfgplan.drawing import FORMATS
from cfgplan.errors import InputError
from cfgplan.extras import needed

_ENDINGS = {".svg": "svg", ".png": "png", ".dot": "dot", ".gv": "dot", ".mmd": "mermaid", ".mermaid": "mermaid"}


def add_to(parser: argparse.ArgumentParser) -> None:
    parser.epilog = (
        "example:\n"
        "  cfgplan graph models/nao/2-segmenter-lost.yaml --out update.svg\n"
        "  cfgplan graph models/nao/2-segmenter-lost.yaml --format mermaid"
    )
    shared.add_environment(parser)
    parser.add_argument(
        "--out",
        type=shared.out_file,
        metavar="FILE",
        help="file to write; its ending gives the format (default: standard output)",
    )
    parser.add_argument(
        "--format", choices=FORMATS, help="format of the picture (default: by the file's ending, else svg)"
    )
    parser.add_argument("--running", action="store_true", help="draw only the running configuration, without planning")
    shared.add_planning(parser)
    shared.add_survive(parser)
    shared.add_matching(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace, screen: Screen) -> Exit:
    from cfgplan import api, drawing

    kind = options.format or _kind_of(options.out)
    if kind == "png" and options.out is None and sys.stdout.isatty():
        raise InputError.of("a PNG picture can't be shown in a terminal", mend="name a file by --out, or pipe it on")
    if kind != "mermaid":
        needed("pictures", "pygraphviz")
    world = shared.load(options, screen)
    code, change_set = Exit.OK, None
    if not options.running:
        task = shared.task(options, screen, world)
        with task.planned(screen) as work:
            _, plan = api.solved(task.problem, **task.planning, report=work.report)
        code, change_set = OF_STATUS[plan.status], plan.change_set
        if change_set is None:
            screen.warn(f"there is no update to draw ({plan.status}): the picture shows the running configuration")
    image = drawing.picture(world.environment, change_set).render(kind)
    if options.out:
        api.write_file(Path(options.out), image)
        screen.note(f"Wrote {options.out}.")
    else:
        screen.write_bytes(image)
    return code


def _kind_of(out: str | None) -> str:
    if out is None:
        return "svg"
    ending = Path(out).suffix.lower()
    if ending not in _ENDINGS:
        what = (
            f"no picture format ends in {ending!r}"
            if ending
            else "the file name has no ending that gives the picture's format"
        )
        raise InputError.of(what, file=out, mend=f"end it in one of {', '.join(_ENDINGS)}, or add --format")
    return _ENDINGS[ending]
