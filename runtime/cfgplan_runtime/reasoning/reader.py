"""The reader of lark's trees: it looks names up, and refuses parts that are no formula, number, point or region."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from decimal import Decimal
from typing import TYPE_CHECKING, Any, TypeAlias

from cfgplan.errors import Fault, did_you_mean
from cfgplan.extras import needed
from cfgplan_runtime.reasoning import syntax
from cfgplan_runtime.reasoning.conditions import (
    RCC8,
    Absolute,
    Arithmetic,
    Comparison,
    Distance,
    Field,
    Flag,
    Literal,
    Membership,
    RegionName,
    Relation,
    Value,
)
from cfgplan_runtime.reasoning.regions import Region

if TYPE_CHECKING:
    from lark import Token, Tree

    Node: TypeAlias = Tree[Token] | Token

SPELLED: Mapping[str, str] = {"G": "`always p`", "F": "`eventually p`", "U": "`p until q`"}
"""The spelling here of operators of other notations."""
FUNCTIONS = ("in", "distance", "abs", *RCC8)
SECOND_NS = 1_000_000_000
_UNIT_NS = {
    "ns": 1,
    "us": 1_000,
    "µs": 1_000,
    "ms": 1_000_000,
    "s": SECOND_NS,
    "min": 60 * SECOND_NS,
    "m": 60 * SECOND_NS,
    "h": 3600 * SECOND_NS,
}
_LONGEST_NS = 100 * 366 * 24 * 3600 * SECOND_NS
DEEPEST_FORMULA = 60
_PLAIN_SIGN = {"≤": "<=", "≥": ">=", "≠": "!=", "=": "=="}
_NOTHING = syntax.Constant(True)


@dataclass(frozen=True)
class Vocabulary:
    """The names that a formula may use."""

    features: Collection[str] = ()
    regions: Mapping[str, Region] = field(default_factory=dict)


class Reader:
    """Reads one tree. It adds each mistake to `faults`, and continues with a harmless part in its place."""

    def __init__(self, vocabulary: Vocabulary, file: str) -> None:
        self.faults: list[Fault] = []
        self._vocabulary = vocabulary
        self._file = file
        self._depth = 0

    def formula(self, node: Node) -> syntax.Formula:
        """The formula of a node."""
        with self._deeper(node) as is_shallow:
            return self._formula(node) if is_shallow else _NOTHING

    @contextmanager
    def _deeper(self, node: Node) -> Iterator[bool]:
        self._depth += 1
        if self._depth > DEEPEST_FORMULA:
            self._wrong(
                node, f"the formula is nested more than {DEEPEST_FORMULA} deep", "split it into several queries"
            )
        yield self._depth <= DEEPEST_FORMULA
        self._depth -= 1

    def _formula(self, node: Any) -> syntax.Formula:
        parts = node.children
        match node.data:
            case "implication":
                return syntax.Implies(self.formula(parts[0]), self.formula(parts[2]))
            case "disjunction" | "conjunction":
                joined = self.formula(parts[0])
                for part in parts[2::2]:
                    right = self.formula(part)
                    joined = syntax.Or(joined, right) if node.data == "disjunction" else syntax.And(joined, right)
                return joined
            case "negation":
                return syntax.Not(self.formula(parts[1]))
            case "always" | "eventually":
                kind = syntax.Always if node.data == "always" else syntax.Eventually
                return kind(self.formula(parts[-1]), self._interval(parts[1:-1]))
            case "strife":
                return syntax.Until(self.formula(parts[0]), self.formula(parts[-1]), self._interval(parts[2:-1]))
            case "comparison":
                return self._comparison(node)
            case "call":
                return self._call(node)
            case "field":
                found = self._field(node)
                return _NOTHING if found is None else syntax.Atom(Flag(found))
            case "true" | "false":
                return syntax.Constant(node.data == "true")
            case _:
                self._wrong(node, "this is a value, no formula", "compare it with another: `ball.x > 0`")
                return _NOTHING

    def _comparison(self, node: Any) -> syntax.Formula:
        values = [self._value(part) for part in node.children[::2]]
        signs = [_PLAIN_SIGN.get(str(sign), str(sign)) for sign in node.children[1::2]]
        joined: syntax.Formula | None = None
        for sign, left, right in zip(signs, values, values[1:], strict=False):
            if left is None or right is None:
                continue
            kinds = {type(one.written) for one in (left, right) if isinstance(one, Literal)}
            kinds |= {float for one in (left, right) if isinstance(one, (Arithmetic, Absolute, Distance))}
            if len(kinds) > 1:
                self._wrong(node, "a number and a text can't be compared", "write both as numbers, or both in quotes")
            elif bool in kinds and sign not in ("==", "!="):
                self._wrong(node, "true and false have no order", "compare them by == or !=")
            atom = syntax.Atom(Comparison(sign, left, right))
            joined = atom if joined is None else syntax.And(joined, atom)
        return joined or _NOTHING

    def _call(self, node: Any) -> syntax.Formula:
        name, arguments = str(node.children[0]), node.children[1:]
        plain = name.lower() if name.lower() in RCC8 else name
        if plain == "in" and self._has_two(node, "a point and a region: in(ball, goal)"):
            point, region = self._field_of(arguments[0], "a point"), self._region(arguments[1])
            return syntax.Atom(Membership(point, region)) if point and region else _NOTHING
        if plain in RCC8 and self._has_two(node, f"two regions: {name}(hull, goal)"):
            left, right = self._region(arguments[0]), self._region(arguments[1])
            return syntax.Atom(Relation(plain, left, right)) if left and right else _NOTHING
        if plain in ("distance", "abs"):
            self._wrong(node, f"{name}(...) is a number, no formula", f"compare it: `{name}(...) < 1`")
        elif plain not in FUNCTIONS:
            self._unknown_function(node)
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
                return self._field(node)
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
                self._wrong(node, "this is a formula, but a value is compared", "put the comparison in parentheses")
                return None

    def _arithmetic(self, node: Any, steps: list[tuple[str | None, Value | None]]) -> Value | None:
        total: Value | None = None
        for sign, value in steps:
            if value is None:
                return None
            if isinstance(value, Literal) and not isinstance(value.written, float):
                self._wrong(node, "only numbers can be calculated with")
                return None
            if total is None or sign is None:
                total = value
            elif total == Literal(0.0) and sign == "-" and isinstance(value, Literal):
                total = Literal(-float(value.written))
            else:
                total = Arithmetic(sign, total, value)
        return total

    def _function(self, node: Any) -> Value | None:
        name, arguments = str(node.children[0]), node.children[1:]
        if name == "abs":
            part = self._value(arguments[0])
            if len(arguments) != 1:
                self._wrong(node, "abs takes one number")
            return None if part is None else Absolute(part)
        if name == "distance":
            if not self._has_two(node, "two points: distance(ball, robot)"):
                return None
            left, right = (self._field_of(one, "a point") for one in arguments)
            return Distance(left, right) if left and right else None
        if name in ("in", *RCC8):
            self._wrong(node, f"{name}(...) is a formula, no value", "put `and`, `or`, `not` before or after it")
        else:
            self._unknown_function(node)
        return None

    def _field(self, node: Any) -> Field | None:
        name = str(node.children[0])
        keys = tuple(str(key)[1:] if key.type == "DOT_NAME" else int(key) for key in node.children[1:])
        if name in self._vocabulary.features:
            return Field(name, keys)
        if name in self._vocabulary.regions:
            self._wrong(node, f"{name} is a region", f"say what is in it: `in(ball, {name})`")
            return None
        self._unknown_name(node, "feature", self._vocabulary.features, "TAG")
        return None

    def _field_of(self, node: Any, what: str) -> Field | None:
        if node.data == "field":
            return self._field(node)
        self._wrong(node, f"this is not {what} of a feature", "write a feature's name, or one of its fields")
        return None

    def _region(self, node: Any) -> RegionName | Field | None:
        if node.data == "field" and len(node.children) == 1:
            name = str(node.children[0])
            if name in self._vocabulary.regions:
                return RegionName(name)
            if name not in self._vocabulary.features:
                known = [*self._vocabulary.regions, *self._vocabulary.features]
                self._unknown_name(node, "region", known, "{box: [x, y, x, y]}")
                return None
        needed("regions", "shapely")
        return self._field_of(node, "a region")

    def _has_two(self, node: Any, what: str) -> bool:
        if len(node.children) == 3:
            return True
        self._wrong(node, f"{node.children[0]} takes {what}")
        return False

    def _unknown_name(self, node: Any, kind: str, known: Collection[str], form: str) -> None:
        name, listed = str(node.children[0]), ", ".join(sorted(known))
        declare = f"declare it with --{kind} {name}='{form}' or in a features file"
        otherwise = f"declared are {listed}; {declare}" if known else declare
        self._wrong(node, f"unknown {kind} `{name}`", did_you_mean(name, sorted(known), otherwise))

    def _unknown_function(self, node: Any) -> None:
        name = str(node.children[0])
        otherwise = f"the functions are {', '.join(FUNCTIONS)}"
        mend = f"`{name}` is written {SPELLED[name]} here" if name in SPELLED else None
        self._wrong(node, f"unknown function `{name}`", mend or did_you_mean(name, FUNCTIONS, otherwise))

    def _interval(self, nodes: list[Any]) -> syntax.Interval:
        if not nodes:
            return syntax.ALL_TIME
        node = nodes[0]
        first, last, bracket = node.children
        units = [str(bound.children[1]) for bound in (first, last) if len(bound.children) == 2]
        begin = self._bound(first, units[0] if units else "s")
        end = self._bound(last, units[-1] if units else "s")
        if begin is None:
            self._wrong(first, "an interval can't begin at infinity")
            return syntax.ALL_TIME
        if end is None:
            return syntax.Interval(begin)
        end -= bracket.type == "RPAR"
        if end < begin:
            is_empty = end + 1 == begin and bracket.type == "RPAR"
            what = "is empty" if is_empty else "ends before it starts"
            self._wrong(node, f"the interval {what}", "write the earlier bound first: [0, 10s]")
            return syntax.ALL_TIME
        return syntax.Interval(begin, end)

    def _bound(self, node: Any, unit: str) -> int | None:
        number = node.children[0]
        if number.type == "INFINITE":
            return None
        if len(node.children) == 2:
            unit = str(node.children[1])
        span = Decimal(str(number)) * _UNIT_NS[unit]
        if span > _LONGEST_NS:
            self._wrong(node, "the interval is longer than a century", "write inf for an interval without an end")
            return 0
        return round(span)

    def _wrong(self, node: Any, message: str, mend: str | None = None) -> None:
        meta = getattr(node, "meta", node)
        fault = Fault(message, self._file, meta.line, meta.column, mend=mend)
        if fault not in self.faults:
            self.faults.append(fault)
