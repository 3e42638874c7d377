"""Which individuals belong to a class, asserted or inferred: what templates range over."""

from __future__ import annotations

from cfgplan.matching.faults import UnknownNameError
from cfgplan.matching.matrix import match
from cfgplan.matching.ontology import Ontology
from cfgplan.matching.syntax import parse_tag


def instances(
    ontology: Ontology, class_or_tag: str, *, reasoner: str = "auto", time_limit_s: float | None = None
) -> tuple[str, ...]:
    """The names of the individuals that belong to a class or tag, asserted or inferred, sorted.

    Raises UnknownNameError for a name that is no class, TagError for a tag that can't be read, InputError for
    an ontology that can't be reasoned with.
    """
    name = class_or_tag.strip()
    if name in ontology.individuals and name not in ontology.classes:
        raise UnknownNameError(f"{name!r} is an individual, but a class is wanted here")
    parse_tag(name, ontology)
    tags = {f"{{{individual}}}": individual for individual in ontology.individuals}
    found = match(tags, [name], ontology, reasoner=reasoner, time_limit_s=time_limit_s)
    return tuple(sorted(tags[tag] for tag in found.similarity.offers[name]))
