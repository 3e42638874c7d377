"""Which individuals belong to a class, asserted or inferred: what templates range over."""

from __future__ import annotations

from cfgplan.canonical import normal
from cfgplan.matching.faults import ReasonerTimeoutError, UnknownNameError
from cfgplan.matching.matrix import match
from cfgplan.matching.ontology import Ontology
from cfgplan.matching.syntax import parse_tag


def instances(
    ontology: Ontology, class_or_tag: str, *, reasoner: str = "auto", time_limit_s: float | None = None
) -> tuple[str, ...]:
    """The names of the individuals that belong to a class or tag, asserted or inferred, sorted.

    Raises UnknownNameError for a name that is no class, TagError for a tag that can't be read, InputError for
    an ontology that can't be reasoned with, ReasonerTimeoutError where the time did not suffice.
    """
    name = normal(class_or_tag.strip())
    if name in ontology.individuals and name not in ontology.classes:
        raise UnknownNameError(f"{name!r} is an individual, but a class is wanted here")
    parse_tag(name, ontology)
    tags = {f"{{{individual}}}": individual for individual in ontology.individuals}
    found = match(tags, [name], ontology, reasoner=reasoner, time_limit_s=time_limit_s)
    if found.similarity.open:
        message = f"it could not be decided in {time_limit_s} s which individuals belong to {name!r}"
        raise ReasonerTimeoutError(message, "simplify the ontology, or name the individuals")
    return tuple(sorted(tags[tag] for tag in found.similarity.offers[name]))
