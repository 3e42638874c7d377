"""The names in a formula looked up, its intervals read, and its mistakes collected."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from decimal import Decimal
from typing import Any

from cfgplan.errors import Fault, did_you_mean
from cfgplan_runtime.reasoning.conditions import RCC8, Field, RegionName
from cfgplan_runtime.reasoning.grammar import SPELLED
from cfgplan_runtime.reasoning.regions import Region
from cfgplan_runtime.reasoning.syntax import ALL_TIME, Interval

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


@dataclass(frozen=True)
class Vocabulary:
    """The names that a formula may use."""

    features: Collection[str] = ()
    regions: Mapping[str, Region] = field(default_factory=dict)


class Names:
    """Looks names up; a mistake is noted, and None or something harmless given, so that reading goes on."""

    def __init__(self, vocabulary: Vocabulary, file: str) -> None:
        self.faults: list[Fault] = []
        self._vocabulary = vocabulary
        self._file = file

    def field(self, node: Any) -> Field | None:
        name = str(node.children[0])
        keys = tuple(str(key)[1:] if key.type == "DOT_NAME" else int(key) for key in node.children[1:])
        if name in self._vocabulary.features:
            return Field(name, keys)
        if name in self._vocabulary.regions:
            self.wrong(node, f"{name} is a region", f"say what is in it: `in(ball, {name})`")
            return None
        known = sorted(self._vocabulary.features)
        listed = f"there is {', '.join(known)}; declare" if known else "declare"
        otherwise = f"{listed} it with --feature {name}='TAG' or in a features file"
        self.wrong(node, f"unknown feature `{name}`", did_you_mean(name, known, otherwise))
        return None

    def field_of(self, node: Any, what: str) -> Field | None:
        if node.data == "field":
            return self.field(node)
        self.wrong(node, f"this is not {what} of a feature", "write a feature's name, or one of its fields")
        return None

    def region(self, node: Any) -> RegionName | Field | None:
        if node.data == "field" and len(node.children) == 1:
            name = str(node.children[0])
            if name in self._vocabulary.regions:
                return RegionName(name)
            if name not in self._vocabulary.features:
                known = sorted([*self._vocabulary.regions, *self._vocabulary.features])
                listed = f"there is {', '.join(known)}; declare" if known else "declare"
                otherwise = f"{listed} it with --region {name}='{{box: [x, y, x, y]}}' or in a features file"
                self.wrong(node, f"unknown region `{name}`", did_you_mean(name, known, otherwise))
                return None
        return self.field_of(node, "a region")

    def has_two(self, node: Any, what: str) -> bool:
        if len(node.children) == 3:
            return True
        self.wrong(node, f"{node.children[0]} takes {what}")
        return False

    def unknown_function(self, node: Any) -> None:
        name = str(node.children[0])
        otherwise = f"there is {', '.join(FUNCTIONS)}"
        mend = f"`{name}` is written {SPELLED[name]} here" if name in SPELLED else None
        self.wrong(node, f"unknown function `{name}`", mend or did_you_mean(name, FUNCTIONS, otherwise))

    def interval(self, nodes: list[Any]) -> Interval:
        if not nodes:
            return ALL_TIME
        node = nodes[0]
        first, last, bracket = node.children
        units = [str(bound.children[1]) for bound in (first, last) if len(bound.children) == 2]
        begin = self._bound(first, units[0] if units else "s")
        end = self._bound(last, units[-1] if units else "s")
        if begin is None:
            self.wrong(first, "an interval can't begin at infinity")
            return ALL_TIME
        if end is None:
            return Interval(begin)
        end -= bracket.type == "RPAR"
        if end < begin:
            is_empty = end + 1 == begin and bracket.type == "RPAR"
            what = "is empty" if is_empty else "ends before it starts"
            self.wrong(node, f"the interval {what}", "write the earlier bound first: [0, 10s]")
            return ALL_TIME
        return Interval(begin, end)

    def _bound(self, node: Any, unit: str) -> int | None:
        number = node.children[0]
        if number.type == "INFINITE":
            return None
        if len(node.children) == 2:
            unit = str(node.children[1])
        span = Decimal(str(number)) * _UNIT_NS[unit]
        if span > _LONGEST_NS:
            self.wrong(node, "the interval is longer than a century", "write inf for an interval without an end")
            return 0
        return round(span)

    def wrong(self, node: Any, message: str, mend: str | None = None) -> None:
        meta = getattr(node, "meta", node)
        fault = Fault(message, self._file, meta.line, meta.column, mend=mend)
        if fault not in self.faults:
            self.faults.append(fault)
