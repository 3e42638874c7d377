"""`cfgplan import`: what others wrote, as an environment file."""

from __future__ import annotations

import argparse
from pathlib import Path

from cfgplan.cli import options as shared
from cfgplan.cli.exits import Exit
from cfgplan.cli.screen import Screen


def add_to(verbs: shared.Subparsers) -> None:
    parser = shared.add_verb(
        verbs,
        "import",
        "turn the paper's XML, or a web service composition test set, into an environment file",
        "  cfgplan import xml specifications/ --out env.yaml\n  cfgplan import wsc wsc08/set01 --out set01.yaml",
    )
    parser.add_argument("what", choices=("xml", "wsc"), help="what to read")
    parser.add_argument("path", metavar="PATH", help="XML file or folder of them; folder of a test set")
    shared.add_out(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace, screen: Screen) -> Exit:
    from cfgplan import api

    with screen.phase("import"):
        text = api.imported_text(Path(options.path), options.what)
    shared.put(text, options.out, screen)
    return Exit.OK
