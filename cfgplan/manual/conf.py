"""The manual as a site: `sphinx-build -W --keep-going cfgplan/manual build/manual` (extra `docs`).

The pages are those of `cfgplan help`. Docstrings are filled in where a page asks for them. A link out of the manual
leads into the checkout, which a site does not have: it becomes the path.
"""

import os.path
import re
from pathlib import Path

from sphinx.application import Sphinx

from cfgplan import __version__
from cfgplan.cli.manual import with_docstrings

project = "cfgplan"
author = "The cfgplan contributors"
release = __version__
extensions = ["myst_parser"]
exclude_patterns = ["start"]
html_theme = "furo"
html_title = f"cfgplan {release}"
html_copy_source = False
html_show_sphinx = False
myst_heading_anchors = 4


def _as_on_the_site(_app: Sphinx, _page: str, source: list[str]) -> None:
    """Fill in docstrings, and show the path in place of a link that leaves the manual; pictures are taken along."""

    def path(link: re.Match[str]) -> str:
        text, target = link[1], os.path.normpath(Path("cfgplan", "manual", link[2])).partition("#")[0]
        return f"`{target}`" if text.strip("`") == target else f"{text} (`{target}`)"

    text = re.sub(r"(?<!!)\[([^\]]+)\]\((\.\./[^)]+)\)", path, source[0])
    source[0] = with_docstrings(text)


def setup(app: Sphinx) -> None:
    app.connect("source-read", _as_on_the_site)
