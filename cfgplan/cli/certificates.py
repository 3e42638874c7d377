"""`cfgplan certificates`: who belongs to a fleet."""

from __future__ import annotations

import argparse
from pathlib import Path

from cfgplan.cli import options as shared
from cfgplan.cli.exits import Exit
from cfgplan.cli.screen import Screen
from cfgplan.errors import InputError


def add_to(parser: argparse.ArgumentParser) -> None:
    parser.epilog = (
        "example:\n"
        "  cfgplan certificates secrets r1=10.0.0.1 r2=10.0.0.2 base=base.local,10.0.0.3 --passes-on base\n"
        "  scp -r secrets/r1 r1:/etc/cfgplan\n\n"
        "FOLDER/authority.key stays where it is: who has it can make certificates. Called again with other hosts it\n"
        "adds them; then copy the access.json of each host again. Hosts reach each other directly, or through those\n"
        "that --passes-on names."
    )
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="where to write; a folder for each host is in it")
    parser.add_argument(
        "hosts", nargs="+", metavar="HOST[=ADDRESS,...]", help="a host's name, and under what others reach it"
    )
    parser.add_argument(
        "--passes-on", action="append", default=[], metavar="HOST", help="may pass on what other hosts write: trust it"
    )
    parser.add_argument("--days", type=shared.count, default=365, metavar="N", help="how long they are valid (365)")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace, screen: Screen) -> Exit:
    from cfgplan_runtime.fleet.certificates import make

    hosts = {}
    for text in options.hosts:
        name, _, addresses = text.partition("=")
        if name in hosts:
            raise InputError.of(f"host {name} is named twice")
        hosts[name] = [address for address in addresses.split(",") if address]
    for folder in make(options.folder, hosts, passing_on=options.passes_on, days=options.days):
        screen.note(f"Wrote {folder}: copy it to {folder.name}.")
    return Exit.OK
