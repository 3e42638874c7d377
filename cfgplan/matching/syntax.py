"""Tags: one parser for DL syntax, Manchester syntax and the paper's first-order predicates `P(a)`.

tag      = and-list { (⊔ | or) and-list }
and-list = operand { (⊓ | and | that) operand }
operand  = ¬ operand | (∃|∀) role . operand | (≥|≤|=) number role . operand | ( tag ) | {a, b} | name | name(a)
         | role (some|only) operand | role value a | role (min|max|exactly) number operand

`Thing` and `Nothing` mean ⊤ and ⊥ unless the ontology has such names; without an ontology they are names like others.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from types import MappingProxyType
from typing import Final

from cfgplan.errors import UnknownNameError, close_names
from cfgplan.matching.concepts import (
    BOTTOM,
    NOTHING_IRI,
    THING_IRI,
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
from cfgplan.matching.expressions import BUILT_IN_ROLE
from cfgplan.matching.names import NameTable
from cfgplan.matching.ontology import Ontology
from cfgplan.selectors import KEYWORDS, QUANTIFYING, RESTRICTIONS, ExpressionReader

SOURCE_ROLE: Final = "hasSource"
"""The property that the paper's form `P(a)` means: P ⊓ ∃hasSource.{a}."""

_BARE_NAME: Final = re.compile(r"(?!(?:Thing|Nothing)$)[A-Za-z][A-Za-z0-9_]*")
_BETWEEN_NAMES: Final = (*sorted(RESTRICTIONS), "and", "or")


def parse_tag(text: str, ontology: Ontology) -> Concept:
    """The concept that a tag means. Raises TagError."""
    return _bare_name(text, ontology) or _TagReader(text, ontology).whole()


def _bare_name(text: str, ontology: Ontology) -> Concept | None:
    """The concept of a tag that is one name, as most are; None for any other text, and if the name means nothing."""
    if not _BARE_NAME.fullmatch(text) or text in KEYWORDS:
        return None
    try:
        found = ontology.find(text, (ontology.class_names, ontology.individual_names))
    except UnknownNameError:
        return None
    if found is None:
        return Named(ontology.free_iri(text))
    return Nominal(found[1]) if found[0] is ontology.individual_names else Named(found[1])


