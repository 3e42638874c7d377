"""`cfgplan page`: a run in the browser."""

from __future__ import annotations

import argparse
from contextlib import nullcontext
from pathlib import Path

from cfgplan.cli import options as shared
from cfgplan.cli.agent import add_links, reached
from cfgplan.cli.exits import Exit
from cfgplan.cli.screen import Screen

_OF_A_PAGE = """\
example:
  cfgplan run env.yaml --page
  cfgplan page                # for a run that is live
  cfgplan page --address 10.0.0.3 --certificates /etc/cfgplan/base

Whoever has the printed address can steer the run. Without the part after #, the address only shows it."""

_ENDED_LOOK_S = 0.5
"""The longest wait in seconds: Python handles a Ctrl-C that comes just before a wait only after it."""


def add_to(parser: argparse.ArgumentParser) -> None:
    parser.epilog = _OF_A_PAGE
    which = "id or name of the run; needed if several are live"
    shared.add_run(parser, which)
    parser.add_argument(
        "--address",
        default="127.0.0.1",
        metavar="IP",
        help="address to serve on; others than loopback need --certificates (default: 127.0.0.1)",
    )
    parser.add_argument(
        "--port", type=shared.port, default=0, metavar="N", help="port to serve on; 0: any free port (default: 0)"
    )
    shared.add_allow_code(parser)
    add_links(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace, screen: Screen) -> Exit:
    shared.needed_for_pages()
    from cfgplan_runtime.operating.control_client import connect
    from cfgplan_runtime.page.server import PageServer, is_loopback
    from cfgplan_runtime.streams.subscription import subscribe

    is_local = not options.connect and not is_loopback(options.address)
    certificates = None if options.certificates is None else Path(options.certificates)
    with (
        nullcontext() if is_local else reached(options) as fleet,
        PageServer(
            lambda: connect(options.run_id, fleet),
            options.address,
            options.port,
            certificates=None if is_loopback(options.address) else certificates,
            allows_code=options.allow_code,
            subscribe=subscribe if fleet is None else fleet.subscribe,
        ) as server,
    ):
        screen.tell(f"The page is at {server.url}; Ctrl-C ends it, not the run.")
        try:
            while not server.watched.has_ended.wait(_ENDED_LOOK_S):
                pass
            screen.tell("The run has ended.")
        except KeyboardInterrupt:
            screen.note("stopped")
    return Exit.OK
