"""Expressions of names joined by and, or and not, in DL or Manchester syntax; selectors of hosts by their labels.

expression = and-list { (⊔ | or) and-list }
and-list   = operand { (⊓ | and | that) operand }
operand    = ¬ operand | ( expression ) | ⊤ | ⊥ | name

A word such as `and` is a keyword only where a name can't stand. In quotes it is always a name.
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Mapping, Sequence
from functools import lru_cache
from types import MappingProxyType
from typing import ClassVar, Final, Generic, TypeVar
from unicodedata import category

from cfgplan.errors import InvalidValueError, TagError

DEEPEST_EXPRESSION: Final = 100
"""The greatest depth of nesting in an expression."""

_TOKEN: Final = r"<[^<>\s]+>|'[^']*'|:?[^\W](?:[{0}-]*[{0}])?(?::[{0}](?:[{0}-]*[{0}])?)?|\S"
_JOINERS: Final = "\u200c\u200d"
_JOINING: Final = {"and": "⊓", "that": "⊓", "&": "⊓", "∧": "⊓", "or": "⊔", "|": "⊔", "∨": "⊔"}
_NEGATING: Final = {"not": "¬", "~": "¬", "!": "¬"}
QUANTIFYING: Final = {"exists": "∃", "forall": "∀"}
RESTRICTIONS: Final = frozenset({"some", "only", "value", "min", "max", "exactly"})
KEYWORDS: Final = RESTRICTIONS.union(
    word for words in (_JOINING, _NEGATING, QUANTIFYING) for word in words if word.isalpha()
)
"""The words that mean more than a name in a tag."""
_WORD: Final = re.compile(r"(?<![∃∀\w])\w[^\s(){},'<>=]*")
"""A text that may be meant as one name, although it has signs of other meaning."""
_NO_OPERAND: Final = frozenset("⊓⊔.,)}")

Meaning = TypeVar("Meaning")
"""The type of an expression's meaning."""


class ExpressionReader(ABC, Generic[Meaning]):
    """Reads one text; subclasses define the meaning of operands and of joining them."""

    what: ClassVar[str] = "expression"
    wanted: ClassVar[str] = "a name"
    examples: ClassVar[str] = "a name"
    signs: ClassVar[Mapping[str, str]] = MappingProxyType({**_JOINING, **_NEGATING})
    """The signs that words and other signs stand for."""
    more_tokens: ClassVar[str] = ""
    """A pattern of words that only these expressions have, ending in `|`."""
    restrictions: ClassVar[frozenset[str]] = frozenset()
    """Words that stand between a role and an operand or a number."""
    top: Meaning
    bottom: Meaning

    def __init__(self, text: str) -> None:
        self._text = text
        self._token = _token_of(text, self.more_tokens)
        self._words: list[str] = [*self._token.findall(text), ""]
        self._tokens: list[str] = [self.signs.get(word, word) for word in self._words]
        self._at = 0
        self._depth = 0

    @abstractmethod
    def all_of(self, parts: Sequence[Meaning]) -> Meaning:
        """Return the meaning of parts joined by `and`."""

    @abstractmethod
    def any_of(self, parts: Sequence[Meaning]) -> Meaning:
        """Return the meaning of parts joined by `or`."""

    @abstractmethod
    def none_of(self, part: Meaning) -> Meaning:
        """Return the meaning of `not` before a part."""

    @abstractmethod
    def other(self, token: str) -> Meaning:
        """Return the meaning of an operand that begins with the token just read."""

    def is_name(self, _word: str, _follows: str) -> bool:
        """Whether a keyword in the place of an operand is meant as a name, given the token that follows it."""
        return False

    def whole(self) -> Meaning:
        """Return the meaning of the text. Raises TagError."""
        if len(self._tokens) == 1:
            raise TagError(f"the {self.what} is empty", 1, f"name {self.examples}, or write ⊤ for anything at all")
        found = self._or_list()
        rest = self._tokens[self._at]
        if rest:
            mend = "remove it" if rest in ")}" else f"join two {self.wanted[2:]}s by ⊓ (and) or ⊔ (or)"
            raise self._error(f"{self._written()!r} is not expected here", self._mend_here(mend))
        return found

    def _mend_here(self, usual: str) -> str:
        """Return the mend for a next token that can't follow the last one."""
        word = self._word_around()
        return f"write a name with such signs in quotes: \"'{word}'\"" if word else usual

    def _word_around(self) -> str | None:
        """Return the text without spaces that the next token is inside of; None if the token begins or ends it."""
        starts = [found.start() for found in self._token.finditer(self._text)]
        if self._at >= len(starts):
            return None
        words = ((word.start(), word.end(), word[0]) for word in _WORD.finditer(self._text))
        return next((word for start, end, word in words if start < starts[self._at] < end), None)

    def _or_list(self) -> Meaning:
        return self._joined("⊔", self._and_list, self.any_of)

    def _and_list(self) -> Meaning:
        return self._joined("⊓", self._operand, self.all_of)

    def _joined(self, sign: str, part: Callable[[], Meaning], join: Callable[[Sequence[Meaning]], Meaning]) -> Meaning:
        parts = [part()]
        while self._tokens[self._at] == sign:
            self._at += 1
            parts.append(part())
        return join(parts) if len(parts) > 1 else parts[0]

    def _operand(self) -> Meaning:
        self._depth += 1
        if self._depth > DEEPEST_EXPRESSION:
            raise self._error(f"the {self.what} is nested more than {DEEPEST_EXPRESSION} deep", "shorten it")
        token, is_name = self._tokens[self._at], self._is_own_name()
        if not is_name and self._ends_operand(token):
            what = f"{self._written()!r} stands" if token else f"the {self.what} ends"
            quoted = f"; a name is written \"'{self._written()}'\"" if self._is_keyword() else ""
            mend = self._mend_of_order(token) or f"write {self.examples}{quoted}"
            raise self._error(f"{what} where {self.wanted} is expected", mend)
        self._at += 1
        found = self.other(self._words[self._at - 1]) if is_name else self._compound(token)
        self._depth -= 1
        return found

    def _mend_of_order(self, token: str) -> str | None:
        """Return the mend for a repeated sign or a word that should follow its role; None for any other token."""
        before, role, filler = self._tokens[self._at - 1], *(*self._words[self._at + 1 :], "", "")[:2]
        if token == before and token in ("⊓", "⊔"):
            return f"write `{'and' if token == '⊓' else 'or'}` once"
        if token in self.restrictions and role[:1].isalpha() and filler[:1].isalnum():
            return f"the property comes first: `{role} {token} {filler}`"
        return None

    def _is_keyword(self) -> bool:
        """Whether the next token is a word that means more than a name."""
        word = self._written()
        return word in self.restrictions or (word in self.signs and word.isalpha())

    def _is_own_name(self) -> bool:
        """Whether the next token is a keyword at a place where it can only be a name, and that name exists."""
        if not self._is_keyword():
            return False
        token, follows, then = (*self._tokens[self._at :], "", "")[:3]
        if token == "¬":
            may_be_name = follows in ("⊓", "⊔") or follows in self.restrictions
            is_operator = not self._ends_operand(follows) or (may_be_name and self._ends_operand(then))
        else:
            is_operator = token in ("∃", "∀") and then == "."
        return not is_operator and self.is_name(self._written(), follows)

    def _ends_operand(self, token: str) -> bool:
        """Whether a token can't begin an operand."""
        return not token or token in _NO_OPERAND or token in self.restrictions

    def _compound(self, token: str) -> Meaning:
        if token == "¬":
            return self.none_of(self._operand())
        if token == "(":
            found = self._or_list()
            self._expect(")", "to close '('")
            return found
        if token == "⊤":
            return self.top
        if token == "⊥":
            return self.bottom
        return self.other(token)

    def _name(self, token: str, at: int) -> str:
        first = token[:1]
        if first == "'":
            return token[1:-1]
        if first.isalnum() or (first in ("_", ":", "<") and len(token) > 1):
            return token
        what = f"{token!r} is no name" if token else f"the {self.what} ends where a name is expected"
        raise self._error(what, "names are letters, digits, _ and -; write others as 'name' or <IRI>", at)

    def _expect(self, token: str, purpose: str) -> None:
        found = self._tokens[self._at]
        if found != token:
            stands = f", not {self._written()!r}" if found else ""
            raise self._error(f"{token!r} is expected {purpose}{stands}", self._mend_here(f"write {token} here"))
        self._at += 1

    def _written(self) -> str:
        """The next token, as written in the text."""
        return self._words[self._at]

    def _error(self, message: str, mend: str | None = None, at: int | None = None) -> TagError:
        index = self._at if at is None else at
        starts = [found.start() for found in self._token.finditer(self._text)]
        column = starts[index] if index < len(starts) else len(self._text.rstrip())
        return TagError(message, column + 1, mend)


