"""A fast reader of the YAML that programs write: a line for each key; no flow style, anchors or block scalars.

It needs a third of libyaml's time. Any other text, also a faulty one, is left to `yaml_text`.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any, Final

from cfgplan.formats.places import DEEPEST_NESTING
from cfgplan.formats.scalars import FIRST_OF_NON_TEXT, resolve

_CHARACTERS: Final = re.compile("[\n -~\xa0-\u1fff\u2100-\ud7ff]*")
"""No tabs, no other line breaks of YAML, and no characters that it refuses."""
_PLAIN: Final = r"(?:-(?=[0-9.])|[^\n \-?:,\[\]{}#&*!|>'\"%@`])[^\n:#]*(?::[^\n :#][^\n:#]*)*"
_LINE: Final = re.compile(
    r"(?:(?: *#[^\n]*)?\n)+|( *)(- )?(?:([A-Za-z_][A-Za-z0-9_./()-]{0,200}):(?=[ \n]))?"
    rf"(?: *(?:({_PLAIN})|('[^\n']*'|\"[^\n\"\\]*\"))? *)\n|([^\n]*\n)"
)
"""Empty lines and comments; a line with its spaces, dash, key and value; or any other line."""
_AT_ONCE: Final = 100_000
"""Characters whose lines are split at once."""


def read_block_yaml(text: str) -> dict[str, Any] | None:
    """The data of a mapping in plain block style, as `yaml_text` reads it; None for any other text."""
    if _CHARACTERS.fullmatch(text) is None:
        return None
    text = text if text.endswith("\n") else f"{text}\n"
    root: dict[str, Any] = {}
    top: Any = root
    column, key = 0, ""
    below: list[tuple[int, Any]] = []
    values: dict[str, Any] = {}
    texts: set[str] = set()
    for spaces, dash, name, plain, quoted, other in _lines(text):
        if not name and not dash:
            if spaces or plain or quoted or other:
                return None
            continue
        here = len(spaces)
        if here != column or dash or key or type(top) is list:
            if key and (here > column or (dash and here == column)):
                inner: Any = [] if dash else {}
                top[key] = inner
                below.append((column, top))
                top, column = inner, here
            key = ""
            while column > here:
                column, top = below.pop()
            if column == here and not dash and type(top) is list:
                column, top = below.pop()
            if column != here or (not dash) is (type(top) is list) or len(below) >= DEEPEST_NESTING:
                return None
            if dash and name:
                item: dict[str, Any] = {}
                top.append(item)
                below.append((column, top))
                top, column = item, here + 2
        if plain:
            value = values.get(plain)
            if value is None:
                written = plain.rstrip(" ")
                value = values[plain] = resolve(written) if written[0] in FIRST_OF_NON_TEXT else written
        elif quoted:
            value = quoted[1:-1]
        elif name:
            value, key = None, name
        else:
            return None
        if name:
            if name in top or (name not in texts and not isinstance(resolve(name), str)):
                return None
            texts.add(name)
            top[name] = value
        else:
            top.append(value)
    return root or None


def _lines(text: str) -> Iterator[tuple[str, ...]]:
    """Yield the parts of each line; only those of some thousand lines are there at once."""
    end = 0
    while end < len(text):
        begin, end = end, text.find("\n", end + _AT_ONCE) + 1 or len(text)
        yield from _LINE.findall(text, begin, end)
