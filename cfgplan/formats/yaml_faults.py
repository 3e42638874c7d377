"""Faults of a text that is no YAML: the line of the slip, and its mend.

The parser names the first place where it can't continue. A missing colon, bracket or quote is often before it.
"""

from __future__ import annotations

import re
from typing import NamedTuple

import yaml

from cfgplan.errors import Fault
from cfgplan.formats.places import DEEPEST_NESTING

TOO_DEEP = f"values are nested more than {DEEPEST_NESTING} deep", "flatten the document"
_KEY_BEGINS = re.compile(r"\s*(?:- *)?([\w.-]+)(:?)(\s*)(\S.*)?$")
_PAIR = re.compile(r"(?:[\w.-]+|\"[^\"]*\"|'[^']*'): ")


class _Slip(NamedTuple):
    """Where the slip is, counted from 0, and its mend."""

    line: int
    column: int
    mend: str


def syntax_fault(error: yaml.YAMLError, text: str, file: str) -> Fault:
    """The fault of a text that the parser refuses."""
    problem = getattr(error, "problem", None) or getattr(error, "reason", None) or str(error)
    mark = getattr(error, "problem_mark", None) or getattr(error, "context_mark", None)
    if mark is None:
        bad = next((i for i, character in enumerate(text) if not _printable(character)), 0)
        line, column = text.count("\n", 0, bad), bad - (text.rfind("\n", 0, bad) + 1)
        mend = "remove the control character, or write it as an escape in double quotes"
        return Fault(f"this is not YAML: {problem}", file, line + 1, column + 1, mend=mend)
    if "nesting depth" in problem:  # newer ones of PyYAML have a limit too, and look ahead
        return Fault(TOO_DEEP[0], file, mark.line + 1, mark.column + 1, mend=TOO_DEEP[1])
    lines = text.splitlines()
    if "mapping values are not allowed" in problem and (slip := _bare_key(mark.line, lines)):
        return Fault("this is not YAML: this key has no colon", file, slip.line + 1, slip.column + 1, mend=slip.mend)
    slip = _slip(problem, mark, getattr(error, "context_mark", None) or mark, lines)
    return Fault(f"this is not YAML: {_in_words(problem)}", file, slip.line + 1, slip.column + 1, mend=slip.mend)


def _in_words(problem: str) -> str:
    words = {
        "could not find expected ':'": "this line has no `: ` between a key and its value",
        "found unexpected end of stream": "the quote that begins here is never closed",
        "found a tab character that violates indentation": "a tab indents this line",
        "mapping values are not allowed in this context": "a key begins here inside of a value",
        "block sequence entries are not allowed in this context": "a list begins in the line of its key",
        "did not find expected '-' indicator": "this line is not an entry of the list above",
        "did not find expected key": "this is not a key of the mapping above",
        "found character that cannot start any token": "no value begins with this character",
    }
    return words.get(problem, problem)


def _slip(problem: str, mark: yaml.Mark, begin: yaml.Mark, lines: list[str]) -> _Slip:
    """Return the probable slip if the parser stops at `mark`, inside the node that begins at `begin`."""
    here = lines[mark.line] if mark.line < len(lines) else ""
    at = _Slip(mark.line, mark.column, "check the indentation and the quotes here")
    if "\t" in here[: mark.column + 1] and not here[: mark.column].strip():
        return at._replace(mend="indent by spaces, not tabs")
    if "could not find expected ':'" in problem:
        return _Slip(begin.line, begin.column, _colon(lines[begin.line][begin.column :]))
    if "found unexpected end of stream" in problem:
        return _Slip(begin.line, begin.column, f"close it with {lines[begin.line][begin.column]}")
    if "cannot start any token" in problem:
        return at._replace(mend="put quotes around the text")
    if "mapping values are not allowed" in problem:
        return at._replace(mend=_second_colon(here[: mark.column], mark.line, lines))
    if "block sequence entries are not allowed" in problem:
        return at._replace(mend="put each `- ` on a line of its own, below the key")
    if "expected ',' or" in problem:
        return _flow(problem, mark, begin, lines)
    if "expected '-' indicator" in problem or "expected key" in problem:
        return at._replace(mend=_line_between(mark, begin, lines))
    return at


