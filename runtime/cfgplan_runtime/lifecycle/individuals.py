"""Individuals that come and go at run-time, as axioms of the ontology."""

from __future__ import annotations

from collections.abc import Collection, Iterable

from cfgplan.errors import Fault, InputError
from cfgplan.matching import Ontology, UnknownNameError
from cfgplan_runtime.lifecycle.changes import Individual


def with_individuals(ontology: Ontology, come: Iterable[Individual], gone: Collection[str]) -> Ontology:
    """Add the individuals `come` to an ontology, and remove those named in `gone` with every axiom about them.

    Raises InputError for a name that the ontology does not know, and for an environment without an ontology.
    """
    come = tuple(come)
    if not come and not gone:
        return ontology
    if ontology.is_open:
        mend = "name an ontology in the environment file by `ontology:`"
        raise InputError.of("without an ontology there are no individuals", mend=mend)
    without = {f"<{iri}>" for name in gone if (iri := ontology.individual_names.find(name)) is not None}
    kept = {axiom for axiom in ontology.axioms if not any(iri in axiom for iri in without)}
    iris = {one.name: _own_iri(one, ontology) for one in come}
    faults: list[Fault] = []
    for one in come:
        try:
            kept.update(_axioms(one, iris, ontology))
        except UnknownNameError as error:
            faults.append(Fault(f"individual {one.name}: {error.message}", mend=error.mend))
    if faults:
        raise InputError(faults)
    return Ontology(kept, ontology.prefixes, files=ontology.files, dropped=ontology.dropped, ignored=ontology.ignored)


def _axioms(one: Individual, iris: dict[str, str], ontology: Ontology) -> Iterable[str]:
    me = iris[one.name]
    yield f"Declaration(NamedIndividual(<{me}>))"
    for name in one.classes:
        yield f"ClassAssertion(<{_iri(name, 'class', ontology)}> <{me}>)"
    for role, other in one.relations:
        whom = iris.get(other) or _iri(other, "individual", ontology)
        yield f"ObjectPropertyAssertion(<{_iri(role, 'property', ontology)}> <{me}> <{whom}>)"


def _iri(name: str, kind: str, ontology: Ontology) -> str:
    names = {"class": ontology.class_names, "property": ontology.property_names}.get(kind, ontology.individual_names)
    found = ontology.find(name, [names])
    assert found is not None  # the ontology is not open
    return found[1]


def _own_iri(one: Individual, ontology: Ontology) -> str:
    """The IRI of an individual: a known one, the one that its name spells, or one in its first class's namespace."""
    try:
        known = ontology.individual_names.find(one.name)
        if known is not None:
            return known
        if ":" in one.name or one.name.startswith("<"):
            return ontology.free_iri(one.name)
        beside = _iri(one.classes[0], "class", ontology) if one.classes else next(iter(ontology.prefixes.values()), ":")
    except UnknownNameError as error:
        raise InputError([Fault(f"individual {one.name}: {error.message}", mend=error.mend)]) from None
    return beside[: max(beside.rfind("#"), beside.rfind("/")) + 1] + one.name
