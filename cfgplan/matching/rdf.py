"""RDF documents as N-Triples that py-horned-owl reads without a loss.

Of a valid ontology it would silently drop disjointness of several classes or properties, anonymous individuals, class
expressions without a type, and names that are defined without `owl:equivalentClass` (as OWL 1 allowed). So these are
written in another way first.
"""

from __future__ import annotations

from collections import defaultdict
from typing import Final

OWL: Final = "http://www.w3.org/2002/07/owl#"
RDF: Final = "http://www.w3.org/1999/02/22-rdf-syntax-ns#"
ANONYMOUS: Final = "urn:cfgplan:anonymous:"
"""Stands before the number of an anonymous individual."""

_TYPE: Final = f"<{RDF}type>"
_BUILT_IN: Final = (f"<{OWL}", f"<{RDF}", "<http://www.w3.org/2000/01/rdf-schema#")
_ABOUT_INDIVIDUALS: Final = frozenset(
    f"<{OWL}{name}>"
    for name in ("sameAs", "differentFrom", "sourceIndividual", "targetIndividual", "Thing", "NamedIndividual")
)
_EXPRESSIONS: Final = tuple(f"<{OWL}{name}>" for name in ("unionOf", "intersectionOf", "complementOf", "oneOf"))
_DISJOINT: Final = {
    f"<{OWL}AllDisjointClasses>": "DisjointClasses",
    f"<{OWL}AllDisjointProperties>": "DisjointObjectProperties",
}


class Graph:
    """The triples of a document, terms in N-Triples; blank nodes are numbered in order of appearance."""

    def __init__(self, text: str, syntax: str, base: str) -> None:
        """Read Turtle ("ttl") or RDF/XML ("rdf"). Raises SyntaxError with line and column."""
        import pyoxigraph

        form = pyoxigraph.RdfFormat.RDF_XML if syntax == "rdf" else pyoxigraph.RdfFormat.TURTLE
        numbers: dict[str, str] = {}

        def term(value: object) -> str:
            written = str(value)
            return numbers.setdefault(written, f"_:b{len(numbers)}") if written.startswith("_:") else written

        self._triples: list[tuple[str, str, str]] = [
            (term(quad.subject), term(quad.predicate), term(quad.object))
            for quad in pyoxigraph.parse(input=text.encode(), format=form, base_iri=base)
        ]
        self.axioms: list[str] = []
        self._of: defaultdict[str, list[tuple[str, str]]] = defaultdict(list)
        for subject, predicate, value in self._triples:
            self._of[subject].append((predicate, value))

    def lossless(self) -> str:
        """The document in N-Triples; what has no triples that survive is in `axioms`, in functional syntax."""
        self._write_disjointness_as_axioms()
        self._give_expressions_a_type()
        individuals = self._anonymous_individuals()

        def named(term: str) -> str:
            return f"<{ANONYMOUS}{term[3:]}>" if term in individuals else term

        return "".join(f"{named(s)} {p} {named(o)} .\n" for s, p, o in self._triples)

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
                node = f"_:e{number}"
                self._triples[number] = (node, predicate, value)
                self._triples.append((subject, f"<{OWL}equivalentClass>", node))
                self._triples.append((node, _TYPE, f"<{OWL}Class>"))
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
