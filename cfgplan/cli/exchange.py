"""`cfgplan import` and `cfgplan export`: environment files from what others wrote, and the way back."""

from __future__ import annotations

import argparse
from pathlib import Path

from cfgplan.cli import options as shared
from cfgplan.cli.exits import Exit
from cfgplan.cli.screen import Screen
from cfgplan.errors import InputError


def add_import(parser: argparse.ArgumentParser) -> None:
    parser.epilog = "example:\n  cfgplan import xml specifications/ --out env.yaml"
    parser.add_argument("what", choices=("xml",), help="what to read")
    parser.add_argument("path", metavar="PATH", help="XML file or folder of them")
    shared.add_out(parser)
    parser.set_defaults(run=_import)


def _import(options: argparse.Namespace, screen: Screen) -> Exit:
    from cfgplan import api

    shared.put(api.converted(Path(options.path), "yaml"), options.out, screen)
    return Exit.OK


def add_export(parser: argparse.ArgumentParser) -> None:
    parser.epilog = (
        "example:\n"
        "  cfgplan export schema --out cfgplan.schema.json\n"
        "  cfgplan export xml models/nao/1-piff-registered.yaml --out nao.xml"
    )
    parser.add_argument("what", choices=("schema", "xml", "yaml"), help="what to write")
    parser.add_argument("env", metavar="ENV", nargs="?", help="environment file (for xml and yaml)")
    shared.add_out(parser)
    parser.set_defaults(run=_export)


def _export(options: argparse.Namespace, screen: Screen) -> Exit:
    from cfgplan import api

    if options.what == "schema":
        text = api.schema_text()
    else:
        if options.env is None:
            raise InputError.of("no environment file is named", mend=f"write `cfgplan export {options.what} ENV`")
        text = api.converted(Path(options.env), options.what)
    shared.put(text, options.out, screen)
    return Exit.OK
