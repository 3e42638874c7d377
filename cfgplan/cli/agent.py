"""`cfgplan agent` and `cfgplan certificates`: this computer's part of a fleet, and the members of the fleet."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cfgplan.cli import options as shared
from cfgplan.cli.exits import Exit
from cfgplan.cli.screen import Screen
from cfgplan.errors import InputError

if TYPE_CHECKING:
    from cfgplan_runtime.fleet.reached import ReachedFleet
    from cfgplan_runtime.processes.cpu_group import CpuGroup

_EXAMPLE = """\
example:
  cfgplan agent --name base --certificates /etc/cfgplan/base      # on the base station
  cfgplan agent --name r1 --certificates /etc/cfgplan/r1 --connect tls/10.0.0.3:7447      # on the robot r1
  cfgplan run env.yaml --certificates /etc/cfgplan/manager --connect tls/10.0.0.3:7447 --connect tls/10.0.0.1:7447
                                                                # on either; it plans and starts units on both

Connect each pair of agents only once: if A connects to B, B need not connect to A. Without certificates an
agent listens on loopback only. Units keep running when `cfgplan run` ends."""


def add_to(parser: argparse.ArgumentParser) -> None:
    parser.epilog = _EXAMPLE
    parser.add_argument(
        "--name", required=True, metavar="HOST", help="this computer's name under `hosts:` in the environment file"
    )
    add_links(parser)
    reach = "address on which this agent listens (default: tcp/127.0.0.1:7447, with certificates tls/0.0.0.0:7447)"
    shared.add_several(parser, "--listen", "ENDPOINT", reach)
    parser.add_argument(
        "--folder",
        default=".",
        metavar="DIR",
        help="folder of unit code with a relative `source`, such as `units.py:Class` (default: this folder)",
    )
    shared.add_several(parser, "--preload", "MODULE", "import this module before units start; may be repeated")
    limit = "limit all units here together to this many CPU cores, such as 1.5 (Linux only; default: no limit)"
    parser.add_argument("--cpu", type=shared.positive, metavar="SECONDS", help=limit)
    parser.set_defaults(run=run)


def add_links(parser: argparse.ArgumentParser, **more: Any) -> None:
    """Add the options of commands that take part in a fleet, or reach it."""
    parser.add_argument(
        "--connect",
        action="append",
        metavar="ENDPOINT",
        help="address of an agent to connect to, such as tcp/127.0.0.1:7447; may be repeated",
        **{"default": [], **more},
    )
    parser.add_argument(
        "--certificates", metavar="DIR", help="folder of this computer, as made by `cfgplan certificates`", **more
    )


@contextmanager
def reached(options: argparse.Namespace) -> Iterator[ReachedFleet | None]:
    """Return the fleet that the options of `add_links` reach; None without any, for a run on this computer."""
    if not options.connect:
        if options.certificates is not None:
            raise InputError.of("--certificates needs a fleet", mend="name one of its agents by --connect")
        yield None
        return
    from cfgplan_runtime.fleet.reached import ReachedFleet

    certificates = None if options.certificates is None else Path(options.certificates)
    with ReachedFleet(options.connect, certificates) as fleet:
        yield fleet


def run(options: argparse.Namespace, screen: Screen) -> Exit:
    from cfgplan_runtime.fleet.agent import Agent

    if not options.name or any(character in "/*$#?" for character in options.name):
        mend = "write it as the file does under `hosts:`, without /, *, $, # and ?"
        raise InputError.of(f"--name: {options.name!r} can't be the name of a host", mend=mend)
    certificates = None if options.certificates is None else Path(options.certificates)
    listen = options.listen or ["tcp/127.0.0.1:7447" if certificates is None else "tls/0.0.0.0:7447"]
    agent = Agent(
        options.name,
        listen=listen,
        connect=options.connect,
        certificates=certificates,
        folder=Path(options.folder),
        preload=options.preload,
        say=screen.note,
        cpu=None if options.cpu is None else _cpu_group(round(options.cpu * 1_000_000), screen),
    )
    safety = "; without certificates on loopback only" if certificates is None else ""
    screen.note(f"agent {options.name} listens on {', '.join(listen)}{safety}")
    agent.run()
    return Exit.OK


def _cpu_group(cpu_us: int, screen: Screen) -> CpuGroup | None:
    """Return the group of all units here; None, with a note, if the system can't enforce a limit."""
    from cfgplan_runtime.errors import RuntimeFaultError
    from cfgplan_runtime.processes.cpu_group import cpu_groups

    try:
        return cpu_groups({"units": cpu_us})["units"]
    except RuntimeFaultError as error:
        screen.note(f"the CPU time of units is not limited: {error}")
        return None


def add_certificates(parser: argparse.ArgumentParser) -> None:
    parser.epilog = (
        "example:\n"
        "  cfgplan certificates secrets r1=10.0.0.1 r2=10.0.0.2 base=base.local,10.0.0.3 --passes-on base\n"
        "  scp -r secrets/r1 r1:/etc/cfgplan\n\n"
        "Keep FOLDER/authority.key secret: whoever has it can make certificates. To add hosts later, call the command\n"
        "again with the new hosts, and copy the new access.json to every host. Hosts reach each other directly, or\n"
        "through a host named by --passes-on."
    )
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="folder to write; each host gets a folder in it")
    parser.add_argument(
        "hosts",
        nargs="+",
        metavar="HOST[=ADDRESS,...]",
        help="name of a host, and the addresses at which others reach it",
    )
    shared.add_several(
        parser, "--passes-on", "HOST", "allow this trusted host to relay messages between other hosts; may be repeated"
    )
    parser.add_argument(
        "--days",
        type=shared.count,
        default=365,
        metavar="N",
        help="days for which the certificates are valid (default: 365)",
    )
    parser.set_defaults(run=_make_certificates)


def _make_certificates(options: argparse.Namespace, screen: Screen) -> Exit:
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
