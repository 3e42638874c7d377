"""RDF documents as N-Triples that py-horned-owl reads without a loss.

From a valid ontology, py-horned-owl would silently drop disjointness of several classes or properties, anonymous
individuals, class expressions without a type, qualified cardinalities of inverse properties, names that are defined
without `owl:equivalentClass` (as OWL 1 allowed), and names of RDF Schema. It would refuse a second type of the ontology
itself, and the whole document for one comparison of an object property with a data property.

So these are rewritten first. Other statements that it drops are found by comparing its axioms with the triples.
"""

from __future__ import annotations

import json
import re
from collections import Counter, defaultdict
from collections.abc import Collection, Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Final, TypeAlias

from cfgplan.matching.literals import XSD
from cfgplan.matching.names import short_name

if TYPE_CHECKING:
    from pyoxigraph import Quad

OWL: Final = "http://www.w3.org/2002/07/owl#"
RDF: Final = "http://www.w3.org/1999/02/22-rdf-syntax-ns#"
RDFS: Final = "http://www.w3.org/2000/01/rdf-schema#"
SWRL: Final = "http://www.w3.org/2003/11/swrl#"
ANONYMOUS: Final = "urn:cfgplan:anonymous:"
"""Stands before the number of an anonymous individual."""
_INVERSE: Final = "urn:cfgplan:inverse:"
"""Stands before the name of a property whose inverse is meant."""
_INVERSE_IRI: Final = re.compile(f"<{_INVERSE}([^>]*)>")

_TYPE: Final = f"<{RDF}type>"
_BUILT_IN: Final = (f"<{OWL}", f"<{RDF}", f"<{RDFS}", f"<{SWRL}")
_OF_THE_HEADER: Final = (f"<{OWL}imports>", f"<{OWL}versionIRI>")
_DEPRECATED: Final = (f"<{OWL}DeprecatedClass>", f"<{OWL}DeprecatedProperty>")
_PROPERTY_TYPES: Final = tuple(f"<{OWL}{kind}Property>" for kind in ("Object", "Datatype", "Annotation"))
_CHAIN: Final = f"<{OWL}propertyChainAxiom>"
_COMPARING: Final = (f"<{OWL}equivalentProperty>", f"<{OWL}propertyDisjointWith>")
"""Predicates between properties of one kind, for which py-horned-owl refuses others."""
_ABOUT_INDIVIDUALS: Final = frozenset(
    f"<{OWL}{name}>"
    for name in ("sameAs", "differentFrom", "sourceIndividual", "targetIndividual", "Thing", "NamedIndividual")
)
_EXPRESSIONS: Final = tuple(f"<{OWL}{name}>" for name in ("unionOf", "intersectionOf", "complementOf", "oneOf"))
_DISJOINT: Final = {
    f"<{OWL}AllDisjointClasses>": "DisjointClasses",
    f"<{OWL}AllDisjointProperties>": "DisjointObjectProperties",
}
_SUB_PROPERTY: Final = ("SubObjectPropertyOf", "SubDataPropertyOf", "SubAnnotationPropertyOf")
_ASSERTIONS: Final = ("ObjectPropertyAssertion", "DataPropertyAssertion", "AnnotationAssertion")
_KEYWORDS: Final = {
    f"<{RDFS}subClassOf>": ("SubClassOf",),
    f"<{RDFS}subPropertyOf>": _SUB_PROPERTY,
    f"<{RDFS}domain>": ("ObjectPropertyDomain", "DataPropertyDomain", "AnnotationPropertyDomain"),
    f"<{RDFS}range>": ("ObjectPropertyRange", "DataPropertyRange", "AnnotationPropertyRange"),
    f"<{OWL}equivalentClass>": ("EquivalentClasses", "DatatypeDefinition"),
    f"<{OWL}disjointWith>": ("DisjointClasses",),
    f"<{OWL}disjointUnionOf>": ("DisjointUnion",),
    f"<{OWL}hasKey>": ("HasKey",),
    f"<{OWL}propertyChainAxiom>": _SUB_PROPERTY[:1],
    f"<{OWL}equivalentProperty>": ("EquivalentObjectProperties", "EquivalentDataProperties"),
    f"<{OWL}propertyDisjointWith>": ("DisjointObjectProperties", "DisjointDataProperties"),
    f"<{OWL}inverseOf>": ("InverseObjectProperties",),
    f"<{OWL}sameAs>": ("SameIndividual",),
    f"<{OWL}differentFrom>": ("DifferentIndividuals",),
}
"""The keywords of the axioms that a triple may stand for, by its predicate."""
_CHARACTERISTICS: Final = {
    f"<{OWL}{kind}Property>": tuple(f"{kind}{of}Property" for of in ("Object", "Data"))
    for kind in (
        *("Functional", "InverseFunctional", "Transitive", "Symmetric", "Asymmetric", "Reflexive", "Irreflexive"),
    )
}
_NO_AXIOM: Final = ("",)
_OF_EXPRESSIONS: Final = frozenset(f"<{OWL}{name}>" for name in ("onProperty", "onProperties", "onDatatype"))
"""Predicates that mean nothing on a name: an expression is anonymous."""
_ROOTS: Final = {
    f"<{OWL}AllDifferent>": ("DifferentIndividuals",),
    f"<{OWL}NegativePropertyAssertion>": ("NegativeObjectPropertyAssertion", "NegativeDataPropertyAssertion"),
    f"<{SWRL}Imp>": ("DLSafeRule",),
}
"""The keywords of the axioms that a node may stand for, by its type."""
_RDF_NAME: Final = r"<[^<>]*>"
_PLACES: Final = re.compile(rf"(\w+)\(({_RDF_NAME})?.*?({_RDF_NAME})?\)$", re.DOTALL)

