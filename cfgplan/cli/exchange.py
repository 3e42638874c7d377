"""`cfgplan import` and `cfgplan export`: environment files from what others wrote, and the way back."""

from __future__ import annotations

import argparse
from pathlib import Path

from cfgplan.cli import options as shared
from cfgplan.cli.exits import Exit
from cfgplan.cli.screen import Screen
from cfgplan.errors import InputError


def add_import(parser: argparse.ArgumentParser) -> None:
    parser.epilog = (
        "example:\n"
        "  cfgplan import xml specifications/ --out env.yaml\n  cfgplan import wsc wsc08/set01 --out set01.yaml"
    )
    parser.add_argument("what", choices=("xml", "wsc"), help="what to read")
    parser.add_argument("path", metavar="PATH", help="XML file or folder of them; folder of a test set")
    parser.add_argument(
        "--objective",
        choices=("services", "length"),
        default="services",
        help="wsc: fewest services, or fewest among the compositions of the shortest length (services)",
    )
    shared.add_out(parser)
    parser.set_defaults(run=_import)


def _import(options: argparse.Namespace, screen: Screen) -> Exit:
    from cfgplan import api

    if options.what == "xml":
        shared.put(api.converted(Path(options.path), "yaml"), options.out, screen)
        return Exit.OK
    if options.out is None:
        message = "a test set becomes two files, the environment and its ontology"
        raise InputError.of(message, mend="name the environment file with --out; the ontology is written beside it")
    ontology = Path(options.out).with_suffix(".ofn")
    environment_text, ontology_text = api.converted_test_set(Path(options.path), options.objective, ontology.name)
    shared.put(ontology_text, str(ontology), screen)
    shared.put(environment_text, options.out, screen)
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
