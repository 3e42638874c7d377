"""A first ontology for an environment without one: a hierarchy of the names in its tags, guessed from their words."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Final

from cfgplan.matching.concepts import NOTHING_IRI, THING_IRI, AtLeast, AtMost, Concept, Named, Nominal, Only, Some, walk
from cfgplan.matching.names import short_name
from cfgplan.matching.ontology import Ontology
from cfgplan.matching.suggestions import words_of
from cfgplan.matching.syntax import parse_tag
from cfgplan.turtle import heading

_NAMES_IRI: Final = "urn:cfgplan:names#"
_INDIVIDUAL: Final = re.compile(r"\{\s*([^{}]+?)\s*\}|\bvalue\s+([^\s()]+)")
_NO_IRI: Final = frozenset('<>"{}|^`\\ ')


def taxonomy(tags: Iterable[str]) -> tuple[str, tuple[str, ...]]:
    """An ontology (Turtle) of the names in tags of an open ontology, and the names that no IRI can end in.

    A class whose name ends in the words of another's (`YUVImage`, `Image`) is put below it: a guess, which the text
    calls one.
    """
    opened, tags = Ontology(is_open=True), [*tags]
    names, roles = _names(parse_tag(tag, opened) for tag in tags)
    individuals = names & {name for tag in tags for pair in _INDIVIDUAL.findall(tag) for name in pair}
    classes = names - individuals
    left_out = sorted(name for name in {*classes, *roles, *individuals} if _local(name) is None)
    kinds = ((classes, "owl:Class"), (roles, "owl:ObjectProperty"), (individuals, "owl:NamedIndividual"))
    above = _above(classes)
    lines = [
        *heading(_NAMES_IRI),
        "# An output feeds an input if its tag is the input's or below it. Each rdfs:subClassOf is guessed from names:",
        "# look at them, and add your own.",
    ]
    for names, kind in kinds:
        lines += [""] if names else []
        for name in sorted(names):
            local = _local(name)
            if local is not None:
                uppers = "".join(f" ; rdfs:subClassOf <{_NAMES_IRI}{_local(each)}>" for each in above.get(name, ()))
                lines.append(f"<{_NAMES_IRI}{local}> a {kind}{uppers if kind == 'owl:Class' else ''} .")
    return "\n".join([*lines, ""]), tuple(left_out)


def _names(concepts: Iterable[Concept]) -> tuple[set[str], set[str]]:
    """The names of concepts, and the properties."""
    names: set[str] = set()
    roles: set[str] = set()
    for part in (part for concept in concepts for part in walk(concept)):
        match part:
            case Named(iri) | Nominal(iri):
                names.add(iri)
            case Some(role, _) | Only(role, _) | AtLeast(_, role, _) | AtMost(_, role, _):
                roles.add(role)
    return names - {THING_IRI, NOTHING_IRI}, roles


def _local(name: str) -> str | None:
    """The end of a name's IRI, which tags write as the name; None if there is none."""
    return name if short_name(_NAMES_IRI + name) == name and _NO_IRI.isdisjoint(name) else None


def _above(classes: Iterable[str]) -> Mapping[str, Sequence[str]]:
    """The nearest classes whose words are the last ones of a class's name."""
    words = {name: words_of(name) for name in classes}

    def ends_in(name: str) -> Iterator[str]:
        own = words[name]
        for other, last in words.items():
            if last and len(last) < len(own) and own[-len(last) :] == last:
                yield other

    found = {name: sorted(ends_in(name), key=lambda other: (-len(words[other]), other)) for name in words}
    return {
        name: [other for other in above if len(words[other]) == len(words[above[0]])] for name, above in found.items()
    }
