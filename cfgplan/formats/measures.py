"""Convert numbers that people write with a unit of measurement to the one unit of their key."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from decimal import Decimal
from typing import Final

_NUMBER: Final = r"(\d{1,12}(?:\.\d{1,12})?) ?"
_PREFIXES: Final = " kmgt"
"""Each prefix means a thousand times the one before. Bytes and bits have no thousandths, so that `mb` is a million."""


@dataclass(frozen=True)
class Measure:
    """The unit of a key's numbers, in words, a usual number, and the size of other units in this unit, by pattern.

    If a number `has_thousandths`, the prefix `m` stands for one.
    """

    unit: str
    usual: str
    others: Mapping[str, Decimal]
    has_thousandths: bool = False

    def number(self, text: str) -> Decimal | None:
        """Return the number in this unit that a text like `5 Mbit/s` means; None for any other text."""
        for pattern, worth in self.others.items():
            found = re.fullmatch(rf"{_NUMBER}([kKmMgGtT]?)(i?)(?:{pattern})", text.strip())
            if found is not None and not text.strip().endswith(found[1]):
                thousand = Decimal(1024 if found[3] else 1000)
                is_thousandth = self.has_thousandths and found[2] == "m"
                power = -1 if is_thousandth else _PREFIXES.index(found[2].casefold() or " ")
                return Decimal(found[1]) * thousand**power * worth
        return None


_BYTES: Final = "(?:[bB]|[bB]ytes?)?"
MEASURES: Final[Mapping[str, Measure]] = {
    "bandwidth": Measure(
        "bytes per second",
        "1000000",
        {"B/s|Bps|[bB]ytes?/s": Decimal(1), "b/s|bps|[bB]its?/s|[bB]its?": Decimal("0.125")},
    ),
    "energy": Measure("watt seconds", "36000", {"Wh": Decimal(3600), "Ws|J": Decimal(1)}, has_thousandths=True),
    "memory": Measure("megabytes", "200", {_BYTES: Decimal("0.000001")}),
    "rate": Measure("elements per second", "10", {"[hH][zZ]": Decimal(1)}, has_thousandths=True),
    "size": Measure("bytes", "1000", {_BYTES: Decimal(1)}),
}
"""The measure of each key whose numbers people write with a unit, apart from times and shares of a core."""
