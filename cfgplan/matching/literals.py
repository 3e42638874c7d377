"""What literals say about the individuals that have them, and what of it reasoners can be told."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping
from typing import Final

from cfgplan.matching.concepts import Nominal
from cfgplan.matching.expressions import OutsideError, concept_of
from cfgplan.matching.functional import Tree, parse
from cfgplan.matching.names import short_name
from cfgplan.matching.statements import Translation, include

_XSD: Final = "http://www.w3.org/2001/XMLSchema#"
_LITERAL: Final = "http://www.w3.org/2000/01/rdf-schema#Literal"
_KNOWN: Final = frozenset(
    (
        *("string", "normalizedString", "token", "language", "Name", "NCName", "NMTOKEN", "boolean", "anyURI"),
        *("decimal", "integer", "nonNegativeInteger", "nonPositiveInteger", "positiveInteger", "negativeInteger"),
        *("long", "int", "short", "byte", "unsignedLong", "unsignedInt", "unsignedShort", "unsignedByte"),
        *("double", "float", "hexBinary", "base64Binary", "dateTime", "dateTimeStamp"),
    )
)
"""The XML Schema datatypes of OWL 2; a reasoner refuses an ontology for most others."""
_KNOWN_BESIDES: Final = frozenset(
    (
        _LITERAL,
        *(f"http://www.w3.org/2002/07/owl#{name}" for name in ("real", "rational")),
        *(f"http://www.w3.org/1999/02/22-rdf-syntax-ns#{name}" for name in ("PlainLiteral", "XMLLiteral")),
    )
)
_TYPED: Final = re.compile(r'("(?:[^"\\]|\\.)*)"\^\^<([^>]*)>')
_ASSERTION: Final = re.compile(r"DataPropertyAssertion\(<([^>]*)> (<[^>]*>|_:\w+) ")
_RESTRICTING: Final = (
    *("DataPropertyRange(", "FunctionalDataProperty(", "DisjointDataProperties(", "NegativeDataPropertyAssertion("),
    *("DatatypeDefinition(", "HasKey("),
)


def told(axioms: Collection[str]) -> tuple[frozenset[str], dict[str, str]]:
    """The axioms as reasoners can be told them, and what is lost by that, with the reason.

    Literals of datatypes that they don't know become texts where nothing restricts them, or only ranges of their own
    datatype. Else what is told is that there is some literal. A restriction to such a datatype is not told.
    """
    foreign = {axiom: types for axiom in axioms if "^^" in axiom and (types := _foreign(_TYPED.findall(axiom)))}
    restricting = {a: parse(a) for a in axioms if a.startswith(_RESTRICTING) or " Data" in a or "(Data" in a}
    defined = {str(tree[1]) for tree in restricting.values() if tree[0] == "DatatypeDefinition"}
    untold = {
        axiom: names
        for axiom, tree in restricting.items()
        if (names := {name for name in _datatypes(tree) if not _is_known(name)} - defined)
    }
    if not foreign and not untold:
        return frozenset(axioms), {}
    above = _above(map(parse, (axiom for axiom in axioms if axiom.startswith(("SubData", "EquivalentData")))))
    values: defaultdict[Tree, set[str]] = defaultdict(set)
    for axiom in axioms:
        found = _ASSERTION.match(axiom)
        if found:
            types = {name for _, name in _TYPED.findall(axiom)} or {""}
            for name in _reached(found[1], above):
                values[name] |= types
    names_in = {axiom: frozenset(_names(tree)) for axiom, tree in restricting.items()}
    lost: dict[str, str] = {}
    result = set(axioms) - foreign.keys() - untold.keys()
    for axiom, unknown in untold.items():
        tree = restricting[axiom]
        related = {tree[1]}.union(*(_reached(name, above) for name in values if tree[1] in _reached(name, above)))
        is_alone = tree[0] == "DataPropertyRange" and all(
            other in untold and restricting[other][0] == "DataPropertyRange" and untold[other] == unknown
            for other, names in names_in.items()
            if not names.isdisjoint(related)
        )
        if not (is_alone and values[tree[1]] <= unknown) and tree[0] != "DatatypeDefinition":
            lost[axiom] = f"reasoners don't know the datatype {', '.join(sorted(map(short_name, unknown)))}"
    for axiom in foreign.keys() - restricting.keys():
        found = _ASSERTION.match(axiom)
        if found is None:
            continue
        name, individual = found.groups()
        above_it = _reached(name, above)
        limits = [other for other, names in names_in.items() if not names.isdisjoint(above_it)]
        limits = [other for other in limits if other not in untold or other in lost]
        if limits:
            result.add(f"ClassAssertion(DataSomeValuesFrom(<{name}> <{_LITERAL}>) {individual})")
            kinds = ", ".join(sorted(map(short_name, foreign[axiom])))
            why = f"reasoners don't know them, and they are restricted: {min(limits)}"
            lost[f"literals of {kinds} at <{name}>"] = why
        else:
            result.add(_TYPED.sub(_as_text, axiom))
    return frozenset(result), lost


def _foreign(literals: Iterable[tuple[str, str]]) -> set[str]:
    return {name for _, name in literals if not _is_known(name)}


def _is_known(datatype: str) -> bool:
    return datatype.removeprefix(_XSD) in _KNOWN if datatype.startswith(_XSD) else datatype in _KNOWN_BESIDES


def _as_text(literal: re.Match[str]) -> str:
    return literal.group() if _is_known(literal[2]) else f'{literal[1]} ({short_name(literal[2])})"'


def _names(tree: Tree) -> Iterator[str]:
    for part in tree[1:] if isinstance(tree, tuple) else (tree,):
        if isinstance(part, tuple):
            yield from _names(part)
        else:
            yield part


def _datatypes(tree: Tree) -> Iterator[str]:
    """The datatypes that an axiom or expression names, those of its literals too."""
    keyword, arguments = tree[0], tree[1:]
    if keyword in ("DataPropertyRange", "DataSomeValuesFrom", "DataAllValuesFrom"):
        places = arguments[-1:]
    elif keyword in ("DataMinCardinality", "DataMaxCardinality", "DataExactCardinality"):
        places = arguments[2:]
    elif keyword in ("DataUnionOf", "DataIntersectionOf", "DataComplementOf", "DatatypeRestriction"):
        places = arguments if keyword != "DatatypeRestriction" else arguments[:1]
    else:
        places = arguments[1:] if keyword == "DatatypeDefinition" else ()
    yield from (place for place in places if isinstance(place, str) and not place.startswith('"'))
    for argument in arguments:
        if isinstance(argument, tuple):
            yield from _datatypes(argument)
        elif argument.startswith('"'):
            yield from (name for _, name in _TYPED.findall(argument))


def _above(trees: Iterable[Tree]) -> Mapping[Tree, set[Tree]]:
    """The data properties right above each."""
    above: defaultdict[Tree, set[Tree]] = defaultdict(set)
    for tree in trees:
        if tree[0] == "SubDataPropertyOf":
            above[tree[1]].add(tree[2])
        elif tree[0] == "EquivalentDataProperties":
            for one in tree[1:]:
                above[one].update(tree[1:])
    return above


def _reached(name: Tree, above: Mapping[Tree, set[Tree]]) -> set[Tree]:
    """A data property and all above it."""
    reached, waiting = {name}, [name]
    while waiting:
        news = above.get(waiting.pop(), set()) - reached
        reached |= news
        waiting += news
    return reached


def translate_data_properties(trees: Mapping[str, Tree], result: Translation) -> None:
    """What literals say about their individuals: the domains; what could contradict them is outside."""
    above = _above(trees.values())
    individuals: defaultdict[Tree, set[str]] = defaultdict(set)
    for tree in trees.values():
        if tree[0] == "DataPropertyAssertion":
            for name in _reached(tree[1], above):
                individuals[name].add(str(tree[2]))
    for axiom, tree in trees.items():
        if tree[0] == "DataPropertyDomain":
            try:
                for individual in sorted(individuals[tree[1]]):
                    include(Nominal(individual), concept_of(tree[2]), axiom, result)
            except OutsideError as reason:
                result.outside[axiom] = str(reason)
        elif tree[0] in ("DataPropertyRange", "FunctionalDataProperty") and individuals[tree[1]]:
            result.outside[axiom] = "a restriction of literals that are in use is outside the fast fragment"
