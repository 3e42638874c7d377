"""Tags: one parser for DL syntax, Manchester syntax and the paper's first-order predicates `P(a)`.

tag      = and-list { (⊔ | or) and-list }
and-list = operand { (⊓ | and | that) operand }
operand  = ¬ operand | (∃|∀) role . operand | (≥|≤|=) number role . operand | ( tag ) | {a, b} | name | name(a)
         | role (some|only) operand | role value a | role (min|max|exactly) number operand
"""

from __future__ import annotations

import re
from typing import Final
from unicodedata import category

from cfgplan.errors import TagError, UnknownNameError, did_you_mean
from cfgplan.matching.concepts import (
    BOTTOM,
    TOP,
    AtMost,
    Concept,
    Named,
    Nominal,
    Only,
    Some,
    at_least,
    conjunction,
    disjunction,
    negation,
    some,
)
from cfgplan.matching.ontology import Ontology

DEEPEST_CONCEPT: Final = 100
"""How deeply a tag may be nested."""

SOURCE_ROLE: Final = "hasSource"
"""The property that the paper's form `P(a)` means: P ⊓ ∃hasSource.{a}."""

_TOKEN: Final = r"<[^<>\s]+>|'[^']*'|:?[^\W](?:[{0}-]*[{0}])?(?::[{0}](?:[{0}-]*[{0}])?)?|\S"
_PLAIN_TOKEN: Final = re.compile(_TOKEN.format(r"\w"))
_JOINERS: Final = "\u200c\u200d"
_WORDS: Final = {
    "and": "⊓", "that": "⊓", "&": "⊓", "∧": "⊓", "or": "⊔", "|": "⊔", "∨": "⊔",
    "not": "¬", "~": "¬", "!": "¬", "exists": "∃", "forall": "∀",
    "Thing": "⊤", "owl:Thing": "⊤", "Nothing": "⊥", "owl:Nothing": "⊥",
}  # fmt: skip
_RESTRICTIONS: Final = frozenset({"some", "only", "value", "min", "max", "exactly"})
_BETWEEN_NAMES: Final = (*sorted(_RESTRICTIONS), "and", "or")
_NO_OPERAND: Final = frozenset("⊓⊔.,)}") | _RESTRICTIONS


def parse_tag(text: str, ontology: Ontology) -> Concept:
    """The concept that a tag means. Raises TagError."""
    return _Reader(text, ontology).tag()


