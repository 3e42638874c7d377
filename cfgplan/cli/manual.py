"""`cfgplan help`: the manual's pages in the terminal, their search, and the reference, made of docstrings."""

from __future__ import annotations

import argparse
import inspect
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import is_dataclass
from enum import Enum
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import Any

from cfgplan.cli.exits import Exit
from cfgplan.cli.manual_search import asked_stems, found, sections, unknown_words
from cfgplan.cli.screen import Screen, counted
from cfgplan.errors import InputError, known

_PAGES = Path(__file__).parents[1] / "manual"
_INDEX = "index"
"""The page that groups the others: the site begins with it."""
_DOCSTRINGS = re.compile(r"<!-- docstrings of (\w+): (.*?) -->", re.DOTALL)
_SIGNATURE_WIDTH = 80
_MOST_FOUND = 8
"""Sections that a search shows."""
_LONGEST_SHOWN = 200


def add_to(parser: argparse.ArgumentParser) -> None:
    parser.epilog = (
        "example:\n  cfgplan help\n  cfgplan help environment\n  cfgplan help restart a unit\n\n"
        "`cfgplan COMMAND --help` lists the options of a command."
    )
    told = "name of a page or command, or words to search for (default: list the pages)"
    parser.add_argument("manual_page", metavar="TOPIC", nargs="*", help=told)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace, screen: Screen) -> Exit:
    from rich.markdown import Markdown

    from cfgplan.cli.main import VERBS, parser_with

    pages, topic = manual_pages(), options.manual_page
    if not topic:
        screen.write(
            f"`cfgplan help PAGE` shows a page, `cfgplan help WORDS` searches all pages, `cfgplan help COMMAND` lists "
            f"the options of a command.\n{_listed(pages)}"
        )
    elif len(topic) == 1 and topic[0] in pages:
        page = pages[topic[0]]
        screen.show(Markdown(with_docstrings(page.read_text(encoding="utf-8")), hyperlinks=False))
    elif len(topic) == 1 and topic[0] in VERBS:
        parser_with(topic).parse_args([topic[0], "--help"])
    else:
        _search(pages, topic, screen)
    return Exit.OK


def _search(pages: Mapping[str, Path], words: Sequence[str], screen: Screen) -> None:
    """Print the sections that have all words, the best ones first. Raises InputError if there are none."""
    from cfgplan.cli.styled import Text

    every = list(sections(pages))
    asked = asked_stems(words)
    best = found(every, asked)
    if not best:
        if len(words) == 1:
            known(words[0], pages, "page")
        missing = " or ".join(f"`{word}`" for word in unknown_words(every, words))
        told = f"the manual has no word {missing}" if missing else "no section of the manual has all of these words"
        raise InputError.of(told, mend="write fewer words, or other ones; `cfgplan help` lists the pages")
    for section in best[:_MOST_FOUND]:
        screen.show(Text(f"{section.page}: {' > '.join([*section.under[1:], section.heading])}", style="bold"))
        screen.write(f"  {_shortened(section.best_sentence(asked))}\n")
    number, more = min(len(best), _MOST_FOUND), f" (of {len(best)})" if len(best) > _MOST_FOUND else ""
    screen.note(f"{counted(number, 'section')}{more}. `cfgplan help {best[0].page}` shows the first one's page.")


def _shortened(text: str) -> str:
    return text if len(text) <= _LONGEST_SHOWN else f"{text[:_LONGEST_SHOWN].rpartition(' ')[0]} ..."


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


def with_docstrings(page: str) -> str:
    """A page's text with each mark `<!-- docstrings of PACKAGE: NAME NAME -->` replaced by what these names say."""
    return _DOCSTRINGS.sub(lambda mark: "\n".join(_entry(mark[1], name) for name in mark[2].split()), page)


def names(page: str) -> Iterator[str]:
    """The names, with their package, whose docstrings a page asks for."""
    for package, listed in _DOCSTRINGS.findall(page):
        yield from (f"{package}.{name}" for name in listed.split())


def _entry(package: str, name: str) -> str:
    found = getattr(import_module(package), name)
    lines = [f"### {name}", "", "```python", _signature(f"{package}.{name}", found), "```", "", _doc(found)]
    if inspect.isclass(found):
        lines += ["", *_members(found)]
    return "\n".join(lines) + "\n"


def _signature(name: str, found: Any) -> str:
    """The call as it is written, a parameter on each line where one line is too short."""
    if (inspect.isclass(found) and issubclass(found, Enum)) or getattr(found, "_is_protocol", False):
        return name
    try:
        signature = inspect.signature(found)
    except ValueError:  # of an exception without an __init__ of its own
        return name
    shown, marked = [], False
    for each in signature.parameters.values():
        if each.kind is each.KEYWORD_ONLY and not marked:
            shown.append("*")
        marked = marked or each.kind in (each.KEYWORD_ONLY, each.VAR_POSITIONAL)
        shown.append(_parameter(each))
    given = signature.return_annotation
    gives = f" -> {given}" if isinstance(given, str) and not inspect.isclass(found) else ""
    line = f"{name}({', '.join(shown)}){gives}"
    return line if len(line) <= _SIGNATURE_WIDTH else f"{name}(\n    " + ",\n    ".join(shown) + f",\n){gives}"


def _parameter(given: inspect.Parameter) -> str:
    stars = "*" if given.kind is given.VAR_POSITIONAL else "**" if given.kind is given.VAR_KEYWORD else ""
    kind = f": {given.annotation}" if isinstance(given.annotation, str) else ""
    default = re.sub(r"<.*>", "...", repr(given.default))
    return f"{stars}{given.name}{kind}" + ("" if given.default is given.empty else f" = {default}")


def _members(found: type) -> Iterator[str]:
    """The members of an enumeration, or a class's own methods and properties, each with its first sentence."""
    if issubclass(found, Enum):
        yield from (f"* `{member.name}`: `{member.value}`" for member in found)
        return
    for name, member in vars(found).items():
        if name.startswith("_") or (is_dataclass(found) and name in found.__dataclass_fields__):
            continue
        documented: Any = getattr(member, "__func__", member)
        if isinstance(member, property | cached_property):
            shown = name
        elif inspect.isfunction(documented):
            shown = _signature(name, documented).replace("\n", " ").replace("(self, ", "(").replace("(self)", "()")
        else:
            continue
        text = re.sub(r"\s+", " ", _doc(documented))
        yield f"* `{re.sub(' +', ' ', shown)}`" + (f": {text.partition('. ')[0].rstrip('.')}." if text else "")


def _doc(found: Any) -> str:
    """The docstring; none where a dataclass has only the one that it is given."""
    text, own = found.__doc__ or "", getattr(found, "__name__", "")
    return "" if is_dataclass(found) and text.startswith(f"{own}(") else inspect.cleandoc(text)
