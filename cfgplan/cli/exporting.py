"""`cfgplan export`: the JSON Schema of the environment file, or an environment in another format."""

from __future__ import annotations

import argparse
from pathlib import Path

from cfgplan.cli import options as shared
from cfgplan.cli.exits import Exit
from cfgplan.cli.screen import Screen
from cfgplan.errors import InputError


def add_to(verbs: shared.Subparsers) -> None:
    parser = shared.add_verb(
        verbs,
        "export",
        "write the environment file's JSON Schema, or an environment as YAML or the paper's XML",
        "  cfgplan export schema --out cfgplan.schema.json\n"
        "  cfgplan export xml models/nao/1-piff-registered.yaml --out nao.xml",
    )
    parser.add_argument("what", choices=("schema", "xml", "yaml"), help="what to write")
    parser.add_argument("env", metavar="ENV", nargs="?", help="environment file (for xml and yaml)")
    shared.add_out(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace, screen: Screen) -> Exit:
    from cfgplan import api

    if options.what == "schema":
        text = api.schema_text()
    else:
        if options.env is None:
            raise InputError.of(f"name the environment file to export as {options.what}")
        text = api.converted(Path(options.env), options.what)
    shared.put(text, options.out, screen)
    return Exit.OK
