"""`cfgplan help`: the manual's pages in the terminal."""

from __future__ import annotations

import argparse
from pathlib import Path

from cfgplan.cli.exits import Exit
from cfgplan.cli.screen import Screen
from cfgplan.errors import known

_PAGES = Path(__file__).parents[1] / "manual"


def add_to(parser: argparse.ArgumentParser) -> None:
    parser.epilog = (
        "example:\n  cfgplan help\n  cfgplan help environment\n\n`cfgplan VERB --help` has the options of a verb."
    )
    parser.add_argument("topic", metavar="TOPIC", nargs="?", help="a page; without one they are listed")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace, screen: Screen) -> Exit:
    from rich.markdown import Markdown

    pages = {page.stem: page for page in sorted(_PAGES.glob("*.md"))}
    if options.topic is None:
        rows = "".join(f"\n{name:14}{_title(page)}" for name, page in pages.items())
        screen.write(f"`cfgplan help TOPIC` shows a page, `cfgplan VERB --help` the options of a verb.\n{rows}\n")
        return Exit.OK
    page = pages[known(options.topic, pages, "page")]
    screen.show(Markdown(page.read_text(encoding="utf-8"), hyperlinks=False))
    return Exit.OK


def _title(page: Path) -> str:
    return page.read_text(encoding="utf-8").partition("\n")[0].removeprefix("# ")
