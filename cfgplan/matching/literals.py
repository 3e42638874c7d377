"""Literals in axioms: the facts that follow from them, and the axioms rewritten so that reasoners accept them.

Reasoners know the datatypes of OWL 2 except base64Binary: HermiT holds that it has no literals, and so finds
contradictions.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping, Set
from types import MappingProxyType
from typing import Final

from cfgplan.matching.axioms import LITERAL, Subvalue, statements_of
from cfgplan.matching.functional import Tree, leaves, parse
from cfgplan.matching.names import short_name
from cfgplan.onward import reached

XSD: Final = "http://www.w3.org/2001/XMLSchema#"
_DECIMAL: Final = r"(?a:[+-]?(\d+(\.\d*)?|\.\d+))"
_DOUBLE: Final = rf"{_DECIMAL}([eE][+-]?[0-9]+)?|-?INF|NaN"
_ZONE: Final = r"(Z|[+-](0[0-9]|1[0-3]):[0-5]\d|[+-]14:00)"
_XSD_TIME: Final = r"(([01]\d|2[0-3]):[0-5]\d:[0-5]\d(\.\d+)?|24:00:00(\.0+)?)"
_DATE_TIME: Final = rf"(?a:-?(?P<year>\d{{4}})-(?P<month>0[1-9]|1[0-2])-(?P<day>[0-3]\d)T{_XSD_TIME})"
_XSD_TOKEN: Final = r"(\S+( \S+)*)?"
_XML_NAME: Final = r"[^\W\d][\w.\-·]*"

_LITERAL_FORMS: Final = MappingProxyType(
    {
        "string": r"(?s:.*)", "normalizedString": r"[^\t\n\r]*", "token": _XSD_TOKEN, "NMTOKEN": r"[\w.\-:·]+",
        "Name": rf":*{_XML_NAME}(:[\w.\-:·]*)*", "NCName": _XML_NAME, "language": r"[a-zA-Z]{1,8}(-[a-zA-Z0-9]{1,8})*",
        "anyURI": r"([^\s%<>\"{}|\\^`]|%[0-9a-fA-F]{2})*", "boolean": r"true|false|1|0",
        "decimal": _DECIMAL, "double": _DOUBLE, "float": _DOUBLE,
        "hexBinary": r"([0-9a-fA-F]{2})*", "dateTime": f"{_DATE_TIME}{_ZONE}?", "dateTimeStamp": f"{_DATE_TIME}{_ZONE}",
    }
)  # fmt: skip
"""Patterns; compiling all of them would take as long as reading a small ontology."""
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
        LITERAL,
        *(f"http://www.w3.org/2002/07/owl#{name}" for name in ("real", "rational")),
        *(f"http://www.w3.org/1999/02/22-rdf-syntax-ns#{name}" for name in ("PlainLiteral", "XMLLiteral")),
    )
)


def is_known(datatype: str) -> bool:
    """Whether reasoners know a datatype; they refuse an ontology for most others."""
    name = datatype.removeprefix(XSD)
    return name in _LITERAL_FORMS or name in _RANGES if datatype.startswith(XSD) else datatype in _BESIDES


def is_well_formed(text: str, datatype: str) -> bool:
    """Whether a text is a literal of a known datatype; reasoners refuse an ontology with one that is not."""
    name = datatype.removeprefix(XSD)
    if name in _RANGES:
        least, most = _RANGES[name]
        is_whole = _INTEGER.fullmatch(text) is not None
        return is_whole and (least is None or least <= int(text)) and (most is None or int(text) <= most)
    if name not in _LITERAL_FORMS:
        return True
    found = re.fullmatch(_LITERAL_FORMS[name], text)
    if found is None or "day" not in found.groupdict():
        return found is not None
    from calendar import monthrange

    # The calendar is the same again after 400 years.
    return 1 <= int(found["day"]) <= monthrange(2000 + int(found["year"]) % 400, int(found["month"]))[1]


LOST_LITERALS: Final = "what "
"""How the description of literals that are lost begins; the data property and the individual follow."""
_TYPED: Final = re.compile(r'("(?:[^"\\]|\\.)*)"\^\^<([^>]*)>')
_ASSERTION: Final = re.compile(r"DataPropertyAssertion\(<([^>]*)> (<[^>]*>|_:\w+) ")
_RESTRICTING: Final = (
    *("DataPropertyRange(", "FunctionalDataProperty(", "DisjointDataProperties(", "NegativeDataPropertyAssertion("),
    *("DatatypeDefinition(", "HasKey("),
)


def accepted_by_reasoners(axioms: Collection[str]) -> tuple[frozenset[str], dict[str, str]]:
    """Return the axioms as reasoners accept them, and the axioms lost by that, each with the reason.

    Malformed literals and those of unknown datatypes become texts if only ranges of their own datatype restrict them.
    Otherwise reasoners get an axiom that some literal exists. A restriction to such a datatype or literal is left out.
    """
    foreign = {axiom: kinds for axiom in axioms if "^^" in axiom and (kinds := _foreign(axiom))}
    restricting = {a: parse(a) for a in axioms if a.startswith(_RESTRICTING) or " Data" in a or "(Data" in a}
    defined = {str(tree[1]) for tree in restricting.values() if tree[0] == "DatatypeDefinition"}
    untold = {a: kinds for a, tree in restricting.items() if (kinds := frozenset(_foreign_in(tree)) - defined)}
    if not foreign and not untold:
        return frozenset(axioms), {}
    used = _Usage(axioms, restricting)
    lost = {axiom: _why(kinds) for axiom, kinds in untold.items() if used.is_missed(axiom, untold)}
    result = set(axioms) - foreign.keys() - untold.keys()
    for axiom in foreign.keys() - restricting.keys():
        found = _ASSERTION.match(axiom)
        if found is None:
            continue
        name, individual = found.groups()
        limits = [other for other in used.limits({*used.reached(name)}) if other not in untold or other in lost]
        if limits:
            result.add(f"ClassAssertion(DataSomeValuesFrom(<{name}> <{LITERAL}>) {individual})")
            text = f"{LOST_LITERALS}<{name}> is of {individual}"
            lost[text] = f"{_why(foreign[axiom])}, and it is restricted: {min(limits)}"
        else:
            result.add(_TYPED.sub(_as_text, axiom))
    return frozenset(result), lost


class _Usage:
    """The literals and the restrictions of data properties."""

    def __init__(self, axioms: Collection[str], restricting: Mapping[str, Tree]) -> None:
        self._restricting = restricting
        self._above = above_of(
            map(parse, (axiom for axiom in axioms if axiom.startswith(("SubData", "EquivalentData"))))
        )
        self._names = {axiom: frozenset(leaves(tree)) for axiom, tree in restricting.items()}
        self._values: defaultdict[Tree, set[str]] = defaultdict(set)
        for axiom in axioms:
            found = _ASSERTION.match(axiom)
            if found:
                types = {name for _, name in _TYPED.findall(axiom)} or {""}
                for name in self.reached(found[1]):
                    self._values[name] |= types

    def reached(self, name: Tree) -> set[Tree]:
        """A data property and all above it."""
        return reached_from(name, self._above)

    def limits(self, names: Set[Tree]) -> list[str]:
        """The axioms that restrict one of some data properties."""
        return [axiom for axiom, others in self._names.items() if not others.isdisjoint(names)]

    def is_missed(self, axiom: str, untold: Mapping[str, frozenset[str]]) -> bool:
        """Whether leaving a restriction out loses something. Only a range loses nothing, if no other axiom restricts
        the property and all its literals are of that datatype.
        """
        tree, kinds = self._restricting[axiom], untold[axiom]
        if tree[0] == "DatatypeDefinition":
            return False
        related = {tree[1]}.union(*(self.reached(name) for name in self._values if tree[1] in self.reached(name)))
        is_alone = tree[0] == "DataPropertyRange" and all(
            untold.get(other) == kinds and self._restricting[other][0] == "DataPropertyRange"
            for other in self.limits(related)
        )
        return not (is_alone and self._values[tree[1]] <= kinds)


def _foreign(axiom: str) -> frozenset[str]:
    """Return the datatypes in an axiom's literals that reasoners don't know, and its malformed literals."""
    return frozenset(kind for text, name in _TYPED.findall(axiom) if (kind := _foreign_kind(text, name)) is not None)


def _foreign_kind(quoted: str, datatype: str) -> str | None:
    if not is_known(datatype):
        return datatype
    text = quoted[1:].replace('\\"', '"').replace("\\\\", "\\")
    return None if is_well_formed(text, datatype) else f'{quoted}"^^<{datatype}>'


def _why(kinds: frozenset[str]) -> str:
    unknown = ", ".join(sorted(short_name(kind) for kind in kinds if not kind.startswith('"')))
    malformed = ", ".join(sorted(kind for kind in kinds if kind.startswith('"')))
    said = [f"reasoners don't know the datatype {unknown}"] if unknown else []
    return " and ".join([*said, f"the literal {malformed} is malformed"] if malformed else said)


def _as_text(literal: re.Match[str]) -> str:
    is_foreign = _foreign_kind(literal[1], literal[2]) is not None
    return f'{literal[1]} ({short_name(literal[2])})"' if is_foreign else literal.group()


def _foreign_in(tree: Tree) -> Iterator[str]:
    """Yield the unknown datatypes that an axiom or expression names, and its malformed literals."""
    keyword, arguments = tree[0], tree[1:]
    if keyword in ("DataPropertyRange", "DataSomeValuesFrom", "DataAllValuesFrom"):
        places = arguments[-1:]
    elif keyword in ("DataMinCardinality", "DataMaxCardinality", "DataExactCardinality"):
        places = arguments[2:]
    elif keyword in ("DataUnionOf", "DataIntersectionOf", "DataComplementOf", "DatatypeRestriction"):
        places = arguments if keyword != "DatatypeRestriction" else arguments[:1]
    else:
        places = arguments[1:] if keyword == "DatatypeDefinition" else ()
    named = (place for place in places if isinstance(place, str) and not place.startswith('"'))
    yield from (name for name in named if not is_known(name))
    for argument in arguments:
        if isinstance(argument, tuple):
            yield from _foreign_in(argument)
        elif argument.startswith('"'):
            yield from _foreign(argument)


def above_of(trees: Iterable[Tree]) -> Mapping[Tree, set[Tree]]:
    """The direct super-properties of each data property."""
    above: defaultdict[Tree, set[Tree]] = defaultdict(set)
    for statement in (statement for tree in trees for statement in statements_of(tree) or ()):
        if isinstance(statement, Subvalue):
            above[statement.sub].add(statement.sup)
    return above


def reached_from(name: Tree, above: Mapping[Tree, set[Tree]]) -> set[Tree]:
    """A data property and all above it."""
    return {*reached((name,), lambda below: above.get(below, ()))}
