"""C++ source as tokens: comments and directives left out, brackets paired, each token in its block."""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

_TOKEN = re.compile(
    r"""(?P<space>\s+|//(?:[^\n\\]|\\[\s\S])*|/\*[\s\S]*?(?:\*/|\Z))
    |(?P<raw>(?:u8|[uUL])?R"(?P<mark>[^()\s\\"]{0,16})\((?P<inside>[\s\S]*?)\)(?P=mark)")
    |(?P<text>(?:u8|[uUL])?"(?:[^"\\\n]|\\[\s\S])*")
    |(?P<char>'(?:[^'\\\n]|\\.)*')
    |(?P<word>[A-Za-z_]\w*)
    |(?P<number>\.?\d(?:[\w.']|[eE][+-])*)
    |(?P<sign>::|->|[^\s\w])""",
    re.VERBOSE | re.ASCII,
)
_DIRECTIVE = re.compile(r"^[ \t]*#[ \t]*(\w*)((?:[^\n\\]|\\[\s\S])*)", re.MULTILINE)
_CONSTANT = re.compile(r'\s*([A-Za-z_]\w*)\s+\(?\s*("(?:[^"\\\n]|\\.)*")\s*\)?\s*(?://.*)?')
_INCLUDE = re.compile(r'\s*[<"]([^<>"]+)[>"]')
_ESCAPE = re.compile(r"\\(.)", re.DOTALL)
_PAIRS = {")": "(", "]": "[", "}": "{"}
_OPENING = frozenset(_PAIRS.values())
_LONGEST_ANGLES = 400
"""The most tokens between `<` and `>`."""


class Token(NamedTuple):
    """A word, a text (without quotes), a number or a sign, with its line."""

    kind: str
    text: str
    line: int


@dataclass(frozen=True)
class CppFile:
    """A source file: its tokens, its includes, and the texts of its macros."""

    file: str
    tokens: Sequence[Token]
    includes: tuple[str, ...]
    macros: Mapping[str, str]

    @cached_property
    def places(self) -> Mapping[str, Sequence[int]]:
        """Where each word stands among the tokens."""
        found: dict[str, list[int]] = defaultdict(list)
        for at, token in enumerate(self.tokens):
            if token.kind == "word":
                found[token.text].append(at)
        return found

    @cached_property
    def _brackets(self) -> tuple[Mapping[int, int], Sequence[int]]:
        """The partner of each bracket, and the opening brace of the block of each token (-1 outside)."""
        partners: dict[int, int] = {}
        block: list[int] = []
        stack: list[int] = []
        braces = [-1]
        open_now = Counter[str]()
        for at, token in enumerate(self.tokens):
            sign = token.text if token.kind == "sign" else ""
            begin = _PAIRS.get(sign)
            while begin and open_now[begin]:
                other = stack.pop()
                kind = self.tokens[other].text
                open_now[kind] -= 1
                if kind == "{":
                    braces.pop()
                if kind == begin:
                    partners[at], partners[other] = other, at
                    break
            block.append(braces[-1])
            if sign in _OPENING:
                stack.append(at)
                open_now[sign] += 1
                if sign == "{":
                    braces.append(at)
        return partners, block

    def partner(self, at: int) -> int | None:
        """The bracket that belongs to the one at a place; None if there is none."""
        return self._brackets[0].get(at)

    def blocks(self, at: int) -> Iterator[int]:
        """The opening braces around a place, the innermost first, and -1."""
        block = self._brackets[1][at]
        while block >= 0:
            yield block
            block = self._brackets[1][block]
        yield -1

    def sign(self, at: int) -> str:
        """The sign at a place; "" if there is none."""
        return self.tokens[at].text if 0 <= at < len(self.tokens) and self.tokens[at].kind == "sign" else ""

    def word(self, at: int) -> str:
        """The word at a place; "" if there is none."""
        return self.tokens[at].text if 0 <= at < len(self.tokens) and self.tokens[at].kind == "word" else ""

    def after_angles(self, at: int) -> int | None:
        """The place behind `<...>` that begins at a place; None if it does not end within a statement."""
        depth, last = 0, min(len(self.tokens), at + _LONGEST_ANGLES)
        while at < last:
            sign = self.sign(at)
            if sign in ("(", "["):
                at = self.partner(at) or last
            elif sign in (";", "{", "}", ")"):
                return None
            depth += (sign == "<") - (sign == ">")
            at += 1
            if depth == 0:
                return at
        return None

    def arguments(self, at: int) -> list[range] | None:
        """The places of each argument in the brackets that open at a place; None if they do not close."""
        end = self.partner(at)
        if end is None or end < at:
            return None
        parts, begin, inner = [], at + 1, at + 1
        while inner < end:
            if self.sign(inner) in ("(", "[", "{"):
                inner = self.partner(inner) or end
            elif self.sign(inner) == "<" and (after := self.after_angles(inner)) is not None and after <= end:
                inner = after - 1
            elif self.sign(inner) == ",":
                parts.append(range(begin, inner))
                begin = inner + 1
            inner += 1
        return [*parts, range(begin, end)] if begin < end or parts else []

    def text(self, places: range) -> str:
        """The tokens of some places as one text without spaces."""
        return "".join(self.tokens[at].text for at in places)


def cpp_file(text: str, file: str) -> CppFile:
    """The tokens of a C++ source; odd text gives odd tokens, and never raises."""
    includes, macros = list[str](), dict[str, str]()
    hidden = 0

    def directive(found: re.Match[str]) -> str:
        nonlocal hidden
        word, rest = found[1], found[2]
        if hidden:
            hidden += word.startswith("if")
            hidden -= word == "endif"
            if hidden == 1 and word in ("else", "elif"):
                hidden = 0
        elif word == "if" and rest.strip() == "0":
            hidden = 1
        elif word == "include" and (named := _INCLUDE.match(rest)):
            includes.append(named[1])
        elif word == "define" and (said := _CONSTANT.fullmatch(rest)):
            macros[said[1]] = _unquoted(said[2])
        lines = "\n" * found[0].count("\n")
        return f"{_HIDE if hidden else _SHOW}{lines}"

    marked = _DIRECTIVE.sub(directive, text.replace(_HIDE, " ").replace(_SHOW, " "))
    tokens = list(_tokens(marked))
    return CppFile(file, tokens, tuple(includes), macros)


_HIDE, _SHOW = "\x01", "\x02"
"""The marks of a directive after which the source is skipped (`#if 0`), or read."""


def _tokens(text: str) -> Iterator[Token]:
    line, is_hidden = 1, False
    for found in _TOKEN.finditer(text):
        kind, said = found.lastgroup or "", found[0]
        if kind == "sign" and said in (_HIDE, _SHOW):
            is_hidden = said == _HIDE
        elif kind != "space" and not is_hidden:
            if found["raw"] is not None:
                yield Token("text", found["inside"], line)
            else:
                yield Token(kind, _unquoted(said) if kind == "text" else said, line)
        line += said.count("\n")


def _unquoted(text: str) -> str:
    return _ESCAPE.sub(r"\1", text[text.index('"') + 1 : -1])
