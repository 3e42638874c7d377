"""The parser of formulas: from text to a tree; each mistake is a fault with its column and a hint.

`always (not in(ball, opponent_half) -> eventually[0,10s] in(ball, opponent_half))`, or with the signs ¬ ∧ ∨ → □ ◇ 𝒰.
"""

from __future__ import annotations

import re
from collections.abc import Collection
from functools import cache
from typing import TYPE_CHECKING, Any

from cfgplan.errors import Fault, InputError, did_you_mean
from cfgplan_runtime.reasoning.reader import SPELLED, Reader, Vocabulary
from cfgplan_runtime.reasoning.syntax import Formula

if TYPE_CHECKING:
    from lark import Lark

# Operators bind in the order not, always, eventually; until; and; or; ->.
GRAMMAR = r"""
?start: implication
?implication: disjunction (IMPLIES implication)?
?disjunction: conjunction (OR conjunction)*
?conjunction: strife (AND strife)*
?strife: prefixed (UNTIL interval? strife)?
?prefixed: NOT prefixed             -> negation
         | ALWAYS interval? prefixed     -> always
         | EVENTUALLY interval? prefixed -> eventually
         | comparison
?comparison: sum (COMPARE sum)*
?sum: product ((PLUS | MINUS) product)*
?product: factor ((TIMES | OVER) factor)*
?factor: MINUS factor -> minus
       | primary
?primary: NUMBER      -> number
        | TEXT        -> text
        | TRUE        -> true
        | FALSE       -> false
        | field
        | call
        | "(" implication ")"
field: NAME (DOT_NAME | "[" INDEX "]")*
call: (NAME | IN) "(" implication ("," implication)* ")"
interval: "[" bound "," bound (RSQB | RPAR)
bound: NUMBER UNIT? | INFINITE

IMPLIES.2: "->" | "→" | "=>" | "⇒"
OR.2: /or\b|∨/
AND.2: /and\b|∧/
UNTIL.2: /until\b|𝒰/
NOT.2: /not\b|¬/
ALWAYS.2: /always\b|□/
EVENTUALLY.2: /eventually\b|◇/
IN.2: /in\b/
TRUE.2: /true\b/
FALSE.2: /false\b/
COMPARE: "<=" | ">=" | "==" | "!=" | "≤" | "≥" | "≠" | "<" | ">" | "="
PLUS: "+"
MINUS: "-"
TIMES: "*"
OVER: "/"
RSQB: "]"
RPAR: ")"
INFINITE.2: /inf\b|∞/
UNIT.2: /(ns|us|µs|ms|min|s|m|h)\b/
NUMBER: /(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?/
INDEX: /\d+/
NAME: /[^\W\d]\w*/
DOT_NAME: /\.[^\W\d]\w*/
TEXT: /"[^"\n]*"|'[^'\n]*'/
%ignore /\s+/
"""
LONGEST_FORMULA = 10_000
FILE = "formula"
"""The file name in the faults of a formula."""
_OPERATORS = ("always", "and", "eventually", "not", "or", "until")
_FIRST_OF_A_PART = {"NAME", "NOT", "NUMBER"}


def parse(text: str, vocabulary: Vocabulary) -> Formula:
    """Read a formula over the names of a vocabulary. Raises InputError with all faults that were found."""
    from lark import UnexpectedInput

    if len(text) > LONGEST_FORMULA:
        mend = "split it into several queries"
        raise InputError([Fault(f"the formula is longer than {LONGEST_FORMULA:,} characters", FILE, mend=mend)])
    try:
        tree = _parser().parse(text)
    except UnexpectedInput as error:
        raise InputError([_syntax_fault(error, text, {*vocabulary.features, *vocabulary.regions})]) from None
    reader = Reader(vocabulary, FILE)
    formula = reader.formula(tree)
    if reader.faults:
        raise InputError(reader.faults)
    return formula


@cache
def _parser() -> Lark:
    from lark import Lark

    return Lark(GRAMMAR, parser="lalr", propagate_positions=True)


def _syntax_fault(error: Any, text: str, names: Collection[str]) -> Fault:
    from lark import UnexpectedCharacters

    expected = set(getattr(error, "allowed", None) or getattr(error, "expected", None) or ())
    token = getattr(error, "token", None)
    if isinstance(error, UnexpectedCharacters):
        found, line, column = repr(text[error.pos_in_stream or 0]), error.line, error.column
    elif token is None or token.type == "$END":
        found, line, column = "", text.count("\n") + 1, len(text.rpartition("\n")[2]) + 1
    else:
        found, line, column = repr(str(token)), token.line, token.column
    if not text.strip():
        return Fault("the formula is empty", FILE, 1, 1, mend="write one, such as `always ball.x > 0`")
    message = f"{found} is not expected here" if found else "the formula ends too early"
    before = text[: len(text) if error.pos_in_stream is None else error.pos_in_stream + 1]
    foreign = [word for word in re.findall(r"\w+", before) if word in SPELLED]
    if foreign:
        return Fault(message, FILE, line, column, mend=f"`{foreign[-1]}` is written {SPELLED[foreign[-1]]} here")
    if (misspelt := _misspelt(text, len(before), names)) is not None:
        return misspelt
    return Fault(message, FILE, line, column, mend=_hint(expected, found, text))


def _misspelt(text: str, end: int, names: Collection[str]) -> Fault | None:
    """Return the fault of an operator that is misspelt, or written in capitals, at a mistake or right before it.

    The `names` of features and regions are no operators, however close.
    """
    words = [word for word in re.finditer(r"(?<![\w.])[^\W\d]\w*(?!\.)\b", text) if word.start() < end]
    for word in reversed(words[-2:]):
        close = None if word[0] in {*_OPERATORS, *names} else did_you_mean(word[0], _OPERATORS)
        if close is not None:
            start = word.start()
            line, column = text.count("\n", 0, start) + 1, start - text.rfind("\n", 0, start)
            return Fault(f"`{word[0]}` is not an operator", FILE, line, column, mend=close)
    return None


def _hint(expected: set[str], found: str, text: str) -> str:
    if "INFINITE" in expected:
        return "an interval begins at 0 or later, and its bounds are numbers: [0, 10s]"
    if "UNIT" in expected and "COMMA" in expected and "RPAR" not in expected:
        return "an interval has two bounds: [0, 10s]"
    if "UNIT" in expected or ({"RSQB", "RPAR"} <= expected and "OR" not in expected):
        return "close the interval: [0, 10s]; units are ms, s, min and h"
    if expected == {"COMMA"}:
        return "an interval has two bounds: [0, 10s]"
    if expected >= _FIRST_OF_A_PART:
        return "here a part of the formula is missing, such as `ball.x > 0` or `in(ball, region)`"
    if {"NUMBER", "NAME"} <= expected:
        return "here a value is missing: a feature's field, a number or a text in quotes"
    if expected == {"INDEX"}:
        return "a position in a list is a number that counts from 0: `ball.corners[0]`"
    if not found or text.count("(") > text.count(")"):
        return "close the parenthesis"
    if found == "')'":
        return "it closes a parenthesis that was not opened"
    if found in ("'&'", "'|'", "'!'", "'~'", "'&&'", "'||'"):
        return "write `and`, `or`, `not`"
    return "two parts are joined by `and`, `or`, `->` or `until`"