class _TagReader(ExpressionReader[Concept]):
    what = "tag"
    wanted = "a concept"
    examples = "a class, a restriction or {an individual}"
    signs = MappingProxyType({**ExpressionReader.signs, **QUANTIFYING})
    restrictions = RESTRICTIONS
    top, bottom = TOP, BOTTOM

    def __init__(self, text: str, ontology: Ontology) -> None:
        super().__init__(text)
        self._ontology = ontology

    def all_of(self, parts: Sequence[Concept]) -> Concept:
        return conjunction(parts)

    def any_of(self, parts: Sequence[Concept]) -> Concept:
        return disjunction(parts)

    def none_of(self, part: Concept) -> Concept:
        return negation(part)

    def is_name(self, word: str, follows: str) -> bool:
        if self._ontology.is_open:
            # `A and and` is a slip rather than a name: with quotes it is one.
            is_repeated = self._at > 0 and {self._tokens[self._at - 1], self._tokens[self._at]} <= {"⊓", "⊔", "¬"}
            return not is_repeated and (self._ends_operand(follows) or follows == "(")
        is_role = follows in RESTRICTIONS
        own = self._ontology.property_names if is_role else self._ontology.class_names
        return own.has(word) or (not is_role and self._ontology.individual_names.has(word))

    def other(self, token: str) -> Concept:
        if token == "∃" or token == "∀":
            role = self._role()
            self._expect(".", "between a property and its filler")
            filler = self._operand()
            return some(role, filler) if token == "∃" else Only(role, filler)
        if token == "{":
            return self._nominals()
        if token in "≥≤=":
            number, role = self._number(), self._role()
            self._expect(".", "between a property and its filler")
            return _cardinality(token, number, role, self._operand())
        if self._tokens[self._at] in RESTRICTIONS:
            return self._restriction()
        if self._tokens[self._at] == "(":
            return self._predicate()
        self._refuse_second_name()
        return self._name_as_concept(token)

    def _refuse_second_name(self) -> None:
        """A name never follows a name: `some` or `and` was meant, or one name was written with a space."""
        first, token, follows = self._words[self._at - 1], self._tokens[self._at], self._tokens[self._at + 1 :][:1]
        if not token[:1].isalpha():
            return
        close = next(iter(close_names(token.casefold(), _BETWEEN_NAMES)), None)
        if close is not None and abs(len(close) - len(token)) <= 1:
            raise self._error(f"{token!r} is not expected here", f"did you mean `{close}`?")
        humps, snake = f"{first}{token[:1].upper()}{token[1:]}", f"{first}_{token}".casefold()
        vocabularies = (self._ontology.class_names, self._ontology.individual_names)
        if self._ontology.is_open and not {*follows} & RESTRICTIONS:
            mend = f"write `{humps}` or `{snake}` if it is one name, `{first} and {token}` if it is two"
            raise self._error("names have no spaces", mend)
        for joined in (humps, snake):
            if any(vocabulary.has(joined) for vocabulary in vocabularies):
                raise self._error("names have no spaces", f"did you mean `{joined}`?")

    def _meant_here(self, name: str, at: int) -> str | None:
        """Return a mend for a name at a place where it has no meaning; None if the intention can't be guessed."""
        follows, then = (*self._words[at + 1 :], "", "")[:2]
        if name.casefold() in KEYWORDS:
            return f"write `{name.casefold()}` in small letters"
        if follows == "/":
            return f"the message type is written beside the tag: `{{tag: ..., type: {name}/{then}}}`"
        if follows in ("<", ">", "=") and not self._ontology.property_names.has(name):
            return f"a tag compares no numbers: state `{name}` under `quality:`"
        if self._ontology.property_names.has(name):
            filler = then if follows in (".", "=", ":") else follows
            word = "value" if self._ontology.individual_names.has(filler) else "some"
            is_filler = filler[:1].isalnum() and filler not in KEYWORDS
            return f"write `{name} {word} {filler if is_filler else self._example()}`"
        local = name.rpartition(":")[2]
        if ":" in name and (self._ontology.class_names.has(local) or self._ontology.individual_names.has(local)):
            return f"write `{local}`, without prefix"
        if (joined := f"{name}{follows}") and follows and (close := self._property_like(joined)):
            return f"did you mean `{close}`?"
        return None

    def _property_like(self, name: str) -> str | None:
        """The property that is written so but for capitals; None if there is none."""
        names = self._ontology.property_names.by_short_name
        return next((each for each in sorted(names) if each.casefold() == name.casefold()), None)

    def _example(self) -> str:
        return next(iter(sorted(self._ontology.class_names.by_short_name)), "Thing")

    def _mend_here(self, usual: str) -> str:
        token = self._words[self._at]
        if token == "/":
            return "the message type is written beside the tag, under `type:`"
        if token in ("<", ">", "="):
            return "a tag compares no numbers: state them under `quality:`"
        return super()._mend_here(usual)

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
        is_whole = self._ends_operand(follows) and follows not in RESTRICTIONS
        filler = TOP if is_whole else self._operand()
        return _cardinality({"min": "≥", "max": "≤", "exactly": "="}[word], number, role, filler)

    def _predicate(self) -> Concept:
        predicate = self._name_as_concept(self._words[self._at - 1])
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
        name, at = self._name(token, self._at - 1), self._at - 1
        vocabularies = self._ontology.class_names, self._ontology.individual_names
        built_in = self._built_in(name, vocabularies)
        return Named(built_in) if built_in else self._meant(name, at, *vocabularies)

    def _built_in(self, name: str, vocabularies: Sequence[NameTable]) -> str | None:
        """The IRI of ⊤ or ⊥ if a name stands for it; None if it is a name of the user's.

        `Thing` and `Nothing` stand for ⊤ and ⊥ in an ontology without such names of its own.
        """
        iri = name[1:-1] if name.startswith("<") else None
        if name.startswith("owl:"):
            iri = self._ontology.prefixes.get("owl", BUILT_IN_ROLE) + name.removeprefix("owl:")
        elif not self._ontology.is_open and not any(names.has(name) for names in vocabularies):
            iri = iri or BUILT_IN_ROLE + name
        return iri if iri in (THING_IRI, NOTHING_IRI) else None

    def _individual(self) -> Concept:
        """A name in an individual's place; without an ontology it means the same in every place."""
        return self._meant(self._next_name(), self._at - 1, self._ontology.individual_names)

    def _meant(self, name: str, at: int, *vocabularies: NameTable) -> Concept:
        found, iri = self._found(name, at, *vocabularies)
        return Nominal(iri) if found is self._ontology.individual_names else Named(iri)

    def _role(self) -> str:
        return self._found(self._next_name(), self._at - 1, self._ontology.property_names)[1]

    def _source_role(self) -> str:
        mend = f"declare the property, or write the tag with ⊓ and ∃; P(a) means P ⊓ ∃{SOURCE_ROLE}.{{a}}"
        return self._found(SOURCE_ROLE, self._at - 2, self._ontology.property_names, mend=mend)[1]

    def _next_name(self) -> str:
        self._at += 1
        return self._name(self._words[self._at - 1], self._at - 1)

    def _found(
        self, name: str, at: int, *vocabularies: NameTable, mend: str | None = None
    ) -> tuple[NameTable | None, str]:
        """Return the vocabulary that has a name, and its IRI; for an open ontology None, and a free IRI."""
        try:
            return self._ontology.find(name, vocabularies) or (None, self._ontology.free_iri(name))
        except UnknownNameError as error:
            if (word := self._word_around()) and any(vocabulary.has(word) for vocabulary in vocabularies):
                raise self._error(error.message, f"write the name in quotes: \"'{word}'\"", at) from error
            meant = self._meant_here(name, at) if self._ontology.class_names in vocabularies else None
            raise self._error(error.message, meant or mend or error.mend, at) from error

    def _number(self) -> int:
        token = self._tokens[self._at]
        if not (token.isascii() and token.isdigit() and len(token) < 10):
            raise self._error(f"{token!r} is not a number", "write how many, such as min 2")
        self._at += 1
        return int(token)


def _cardinality(sign: str, number: int, role: str, filler: Concept) -> Concept:
    if sign == "≥":
        return at_least(number, role, filler)
    if sign == "≤":
        return AtMost(number, role, filler)
    return conjunction((at_least(number, role, filler), AtMost(number, role, filler)))