Triple: TypeAlias = tuple[str, str, str]
"""Subject, predicate and object."""


class TripleGraph:
    """The triples of a document, terms in N-Triples; blank nodes are numbered in order of appearance."""

    def __init__(self, text: str, syntax: str, base: str) -> None:
        """Read Turtle ("ttl"), RDF/XML ("rdf") or JSON-LD ("jsonld"). Raises SyntaxError with line and column."""
        numbers: dict[str, str] = {}

        def term(value: object) -> str:
            written = str(value)
            return numbers.setdefault(written, f"_:b{len(numbers)}") if written.startswith("_:") else written

        self._triples: list[Triple] = [
            (term(quad.subject), term(quad.predicate), term(quad.object)) for quad in _quads(text, syntax, base)
        ]
        self.axioms: list[str] = []
        self._individuals: set[str] = set()
        self._refused: list[tuple[str, str]] = []
        """Subject and predicate of triples that are left out: py-horned-owl would refuse the document for them."""
        self._of: defaultdict[str, list[tuple[str, str]]] = defaultdict(list)
        self._index()

    def lossless(self) -> str:
        """The document in N-Triples; statements that triples would lose are in `axioms`, in functional syntax."""
        self._drop_what_means_nothing()
        self._name_inverse_properties()
        self._give_names_a_type()
        self._leave_out_what_is_refused()
        self._write_disjointness_as_axioms()
        self._give_expressions_a_type()
        self._individuals = self._anonymous_individuals()
        return self.text_of([self._triples])

    def text_of(self, parts: Iterable[Sequence[Triple]]) -> str:
        """Some triples in N-Triples."""
        triples = dict.fromkeys(triple for part in parts for triple in part)
        return "".join(f"{self._named(s)} {p} {self._named(o)} .\n" for s, p, o in triples)

    def parts(self) -> list[list[Triple]]:
        """The triples of `lossless` by axiom: each with all that its blank nodes stand for. Types come first."""
        self._index()
        inside = {o for s, _, o in self._triples if self._is_part(o) and o != s}
        heads = [triple for triple in self._triples if not (self._is_part(triple[0]) and triple[0] in inside)]
        heads.sort(key=lambda triple: triple[1] != _TYPE or triple[2].startswith("_:"))
        return [[head, *self._parts_of(head[2], {head[0]})] for head in heads]

    def _parts_of(self, term: str, seen: set[str]) -> Iterator[Triple]:
        waiting = [term]
        while waiting:
            node = waiting.pop()
            if self._is_part(node) and node not in seen:
                seen.add(node)
                yield from ((node, predicate, value) for predicate, value in self._of[node])
                waiting += (value for _, value in self._of[node])

    def leave_out(self, lost: Iterable[Sequence[Triple]], kept: Iterable[Sequence[Triple]]) -> None:
        """Note that some parts could not be read, so that `unread` tells of them, and go on with the others."""
        self._refused += [(subject, predicate) for (subject, predicate, _), *_ in lost]
        self._triples = [*dict.fromkeys(triple for part in kept for triple in part)]
        self._index()

    def _is_part(self, term: str) -> bool:
        """Whether a term is a blank node that stands for a part of an axiom."""
        return term.startswith("_:") and term not in self._individuals

    def _drop_what_means_nothing(self) -> None:
        """Drop triples about the ontology itself, deprecations, and restrictions typed as classes: they have no meaning
        here.
        """
        restriction = (_TYPE, f"<{OWL}Restriction>")
        header = {s for s, p, o in self._triples if p == _TYPE and o == f"<{OWL}Ontology>"}
        self._triples = [
            (s, p, o)
            for s, p, o in self._triples
            if (s not in header or p in _OF_THE_HEADER or o == f"<{OWL}Ontology>")
            and not (p == _TYPE and (o in _DEPRECATED or (o == f"<{OWL}Class>" and restriction in self._of[s])))
        ]

    def _name_inverse_properties(self) -> None:
        """Replace each anonymous inverse of a property by a name; `restored` undoes it."""
        is_inverse = f"<{OWL}inverseOf>"
        names = {
            s: f"<{_INVERSE}{o[1:-1]}>"
            for s, p, o in self._triples
            if p == is_inverse and s.startswith("_:") and o.startswith("<")
        }
        if not names:
            return
        kept = [
            (names.get(s, s), p, names.get(o, o)) for s, p, o in self._triples if not (s in names and p == is_inverse)
        ]
        self._triples = [*kept, *((name, _TYPE, _PROPERTY_TYPES[0]) for name in dict.fromkeys(names.values()))]
        self._index()

    def _index(self) -> None:
        self._of.clear()
        for subject, predicate, value in self._triples:
            self._of[subject].append((predicate, value))

    def _give_names_a_type(self) -> None:
        """Type classes and properties of RDF Schema as those of OWL: a property that has a literal is one of data."""
        properties: dict[str, bool] = {}
        for subject, predicate, value in list(self._triples):
            if predicate == _TYPE and value == f"<{RDFS}Class>":
                self._triples.append((subject, _TYPE, f"<{OWL}Class>"))
            elif predicate == _TYPE and value == f"<{RDF}Property>":
                properties.setdefault(subject, False)
            elif predicate == f"<{OWL}equivalentClass>":
                self._triples += [(name, _TYPE, f"<{OWL}Class>") for name in self._untyped_classes(subject, value)]
            elif predicate == f"<{RDFS}range>" and value.startswith((f"<{XSD}", f"<{RDFS}Literal>")):
                properties[subject] = True
        for _, predicate, value in self._triples:
            if value.startswith('"') and predicate in properties:
                properties[predicate] = True
        for name, is_data in properties.items():
            if not any((_TYPE, kind) in self._of[name] for kind in _PROPERTY_TYPES):
                self._triples.append((name, _TYPE, _PROPERTY_TYPES[is_data]))

    def _leave_out_what_is_refused(self) -> None:
        """Rewrite properties that py-horned-owl would refuse.

        A property without a type gets that of a property that it is compared with. Comparisons of object with data
        properties or between untyped properties are left out, as are chains of terms that are no property.
        """
        kinds: defaultdict[str, set[str]] = defaultdict(set)
        for subject, predicate, value in self._triples:
            if predicate == _TYPE and value in _PROPERTY_TYPES:
                kinds[subject].add(value)
        compared = [(s, o) for s, p, o in self._triples if p in _COMPARING and s.startswith("<") and o.startswith("<")]
        pairs = [*compared, *((o, s) for s, o in compared)]
        while True:
            found = {one: kinds[other] for one, other in pairs if not kinds[one] and kinds[other]}
            if not found:
                break
            kinds.update({name: {*said} for name, said in found.items()})
            self._triples += [(name, _TYPE, kind) for name, said in found.items() for kind in sorted(said)]

        def is_refused(subject: str, predicate: str, value: str) -> bool:
            if predicate == _CHAIN:
                return not all(member.startswith("<") for member in self._list(value))
            is_unknown = not kinds[subject] and not kinds[value]
            return is_unknown or (bool(kinds[subject] and kinds[value]) and not kinds[subject] & kinds[value])

        refused = {triple for triple in self._triples if triple[1] in (_CHAIN, *_COMPARING) and is_refused(*triple)}
        self._refused += sorted((subject, predicate) for subject, predicate, _ in refused)
        self._triples = [triple for triple in self._triples if triple not in refused]

    def _untyped_classes(self, one: str, other: str) -> list[str]:
        """Return those of two equivalent terms that are names without the type of a class; empty if one is a
        datatype.
        """
        data = (_TYPE, f"<{RDFS}Datatype>")
        if any(data in self._of[term] or term.startswith(f"<{XSD}") for term in (one, other)):
            return []
        return [
            term for term in (one, other) if term.startswith("<") and (_TYPE, f"<{OWL}Class>") not in self._of[term]
        ]

    def unread(self, axioms: Collection[str]) -> Iterator[str]:
        """Yield, shortened, the statements of the triples that are in no axiom read from `lossless`."""
        yield from (f"`{short_name(s.strip('<>'))} {short_name(p.strip('<>'))} ...`" for s, p in self._refused)
        known = frozenset(axioms)
        direct: set[str] = set()
        expected: defaultdict[tuple[tuple[str, ...], str, str], set[object]] = defaultdict(set)
        for subject, predicate, value in self._triples_of_axioms():
            keywords, name, arguments = _axiom_of(self._named(subject), predicate, self._named(value))
            said = known.intersection([f"{keyword}({arguments})" for keyword in keywords])
            direct |= said
            if not said:
                expected[keywords, name, predicate].add((self._structure(subject), self._structure(value)))
        places: Counter[tuple[str, str]] = Counter()
        for found in map(_PLACES.match, known - direct):
            if found:
                keyword, *names = found.groups()
                places.update((keyword, name) for name in {"", *filter(None, names)})
        for (keywords, name, predicate), meanings in expected.items():
            if sum(places[keyword, name] for keyword in keywords) < len(meanings):
                about = short_name(name.strip("<>")) if name else "[ ]"
                yield f"`{about} {short_name(predicate.strip('<>'))} ...`"

    def _triples_of_axioms(self) -> Iterator[tuple[str, str, str]]:
        """The triples that each stand for an axiom: no annotations, declarations or parts of expressions."""
        annotations = {s for s, p, o in self._triples if p == _TYPE and o == _PROPERTY_TYPES[2]}
        for subject, predicate, value in self._triples:
            is_part = self._is_part(subject)
            if predicate == _TYPE:
                is_of_owl = value.startswith(_BUILT_IN)
                is_meant = (value in _ROOTS or value in _CHARACTERISTICS) if is_of_owl else not is_part
            elif predicate in _KEYWORDS:
                is_meant = subject not in annotations
            elif predicate in _OF_EXPRESSIONS:
                is_meant = not is_part
            else:
                is_free = not (is_part or self._is_part(value) or predicate in annotations)
                is_meant = is_free and not predicate.startswith(_BUILT_IN)
            if is_meant:
                yield subject, predicate, value

    def _named(self, term: str) -> str:
        return f"<{ANONYMOUS}{term[3:]}>" if term in self._individuals else term

    def _structure(self, term: str, inside: tuple[str, ...] = ()) -> object:
        """Return a value for a blank node, equal for nodes with equal triples: such nodes are read as one axiom."""
        if not term.startswith("_:") or term in inside or term not in self._of or term in self._individuals:
            return term
        return frozenset((p, self._structure(o, (*inside, term))) for p, o in self._of[term])

    def _write_disjointness_as_axioms(self) -> None:
        for subject, predicate, value in list(self._triples):
            if predicate == _TYPE and value in _DISJOINT:
                members = self._list(next((o for p, o in self._of[subject] if p == f"<{OWL}members>"), ""))
                data = any((_TYPE, f"<{OWL}DatatypeProperty>") in self._of[member] for member in members)
                keyword = "DisjointDataProperties" if data else _DISJOINT[value]
                if all(member.startswith("<") for member in members):
                    self.axioms.append(f"{keyword}({' '.join(sorted(members))})")
                else:
                    pairs = [(one, other) for i, one in enumerate(members) for other in members[i + 1 :]]
                    self._triples += [(one, f"<{OWL}disjointWith>", other) for one, other in pairs]

    def _list(self, head: str) -> list[str]:
        members: list[str] = []
        seen: set[str] = set()
        while head in self._of and head not in seen:
            seen.add(head)
            pairs = dict(self._of[head])
            members.append(pairs.get(f"<{RDF}first>", ""))
            head = pairs.get(f"<{RDF}rest>", "")
        return list(filter(None, members))

    def _give_expressions_a_type(self) -> None:
        for number, (subject, predicate, value) in enumerate(list(self._triples)):
            types = [value for predicate, value in self._of[subject] if predicate == _TYPE]
            if predicate == f"<{OWL}onProperty>" and f"<{OWL}Restriction>" not in types:
                self._triples.append((subject, _TYPE, f"<{OWL}Restriction>"))
            elif predicate in _EXPRESSIONS and subject.startswith("<"):
                node, kind = f"_:e{number}", f"<{RDFS}Datatype>"
                self._triples[number] = (node, predicate, value)
                self._triples.append((subject, f"<{OWL}equivalentClass>", node))
                self._triples.append((node, _TYPE, kind if kind in types else f"<{OWL}Class>"))
            elif predicate in _EXPRESSIONS and not types:
                self._triples.append((subject, _TYPE, f"<{OWL}Class>"))

    def _anonymous_individuals(self) -> set[str]:
        """The blank nodes that are not part of an axiom's or expression's own structure."""
        blank = {term for s, _, o in self._triples for term in (s, o) if term.startswith("_:")}
        for subject, predicate, value in self._triples:
            said = value if predicate == _TYPE else predicate
            if said.startswith(_BUILT_IN) and said not in _ABOUT_INDIVIDUALS:
                blank.discard(subject)
            if predicate.startswith(_BUILT_IN) and predicate not in _ABOUT_INDIVIDUALS:
                blank.discard(value)
        return blank