class _Reader:
    def __init__(self, text: str, ontology: Ontology) -> None:
        self._text = text
        self._ontology = ontology
        words = _WORDS
        self._token = _token_of(text)
        self._tokens: list[str] = [words.get(token, token) for token in self._token.findall(text)]
        self._tokens.append("")
        self._at = 0
        self._depth = 0

    def tag(self) -> Concept:
        if len(self._tokens) == 1:
            raise TagError("the tag is empty", 1, "name a class, or write ⊤ for anything at all")
        concept = self._or_list()
        rest = self._tokens[self._at]
        if rest:
            mend = "remove it" if rest in ")}" else "join two concepts by ⊓ (and) or ⊔ (or)"
            raise self._error(f"{self._written()!r} is not expected here", mend)
        return concept

    def _or_list(self) -> Concept:
        concept = self._and_list()
        if self._tokens[self._at] != "⊔":
            return concept
        parts = [concept]
        while self._tokens[self._at] == "⊔":
            self._at += 1
            parts.append(self._and_list())
        return disjunction(parts)

    def _and_list(self) -> Concept:
        concept = self._operand()
        if self._tokens[self._at] != "⊓":
            return concept
        parts = [concept]
        while self._tokens[self._at] == "⊓":
            self._at += 1
            parts.append(self._operand())
        return conjunction(parts)

    def _operand(self) -> Concept:
        self._depth += 1
        if self._depth > DEEPEST_CONCEPT:
            raise self._error(f"the tag is nested more than {DEEPEST_CONCEPT} deep")
        token = self._tokens[self._at]
        if not token or token in _NO_OPERAND:
            what = f"{self._written()!r} stands" if token else "the tag ends"
            raise self._error(f"{what} where a concept is wanted", "write a class, a restriction or {an individual}")
        self._at += 1
        concept = self._compound(token)
        self._depth -= 1
        return concept

    def _compound(self, token: str) -> Concept:
        if token == "∃" or token == "∀":
            role = self._role()
            self._expect(".", "between a property and its filler")
            filler = self._operand()
            return some(role, filler) if token == "∃" else Only(role, filler)
        if token == "¬":
            return negation(self._operand())
        if token == "(":
            concept = self._or_list()
            self._expect(")", "to close '('")
            return concept
        if token == "{":
            return self._nominals()
        if token in "≥≤=":
            number, role = self._number(), self._role()
            self._expect(".", "between a property and its filler")
            return _cardinality(token, number, role, self._operand())
        if token == "⊤":
            return TOP
        if token == "⊥":
            return BOTTOM
        if self._tokens[self._at] in _RESTRICTIONS:
            return self._restriction()
        if self._tokens[self._at] == "(":
            return self._predicate()
        self._refuse_misspelt_word()
        return self._name_as_concept(token)

    def _refuse_misspelt_word(self) -> None:
        """A name never follows a name: one that is like `some` or `and` was meant to be that."""
        token = self._tokens[self._at]
        mend = did_you_mean(token.casefold(), _BETWEEN_NAMES) if token[:1].isalpha() else None
        if mend:
            raise self._error(f"{token!r} is not expected here", mend)

    def _restriction(self) -> Concept:
        self._at -= 1
        role = self._role()
        word = self._tokens[self._at]
        self._at += 1
        if word == "some":
            return some(role, self._operand())
        if word == "only":
            return Only(role, self._operand())
        if word == "value":
            return Some(role, self._individual())
        number = self._number()
        follows = self._tokens[self._at]
        filler = TOP if not follows or follows in _NO_OPERAND else self._operand()
        return _cardinality({"min": "≥", "max": "≤", "exactly": "="}[word], number, role, filler)

    def _predicate(self) -> Concept:
        predicate = self._name_as_concept(self._tokens[self._at - 1])
        self._at += 1
        individual = self._individual()
        self._expect(")", "after the individual of a predicate")
        return conjunction((predicate, Some(self._source_role(), individual)))

    def _nominals(self) -> Concept:
        individuals = [self._individual()]
        while self._tokens[self._at] == ",":
            self._at += 1
            individuals.append(self._individual())
        self._expect("}", "to close '{'")
        return disjunction(individuals)

    def _name_as_concept(self, token: str) -> Concept:
        ontology = self._ontology
        name = self._name(token, self._at - 1)
        try:
            found = ontology.find(name, (ontology.class_names, ontology.individual_names))
            if found is None:
                return Named(ontology.free_iri(name))
        except UnknownNameError as error:
            raise self._error(error.message, error.mend, self._at - 1) from error
        vocabulary, iri = found
        return Nominal(iri) if vocabulary is ontology.individual_names else Named(iri)

    def _individual(self) -> Concept:
        """A name in an individual's place; without an ontology it means the same in every place."""
        name = self._name(self._tokens[self._at], self._at)
        self._at += 1
        ontology = self._ontology
        try:
            found = ontology.find(name, (ontology.individual_names,))
            return Nominal(found[1]) if found else Named(ontology.free_iri(name))
        except UnknownNameError as error:
            raise self._error(error.message, error.mend, self._at - 1) from error

    def _role(self) -> str:
        name = self._name(self._tokens[self._at], self._at)
        self._at += 1
        ontology = self._ontology
        try:
            found = ontology.find(name, (ontology.property_names,))
            return found[1] if found else ontology.free_iri(name)
        except UnknownNameError as error:
            raise self._error(error.message, error.mend, self._at - 1) from error

    def _source_role(self) -> str:
        ontology = self._ontology
        try:
            found = ontology.find(SOURCE_ROLE, (ontology.property_names,))
        except UnknownNameError as error:
            mend = f"declare the property, or write the tag with ⊓ and ∃; P(a) means P ⊓ ∃{SOURCE_ROLE}.{{a}}"
            raise self._error(error.message, mend, self._at - 2) from error
        return found[1] if found else ontology.free_iri(SOURCE_ROLE)

    def _name(self, token: str, at: int) -> str:
        first = token[:1]
        if first == "'":
            return token[1:-1]
        if (first.isalnum() or (first in ("_", ":", "<") and len(token) > 1)) and token not in _RESTRICTIONS:
            return token
        what = f"{token!r} is no name" if token else "the tag ends where a name is wanted"
        raise self._error(what, "names are letters, digits, _ and -; write others as 'name' or <IRI>", at)

    def _number(self) -> int:
        token = self._tokens[self._at]
        if not (token.isascii() and token.isdigit() and len(token) < 10):
            raise self._error(f"{token!r} is no number", "write how many, such as min 2")
        self._at += 1
        return int(token)

    def _expect(self, token: str, purpose: str) -> None:
        found = self._tokens[self._at]
        if found != token:
            stands = f", not {self._written()!r}" if found else ""
            raise self._error(f"{token!r} is wanted {purpose}{stands}")
        self._at += 1

    def _written(self) -> str:
        """The token that is to be read next, as it stands in the text."""
        tokens: list[str] = self._token.findall(self._text)
        return tokens[self._at]

    def _error(self, message: str, mend: str | None = None, at: int | None = None) -> TagError:
        index = self._at if at is None else at
        starts = [found.start() for found in self._token.finditer(self._text)]
        column = starts[index] if index < len(starts) else len(self._text.rstrip())
        return TagError(message, column + 1, mend)


def _token_of(text: str) -> re.Pattern[str]:
    """What is one word of a text: vowel signs and accents, which are no letters, belong to the letter before them."""
    if text.isascii():
        return _PLAIN_TOKEN
    marks = {character for character in text if category(character).startswith("M") or character in _JOINERS}
    return re.compile(_TOKEN.format("\\w" + "".join(sorted(marks)))) if marks else _PLAIN_TOKEN


def _cardinality(sign: str, number: int, role: str, filler: Concept) -> Concept:
    if sign == "≥":
        return at_least(number, role, filler)
    if sign == "≤":
        return AtMost(number, role, filler)
    return conjunction((at_least(number, role, filler), AtMost(number, role, filler)))
