"""`cfgplan demo`: play the paper's case study on running processes, and write a page about it."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from cfgplan.cli import options as shared
from cfgplan.cli.exits import Exit
from cfgplan.cli.screen import Screen
from cfgplan.errors import InputError
from cfgplan.extras import needed

_HERE = Path(__file__)
_FOLDERS = (_HERE.parents[1] / "worlds", _HERE.parents[2] / "models")
"""In an installed package, and in a clone of the repository."""


def add_to(parser: argparse.ArgumentParser) -> None:
    parser.epilog = (
        "example:\n  cfgplan demo nao\n  cfgplan demo nao --page\n  cfgplan demo nao --step 2s --report page.html"
    )
    parser.add_argument(
        "world", metavar="WORLD", nargs="?", choices=("nao",), default="nao", help="the demo to play (only: nao)"
    )
    shared.add_time(parser, "--step", 6.0, "how long to show each step (default: 6s)")
    page = "HTML report to write (default: nao.html)"
    parser.add_argument("--report", type=shared.out_file, metavar="FILE", default="nao.html", help=page)
    shared.add_page(parser, "the demo")
    shared.add_json(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace, screen: Screen) -> Exit:
    if options.page is not None:
        shared.needed_for_pages()
        shared.check_port("--page", options.page, "the page")
    sys.path.insert(0, str(_folder(options.world)))
    from nao_demo.narrator import show

    show(screen, options.step, Path(options.report), options.page)
    return Exit.OK


def _folder(world: str) -> Path:
    """Return the folder of the world's files and its play. Raises InputError if these or their packages are missing."""
    needed("demos", "cv2", "jinja2", "matplotlib")
    for place in _FOLDERS:
        if (place / world / "units.py").is_file():
            return place / world
    raise InputError.of(
        f"the world {world!r} is neither in the installed package nor in a clone around it",
        mend="install cfgplan from its repository, or from a wheel that holds models/",
    )
