"""From lark's tree to a formula: names are looked up, and what is no formula, number, point or region is refused."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, TypeAlias

from cfgplan.errors import Fault
from cfgplan_runtime.reasoning.conditions import (
    RCC8,
    Absolute,
    Arithmetic,
    Comparison,
    Distance,
    Flag,
    Literal,
    Membership,
    Relation,
    Value,
)
from cfgplan_runtime.reasoning.syntax import (
    Always,
    And,
    Atom,
    Constant,
    Eventually,
    Formula,
    Implies,
    Not,
    Or,
    Until,
)
from cfgplan_runtime.reasoning.vocabulary import FUNCTIONS, Names, Vocabulary

if TYPE_CHECKING:
    from lark import Token, Tree

    Node: TypeAlias = Tree[Token] | Token

DEEPEST_FORMULA = 60
_PLAIN_SIGN = {"≤": "<=", "≥": ">=", "≠": "!=", "=": "=="}
_NOTHING = Constant(True)


class Reader:
    """Reads one tree; goes on after a mistake, so that all are found."""

    def __init__(self, vocabulary: Vocabulary, file: str) -> None:
        self._names = Names(vocabulary, file)
        self._depth = 0

    @property
    def faults(self) -> list[Fault]:
        """What is wrong, in the order in which it was found."""
        return self._names.faults

    def formula(self, node: Node) -> Formula:
        """The formula that a node is."""
        with self._deeper(node) as is_shallow:
            return self._formula(node) if is_shallow else _NOTHING

    @contextmanager
    def _deeper(self, node: Node) -> Iterator[bool]:
        self._depth += 1
        if self._depth > DEEPEST_FORMULA:
            self._names.wrong(
                node, f"the formula is nested more than {DEEPEST_FORMULA} deep", "split it into several queries"
            )
        yield self._depth <= DEEPEST_FORMULA
        self._depth -= 1

    def _formula(self, node: Any) -> Formula:
        parts = node.children
        match node.data:
            case "implication":
                return Implies(self.formula(parts[0]), self.formula(parts[2]))
            case "disjunction" | "conjunction":
                joined = self.formula(parts[0])
                for part in parts[2::2]:
                    right = self.formula(part)
                    joined = Or(joined, right) if node.data == "disjunction" else And(joined, right)
                return joined
            case "negation":
                return Not(self.formula(parts[1]))
            case "always" | "eventually":
                kind = Always if node.data == "always" else Eventually
                return kind(self.formula(parts[-1]), self._names.interval(parts[1:-1]))
            case "strife":
                return Until(self.formula(parts[0]), self.formula(parts[-1]), self._names.interval(parts[2:-1]))
            case "comparison":
                return self._comparison(node)
            case "call":
                return self._call(node)
            case "field":
                found = self._names.field(node)
                return _NOTHING if found is None else Atom(Flag(found))
            case "true" | "false":
                return Constant(node.data == "true")
            case _:
                self._names.wrong(node, "this is a value, no formula", "compare it with another: `ball.x > 0`")
                return _NOTHING

    def _comparison(self, node: Any) -> Formula:
        values = [self._value(part) for part in node.children[::2]]
        signs = [_PLAIN_SIGN.get(str(sign), str(sign)) for sign in node.children[1::2]]
        joined: Formula | None = None
        for sign, left, right in zip(signs, values, values[1:], strict=False):
            if left is None or right is None:
                continue
            kinds = {type(one.value) for one in (left, right) if isinstance(one, Literal)}
            kinds |= {float for one in (left, right) if isinstance(one, (Arithmetic, Absolute, Distance))}
            if len(kinds) > 1:
                self._names.wrong(
                    node, "a number and a text can't be compared", "write both as numbers, or both in quotes"
                )
            elif bool in kinds and sign not in ("==", "!="):
                self._names.wrong(node, "true and false have no order", "compare them by == or !=")
            atom = Atom(Comparison(sign, left, right))
            joined = atom if joined is None else And(joined, atom)
        return joined or _NOTHING

    def _call(self, node: Any) -> Formula:
        name, arguments = str(node.children[0]), node.children[1:]
        plain = name.lower() if name.lower() in RCC8 else name
        if plain == "in" and self._names.has_two(node, "a point and a region: in(ball, goal)"):
            point, region = self._names.field_of(arguments[0], "a point"), self._names.region(arguments[1])
            return Atom(Membership(point, region)) if point and region else _NOTHING
        if plain in RCC8 and self._names.has_two(node, f"two regions: {name}(hull, goal)"):
            left, right = self._names.region(arguments[0]), self._names.region(arguments[1])
            return Atom(Relation(plain, left, right)) if left and right else _NOTHING
        if plain in ("distance", "abs"):
            self._names.wrong(node, f"{name}(...) is a number, no formula", f"compare it: `{name}(...) < 1`")
        elif plain not in FUNCTIONS:
            self._names.unknown_function(node)
        return _NOTHING

    def _value(self, node: Any) -> Value | None:
        with self._deeper(node) as is_shallow:
            return self._value_of(node) if is_shallow else None

    def _value_of(self, node: Any) -> Value | None:
        parts = node.children
        match node.data:
            case "number":
                return Literal(float(parts[0]))
            case "text":
                return Literal(str(parts[0])[1:-1])
            case "true" | "false":
                return Literal(node.data == "true")
            case "field":
                return self._names.field(node)
            case "minus":
                return self._arithmetic(node, [(None, Literal(0.0)), ("-", self._value(parts[1]))])
            case "sum" | "product":
                first = (None, self._value(parts[0]))
                return self._arithmetic(
                    node, [first, *((str(s), self._value(v)) for s, v in zip(parts[1::2], parts[2::2], strict=True))]
                )
            case "call":
                return self._function(node)
            case _:
                self._names.wrong(
                    node, "this is a formula, but a value is compared", "put the comparison in parentheses"
                )
                return None

    def _arithmetic(self, node: Any, steps: list[tuple[str | None, Value | None]]) -> Value | None:
        total: Value | None = None
        for sign, value in steps:
            if value is None:
                return None
            if isinstance(value, Literal) and not isinstance(value.value, float):
                self._names.wrong(node, "only numbers can be calculated with")
                return None
            if total is None or sign is None:
                total = value
            elif total == Literal(0.0) and sign == "-" and isinstance(value, Literal):
                total = Literal(-float(value.value))
            else:
                total = Arithmetic(sign, total, value)
        return total

    def _function(self, node: Any) -> Value | None:
        name, arguments = str(node.children[0]), node.children[1:]
        if name == "abs":
            part = self._value(arguments[0])
            if len(arguments) != 1:
                self._names.wrong(node, "abs takes one number")
            return None if part is None else Absolute(part)
        if name == "distance":
            if not self._names.has_two(node, "two points: distance(ball, robot)"):
                return None
            left, right = (self._names.field_of(one, "a point") for one in arguments)
            return Distance(left, right) if left and right else None
        if name in ("in", *RCC8):
            self._names.wrong(node, f"{name}(...) is a formula, no value", "put `and`, `or`, `not` before or after it")
        else:
            self._names.unknown_function(node)
        return None
