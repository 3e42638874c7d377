"""`cfgplan help`: the manual's pages in the terminal."""

from __future__ import annotations

import argparse
import re
from collections.abc import Mapping
from pathlib import Path

from cfgplan.cli.exits import Exit
from cfgplan.cli.screen import Screen
from cfgplan.errors import known

_PAGES = Path(__file__).parents[1] / "manual"
_INDEX = "index"
"""The page that groups the others: the site begins with it."""


def add_to(parser: argparse.ArgumentParser) -> None:
    parser.epilog = (
        "example:\n  cfgplan help\n  cfgplan help environment\n\n`cfgplan VERB --help` has the options of a verb."
    )
    parser.add_argument("manual_page", metavar="TOPIC", nargs="?", help="a page; without one they are listed")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace, screen: Screen) -> Exit:
    from rich.markdown import Markdown

    from cfgplan.cli.reference import with_docstrings

    pages = manual_pages()
    if options.manual_page is None:
        screen.write(
            f"`cfgplan help TOPIC` shows a page, `cfgplan VERB --help` the options of a verb.\n{_listed(pages)}"
        )
        return Exit.OK
    page = pages[known(options.manual_page, pages, "page")]
    screen.show(Markdown(with_docstrings(page.read_text(encoding="utf-8")), hyperlinks=False))
    return Exit.OK


def manual_pages() -> dict[str, Path]:
    """The pages' files by their names."""
    return {page.stem: page for page in _PAGES.glob("*.md") if page.stem != _INDEX}


def _listed(pages: Mapping[str, Path]) -> str:
    """The pages with their titles, in the groups and the order of the index."""
    text = ""
    for group, names in re.findall(r":caption: (.*?)\n\n(.*?)```", (_PAGES / f"{_INDEX}.md").read_text(), re.DOTALL):
        text += f"\n{group}\n" + "".join(f"  {name:16}{_title(pages[name])}\n" for name in names.split())
    return text


def _title(page: Path) -> str:
    return page.read_text(encoding="utf-8").partition("\n")[0].removeprefix("# ")