def quoted(name: str) -> str | None:
    """A name as an expression writes it, in quotes if need be; None for one that can't be written by itself."""
    if name not in KEYWORDS and name[:1] not in ("<", "'") and _token_of(name).fullmatch(name) and name[0].isalnum():
        return name
    return None if "'" in name or not name else f"'{name}'"


def _token_of(text: str, more: str = "") -> re.Pattern[str]:
    """Return the pattern of one word of a text: combining marks (vowel signs, accents) belong to the letter before
    them.
    """
    marks: set[str] = set()
    if not text.isascii():
        marks = {character for character in text if category(character).startswith("M") or character in _JOINERS}
    return _compiled(more, "".join(sorted(marks)))


@lru_cache(maxsize=256)
def _compiled(more: str, marks: str) -> re.Pattern[str]:
    return re.compile(more + _TOKEN.format("\\w" + marks))


Selector = Callable[[Collection[str]], bool]
"""Whether some labels fit."""


@lru_cache(maxsize=4096)
def selector(text: str) -> Selector:
    """The selector that an expression over labels means. Raises TagError."""
    return _SelectorReader(text).whole()


def check_selector(text: str) -> None:
    """Raise InvalidValueError if an expression over labels can't be read."""
    try:
        selector(text)
    except TagError as error:
        raise InvalidValueError(f"{text!r} selects no hosts: {error}") from error


class _SelectorReader(ExpressionReader[Selector]):
    what = "selector"
    wanted = examples = "a label"

    def top(self, _: Collection[str]) -> bool:
        return True

    def bottom(self, _: Collection[str]) -> bool:
        return False

    def all_of(self, parts: Sequence[Selector]) -> Selector:
        return lambda labels: all(fits(labels) for fits in parts)

    def any_of(self, parts: Sequence[Selector]) -> Selector:
        return lambda labels: any(fits(labels) for fits in parts)

    def none_of(self, part: Selector) -> Selector:
        return lambda labels: not part(labels)

    def other(self, token: str) -> Selector:
        label = self._name(token, self._at - 1)
        return lambda labels: label in labels