def _colon(written: str) -> str:
    if quoted := re.fullmatch(r"""(["'])([\w.-]+: .+)\1\s*""", written):
        return f"remove the quotes around the whole: `{quoted[2]}`"
    found = _KEY_BEGINS.match(written)
    if found is None:
        return "write `key: value`, or quote the text"
    if not found[4]:
        return f"put a colon after the key: `{found[1]}:`"
    return f"put a colon and a space after the key: `{found[1]}: {found[4].removeprefix('= ')}`"


def _second_colon(before: str, number: int, lines: list[str]) -> str:
    """Return the mend of a line with a `: ` inside a value that begins on this line, or on the line above."""
    if pair := _PAIR.search(before + ": "):
        value = lines[number][pair.end() :]
        if pair.end() < len(before):
            is_port = pair[0] in ("inputs: ", "outputs: ")
            return f"put braces around it: `{{{value}}}`" if is_port else f'put quotes around the value: "{value}"'
    above = _line_above(number, lines)
    return f"begin this key in the column of the keys beside it: line {above + 1} begins elsewhere, and has its value"


def _line_above(number: int, lines: list[str]) -> int:
    """The number of the line above that is neither empty nor a comment; 0 without one."""
    said = (n for n in range(number - 1, -1, -1) if lines[n].strip() and not lines[n].lstrip().startswith("#"))
    return next(said, 0)


def _bare_key(number: int, lines: list[str]) -> _Slip | None:
    """The slip of a line above that is a key without its colon, and has the line with this number below it."""
    above = _line_above(number, lines)
    found = _KEY_BEGINS.match(lines[above]) if above < number else None
    if found is None or found[2] or found[4]:
        return None
    indent, below = found.start(1), len(lines[number]) - len(lines[number].lstrip())
    if below < indent or (below == indent and not lines[number].lstrip().startswith("- ")):
        return None
    return _Slip(above, indent, f"put a colon after the key: `{found[1]}:`")


def _flow(problem: str, mark: yaml.Mark, begin: yaml.Mark, lines: list[str]) -> _Slip:
    """The slip in braces or brackets: one that is not closed, a comma that is missing, or a text to be quoted."""
    close = "}" if "}" in problem else "]"
    here = lines[mark.line] if mark.line < len(lines) else ""
    if mark.line != begin.line:
        return _Slip(begin.line, begin.column, f"close it with {close}")
    if here[mark.column : mark.column + 1] == ":" and (found := re.search(r"(\S+) ([\w.-]+)$", here[: mark.column])):
        return _Slip(mark.line, mark.column, f"put a comma between two keys: `{found[1]}, {found[2]}:`")
    mend = "quote a text that has one of { } [ ] in it, such as a tag with {a}, or put a comma between two values"
    return _Slip(mark.line, mark.column, mend)


def _line_between(mark: yaml.Mark, begin: yaml.Mark, lines: list[str]) -> str:
    """Return the mend of a line that continues neither the list or mapping that begins at `begin` nor its content."""
    rest = lines[mark.line][mark.column :] if mark.line < len(lines) else ""
    before = lines[mark.line][: mark.column] if mark.line < len(lines) else ""
    if before.strip() and rest[:1] in ("}", "]"):
        return f"remove the `{rest[0]}`: the bracket that it would close is closed already"
    if before.strip():
        return "quote the text as a whole: what begins with a quote, { or [ ends with it"
    if re.match(r"-[^\s-]", rest):
        return f"put a space after the dash: `- {rest[1:]}`"
    if rest.startswith("- "):
        above = next((each for each in reversed(lines[: mark.line]) if each.lstrip().startswith("- ")), "")
        return f"begin each `- ` of a list in one column: {len(above) - len(above.lstrip()) + 1}, as above"
    is_item = lines[begin.line][begin.column :].startswith("- ")
    if is_item and mark.column == begin.column:
        return f"an item of the list begins with `- `: write `- {rest}`"
    return "begin this key in the column of the keys beside it"


def _printable(character: str) -> bool:
    return character in "\t\n\r\x85" or " " <= character <= "~" or character >= "\xa0"
