"""The datatypes that reasoners know, and how their literals are written.

They are those of OWL 2, but for base64Binary: to HermiT no literal is of it, so that it finds contradictions.
"""

from __future__ import annotations

import re
from calendar import monthrange
from types import MappingProxyType
from typing import Final

_XSD: Final = "http://www.w3.org/2001/XMLSchema#"
_DECIMAL: Final = r"(?a:[+-]?(\d+(\.\d*)?|\.\d+))"
_DOUBLE: Final = rf"{_DECIMAL}([eE][+-]?[0-9]+)?|-?INF|NaN"
_ZONE: Final = r"(Z|[+-](0[0-9]|1[0-3]):[0-5]\d|[+-]14:00)"
_TIME: Final = r"(([01]\d|2[0-3]):[0-5]\d:[0-5]\d(\.\d+)?|24:00:00(\.0+)?)"
_DATE_TIME: Final = rf"(?a:-?(?P<year>\d{{4}})-(?P<month>0[1-9]|1[0-2])-(?P<day>[0-3]\d)T{_TIME})"
_TOKEN: Final = r"(\S+( \S+)*)?"
_NAME: Final = r"[^\W\d][\w.\-·]*"

_FORMS: Final = MappingProxyType(
    {name: re.compile(form) for name, form in {
        "string": r"(?s:.*)", "normalizedString": r"[^\t\n\r]*", "token": _TOKEN, "NMTOKEN": r"[\w.\-:·]+",
        "Name": rf":*{_NAME}(:[\w.\-:·]*)*", "NCName": _NAME, "language": r"[a-zA-Z]{1,8}(-[a-zA-Z0-9]{1,8})*",
        "anyURI": r"([^\s%<>\"{}|\\^`]|%[0-9a-fA-F]{2})*", "boolean": r"true|false|1|0",
        "decimal": _DECIMAL, "double": _DOUBLE, "float": _DOUBLE,
        "hexBinary": r"([0-9a-fA-F]{2})*", "dateTime": f"{_DATE_TIME}{_ZONE}?", "dateTimeStamp": f"{_DATE_TIME}{_ZONE}",
    }.items()}
)  # fmt: skip
_INTEGER: Final = re.compile(r"[+-]?\d+", re.ASCII)
_RANGES: Final = MappingProxyType(
    {
        "integer": (None, None), "nonNegativeInteger": (0, None), "nonPositiveInteger": (None, 0),
        "positiveInteger": (1, None), "negativeInteger": (None, -1),
        **{name: (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1) for name, bits in
           (("long", 64), ("int", 32), ("short", 16), ("byte", 8))},
        **{name: (0, 2**bits - 1) for name, bits in
           (("unsignedLong", 64), ("unsignedInt", 32), ("unsignedShort", 16), ("unsignedByte", 8))},
    }
)  # fmt: skip
_BESIDES: Final = frozenset(
    (
        "http://www.w3.org/2000/01/rdf-schema#Literal",
        *(f"http://www.w3.org/2002/07/owl#{name}" for name in ("real", "rational")),
        *(f"http://www.w3.org/1999/02/22-rdf-syntax-ns#{name}" for name in ("PlainLiteral", "XMLLiteral")),
    )
)


def is_known(datatype: str) -> bool:
    """Whether reasoners know a datatype; they refuse an ontology for most others."""
    name = datatype.removeprefix(_XSD)
    return name in _FORMS or name in _RANGES if datatype.startswith(_XSD) else datatype in _BESIDES


def is_well_formed(text: str, datatype: str) -> bool:
    """Whether a text is a literal of a datatype that is known; reasoners refuse an ontology for one that is not."""
    name = datatype.removeprefix(_XSD)
    if name in _RANGES:
        least, most = _RANGES[name]
        is_whole = _INTEGER.fullmatch(text) is not None
        return is_whole and (least is None or least <= int(text)) and (most is None or int(text) <= most)
    if name not in _FORMS:
        return True
    found = _FORMS[name].fullmatch(text)
    if found is None or "day" not in found.groupdict():
        return found is not None
    # The calendar is the same again after 400 years.
    return 1 <= int(found["day"]) <= monthrange(2000 + int(found["year"]) % 400, int(found["month"]))[1]
