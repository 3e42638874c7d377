"""`cfgplan init`: a small environment of one's own, with its ontology and unit code."""

from __future__ import annotations

import argparse
from pathlib import Path

from cfgplan.cli.exits import Exit
from cfgplan.cli.screen import Screen
from cfgplan.errors import Fault, InputError

_START = Path(__file__).parents[1] / "manual" / "start"


def add_to(parser: argparse.ArgumentParser) -> None:
    parser.epilog = "example:\n  cfgplan init kitchen"
    parser.add_argument("folder", metavar="FOLDER", nargs="?", default=".", help="where to write it (this folder)")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace, screen: Screen) -> Exit:
    from cfgplan import api

    folder = Path(options.folder)
    start = sorted(path for path in _START.iterdir() if path.is_file())
    there = [folder / path.name for path in start if (folder / path.name).exists()]
    if there:
        mend = "name another folder: nothing is overwritten"
        raise InputError([Fault("this file is there already", file=str(path), mend=mend) for path in there])
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        mend = "name a folder that exists or can be made"
        raise InputError.of(f"this folder can't be made: {error.strerror}", file=options.folder, mend=mend) from None
    for path in start:
        api.write_file(folder / path.name, path.read_bytes())
    env = folder / "env.yaml"
    screen.write(
        f"Wrote {', '.join(str(folder / path.name) for path in start)}. Next:\n"
        f"  cfgplan solve {env}\n"
        f"  cfgplan solve {env} --without thermometer\n"
        f"  cfgplan run {env}          and in another terminal: cfgplan listen /fire\n"
        "  cfgplan help tutorial\n"
    )
    return Exit.OK
