"""The reasoners to choose from, and questions to the reference reasoner: subsumption of tags, and satisfiability.

It also writes the ontology's document for the reasoner. Names are written in ASCII, tags as classes `t:N`, so that the
answer can't be garbled by a locale.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from itertools import islice
from types import MappingProxyType
from typing import Final, Protocol

from cfgplan.errors import UnknownNameError, did_you_mean
from cfgplan.matching.concepts import NOTHING_IRI, THING_IRI, Concept, in_functional_syntax
from cfgplan.matching.faults import ReasonerError
from cfgplan.matching.functional import signature_of
from cfgplan.matching.ontology import Ontology
from cfgplan.onward import reached


class Reference(Protocol):
    """A reasoner that reads a document in functional syntax, such as the module `hermit`."""

    def classify(self, document: str, *, time_limit_s: float | None = None) -> Sequence[tuple[str, str]]:
        """Pairs of a class and one above it, from which all others follow. Raises ReasonerError, ReasonerTimeoutError
        where time is over.
        """
        ...

    def satisfiable(
        self,
        document: str,
        classes: Sequence[str],
        *,
        time_limit_s: float | None = None,
        patience_s: float | None = None,
    ) -> dict[str, bool]:
        """Whether each class can have members, until an answer takes longer than the patience. Raises ReasonerError."""
        ...

    def satisfiable_in_each(
        self, documents: Sequence[str], name: str, *, time_limit_s: float | None = None
    ) -> tuple[list[bool], ReasonerError | None]:
        """Return whether a class is satisfiable in each document, at least up to the first "no". If a document is
        refused, the answers end before it, and the error is returned with them.
        """
        ...


REASONERS: Final[Mapping[str, str]] = MappingProxyType(
    {
        "auto": "the fast engine, finite models for what it can't certify, and HermiT for what is open then",
        "el": "the fast engine and finite models alone; what they can't certify is unknown",
        "hermit": "HermiT for everything",
    }
)
"""The reasoners that `match` accepts, each with a description."""


def reference_named(reasoner: str) -> tuple[str, Reference | None]:
    """The reference that a reasoner of REASONERS asks, with its name; None for one that asks none.

    Raises UnknownNameError.
    """
    from cfgplan.matching import hermit

    if reasoner not in REASONERS:
        mend = did_you_mean(reasoner, REASONERS, f"choose one of {', '.join(REASONERS)}")
        raise UnknownNameError(f"there is no reasoner {reasoner!r}", mend)
    if reasoner == "el":
        return "el", None
    return "hermit", hermit


FIRST_DOCUMENTS, MOST_DOCUMENTS = 8, 128
"""The numbers of ontologies in the first and in the largest call. Java starts in the time of about 20 of them."""
_NON_ASCII: Final = re.compile(r"[^\x00-\x7f]")


def classify(
    reference: Reference,
    ontology: Ontology,
    offered: Collection[Concept],
    demanded: Collection[Concept],
    time_limit_s: float | None,
) -> tuple[frozenset[Concept], dict[Concept, frozenset[Concept]]]:
    """Ask a reasoner which of `offered` are unsatisfiable, and for each of `demanded` which other concepts are below
    it.

    Raises what the reasoner raises.
    """
    number = {concept: index for index, concept in enumerate(dict.fromkeys((*offered, *demanded)))}
    document = _document(ontology, number, offered, demanded)
    above: defaultdict[str, set[str]] = defaultdict(set)
    for lower, upper in reference.classify(document, time_limit_s=time_limit_s):
        above[lower].add(upper)
    classes = {concept: {*reached((THING_IRI, _tag_iri(number[concept])), above.__getitem__)} for concept in offered}
    impossible = frozenset(concept for concept in offered if NOTHING_IRI in classes[concept])
    possible = [concept for concept in offered if concept not in impossible]
    return impossible, {
        wanted: frozenset(concept for concept in possible if _tag_iri(number[wanted]) in classes[concept])
        for wanted in demanded
    }


def satisfiable(
    reference: Reference,
    ontology: Ontology,
    concepts: Collection[Concept],
    time_limit_s: float | None,
    patience_s: float | None = None,
) -> dict[Concept, bool]:
    """Ask whether each of `concepts` is satisfiable, in this order; those not answered in time are missing.

    Raises what the reasoner raises.
    """
    number = {concept: index for index, concept in enumerate(dict.fromkeys(concepts))}
    document = _document(ontology, number, number, ())
    names = [*map(_tag_iri, number.values())]
    told = reference.satisfiable(document, names, time_limit_s=time_limit_s, patience_s=patience_s)
    return {concept: told[name] for concept, index in number.items() if (name := _tag_iri(index)) in told}


def first_answered(
    reference: Reference,
    ontologies: Iterable[Ontology],
    concept: Concept,
    left_s: Callable[[], float | None],
    is_sought: Callable[[bool | ReasonerError], bool],
) -> int | None:
    """Return the index of the first ontology with a sought answer: whether a concept is satisfiable, or the error.
    None if there is none, if time runs out, or if the reasoner answers nothing in its time.

    Each call asks about several ontologies, and the next call about four times as many, up to MOST_DOCUMENTS. Raises
    ReasonerError if the reasoner can't be started.
    """
    documents = (_document(ontology, {concept: 0}, [concept], ()) for ontology in ontologies)
    waiting: list[str] = []
    size, place = FIRST_DOCUMENTS, 0
    while True:
        waiting += islice(documents, size - len(waiting))
        time_limit_s = left_s()
        if not waiting or (time_limit_s is not None and time_limit_s <= 0):
            return None
        answers, error = reference.satisfiable_in_each(waiting, _tag_iri(0), time_limit_s=time_limit_s)
        told: list[bool | ReasonerError] = [*answers, *([] if error is None else [error])]
        for answer in told:
            if is_sought(answer):
                return place
            place += 1
        if not told:
            return None
        del waiting[: len(told)]
        size = min(4 * size, MOST_DOCUMENTS)


def _document(
    ontology: Ontology, number: Mapping[Concept, int], offered: Iterable[Concept], demanded: Iterable[Concept]
) -> str:
    """The ontology, and a class for each concept: below it if it is offered, above it if it is demanded.

    One class is below another exactly if the concepts are, and it makes no question about others harder.
    """
    iri = {concept: f"<{_tag_iri(index)}>" for concept, index in number.items()}
    tags = [f"SubClassOf({iri[concept]} {in_functional_syntax(concept)})" for concept in dict.fromkeys(offered)]
    tags += [f"SubClassOf({in_functional_syntax(concept)} {iri[concept]})" for concept in dict.fromkeys(demanded)]
    trees = [*ontology.trees.values()]
    signature = signature_of(trees)
    declared = [
        *(f"Declaration(Class(<{iri}>))" for iri in sorted(signature.classes)),
        *(f"Declaration(ObjectProperty(<{iri}>))" for iri in sorted(signature.roles)),
        *(f"Declaration(NamedIndividual(<{iri}>))" for iri in sorted(signature.individuals)),
        *(f"Declaration(Class(<{_tag_iri(index)}>))" for index in number.values()),
    ]
    axioms = [axiom for axiom in sorted(ontology.told) if not axiom.startswith("Declaration(")]
    lines = ["Ontology(<t:ontology>", *declared, *axioms, *tags, ")", ""]
    return _NON_ASCII.sub(lambda found: f"_u{ord(found.group()):x}_", "\n".join(lines))


def _tag_iri(number: int) -> str:
    return f"t:{number}"
