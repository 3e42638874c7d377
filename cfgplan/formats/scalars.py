"""The value of an unquoted YAML scalar, by the core schema of YAML 1.2.

`on`, `no` and dates are text, as JSON Schema editors see them; numbers with a point or an exponent become Decimal, so
that a cost is exactly as written.
"""

from __future__ import annotations

import re
from decimal import Decimal

_SPECIAL: dict[str, bool | Decimal | None] = {
    **dict.fromkeys(("", "~", "null", "Null", "NULL"), None),
    **dict.fromkeys(("true", "True", "TRUE"), True),
    **dict.fromkeys(("false", "False", "FALSE"), False),
    **dict.fromkeys((".nan", ".NaN", ".NAN"), Decimal("NaN")),
}
_INFINITE = re.compile(r"[-+]?\.(inf|Inf|INF)")
_WHOLE = re.compile(r"[-+]?[0-9]{1,400}")
_BASED = re.compile(r"0o[0-7]{1,400}|0x[0-9a-fA-F]{1,400}")
_FRACTION = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]{1,9})?")

FIRST_OF_NON_TEXT = frozenset("0123456789+-.~nNtTfF")
"""A scalar that begins otherwise is text."""

Scalar = str | int | bool | Decimal | None


def resolve(text: str) -> Scalar:
    """The value of an unquoted scalar."""
    if text in _SPECIAL:
        return _SPECIAL[text]
    if _WHOLE.fullmatch(text):
        return int(text)
    if _FRACTION.fullmatch(text):
        return Decimal(text)
    if _BASED.fullmatch(text):
        return int(text, 0)
    if _INFINITE.fullmatch(text):
        return Decimal("-Infinity" if text.startswith("-") else "Infinity")
    return text