def ontology_iri(text: str, syntax: str, base: str) -> str | None:
    """Return the IRI of an RDF document's ontology, or None; reading ends there. Raises SyntaxError."""
    meant = (_TYPE, f"<{OWL}Ontology>")
    own = (quad.subject for quad in _quads(text, syntax, base) if (str(quad.predicate), str(quad.object)) == meant)
    found = next(own, None)
    return None if found is None else str(found).strip("<>")


def _quads(text: str, syntax: str, base: str) -> Iterator[Quad]:
    from pyoxigraph import RdfFormat, parse

    form = {"ttl": RdfFormat.TURTLE, "rdf": RdfFormat.RDF_XML, "jsonld": RdfFormat.JSON_LD}[syntax]
    whole = _with_types_as_names(text) if syntax == "jsonld" else text
    return parse(input=whole.encode(), format=form, base_iri=base)


def _with_types_as_names(text: str) -> str:
    """JSON-LD whose types are names: rdflib also writes nodes there, which become values of `rdf:type`."""
    try:
        data = json.loads(text)
    except ValueError:
        return text
    waiting, is_changed = [data], False
    while waiting:
        node = waiting.pop()
        if isinstance(node, dict):
            types = node["@type"] if isinstance(node.get("@type"), list) else [node.get("@type")]
            nodes = [each for each in types if isinstance(each, dict)]
            if nodes:
                is_changed = True
                node["@type"] = [each for each in types if isinstance(each, str)]
                node[f"{RDF}type"] = nodes
        waiting += node.values() if isinstance(node, dict) else node if isinstance(node, list) else ()
    return json.dumps(data) if is_changed else text


def restored(axiom: str) -> str | None:
    """An axiom as the document says it, with anonymous inverse properties; None for what only declares one."""
    if _INVERSE not in axiom:
        return axiom
    return None if axiom.startswith("Declaration(") else _INVERSE_IRI.sub(r"ObjectInverseOf(<\1>)", axiom)


def _axiom_of(subject: str, predicate: str, value: str) -> tuple[tuple[str, ...], str, str]:
    """The keywords that the axiom of a triple may have, a name that stands first or last in it, and its arguments."""
    name = "" if subject.startswith("_:") else subject
    if predicate in _KEYWORDS:
        return _KEYWORDS[predicate], name, f"{subject} {value}"
    if predicate in _OF_EXPRESSIONS:
        return _NO_AXIOM, name, ""
    if predicate != _TYPE:
        return _ASSERTIONS, predicate, f"{predicate} {subject} {value}"
    if value in _ROOTS:
        return _ROOTS[value], "", ""
    if value in _CHARACTERISTICS:
        return _CHARACTERISTICS[value], name, subject
    return ("ClassAssertion",), name, f"{value} {subject}"
