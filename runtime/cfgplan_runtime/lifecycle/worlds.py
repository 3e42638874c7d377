"""The world of the file, with the requested changes of targets, transformations and individuals."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from decimal import Decimal
from functools import cached_property
from pathlib import Path
from typing import Any, Generic, TypeVar

from cfgplan import api
from cfgplan.api import World
from cfgplan.domain import Environment, Target, Transformation
from cfgplan.errors import Fault, InputError, InvalidValueError, did_you_mean
from cfgplan.formats.document import Document, read_declared, read_document
from cfgplan.formats.fields import FORMAT, EnvironmentPart
from cfgplan.matching import Ontology, TagError, UnknownNameError, check_tag
from cfgplan.summary import some
from cfgplan_runtime.lifecycle import changes

T = TypeVar("T")


@dataclass(frozen=True)
class Requested(Generic[T]):
    """The requested changes of one kind of part: added values and removed ones, by label. Immutable."""

    added: Mapping[str, T] = field(default_factory=dict)
    removed: frozenset[str] = frozenset()

    def adding(self, values: Mapping[str, T]) -> Requested[T]:
        return Requested({**self.added, **values}, self.removed.difference(values))

    def removing(self, labels: Iterable[str]) -> Requested[T]:
        return Requested(_without(self.added, labels), self.removed.union(labels))

    def restoring(self, labels: Iterable[str]) -> Requested[T]:
        return Requested(self.added, self.removed.difference(labels))

    def forgetting(self, labels: Iterable[str]) -> Requested[T]:
        return Requested(_without(self.added, labels), self.removed.difference(labels))

    def on(self, base: Mapping[str, T]) -> tuple[T, ...]:
        """The values of the base with all that was requested."""
        return tuple({**_without(base, self.removed), **self.added}.values())


@dataclass(frozen=True)
class WorldVersion:
    """A world and the changes requested since. Immutable: `after` returns the next one.

    The latest change of a label holds: an added value replaces that of the base, and a removed label stays away, both
    until the base changes that label.
    """

    base: World
    targets: Requested[Target] = Requested()
    transformations: Requested[Transformation] = Requested()
    individuals: Requested[changes.Individual] = Requested()
    declared: Mapping[str, changes.Declare] = field(default_factory=dict)
    refuses_hosts: bool = False

    def after(self, change: changes.WorldChange) -> WorldVersion:
        """The world after a change. Raises InputError if the change, or the world after it, is bad."""
        changed = self._changed(change)
        _ = changed.world  # it is made now, and is bad or not
        return changed

    @property
    def removed(self) -> tuple[str, ...]:
        """Labels and names that were removed on request and would otherwise be there."""
        _, said = self._said
        gone = self.targets.removed & said.target.keys() | self.transformations.removed & said.transformation.keys()
        return tuple(sorted(gone | self.individuals.removed))

    @cached_property
    def world(self) -> World:
        """The base with all changes. Raises InputError."""
        ontology, environment = self._said
        library, targets = self.transformations.on(environment.transformation), self.targets.on(environment.target)
        _check_tags(self.transformations.added.values(), self.targets.added.values(), ontology)
        try:
            environment = replace(environment, units=(), library=library, targets=targets)
        except InvalidValueError as error:
            raise InputError.of(str(error)) from None
        if self.refuses_hosts:
            refuse_hosts(self.base)
        return World(environment, ontology, self.base.horizon_s, self.base.max_cost_us, survive=self.base.survive)

    @cached_property
    def may_be_silent(self) -> bool:
        """Whether some target limits for how long its topic may be silent."""
        return any(target.silent_us is not None for target in self.world.environment.targets)

    @cached_property
    def _said(self) -> tuple[Ontology, Environment]:
        """The ontology, and the environment of base and declarations without other requests. Raises InputError."""
        declared = [one for each in self.declared.values() for one in each.individuals]
        gone = self.individuals.removed
        come = [*self.individuals.added.values(), *(one for one in declared if one.name not in gone)]
        ontology = with_individuals(self.base.ontology, come, gone)
        if self.declared or ontology is not self.base.ontology:
            return ontology, self._rebuilt(ontology)
        return ontology, self.base.environment

    @cached_property
    def _document(self) -> Document | None:
        """The files that the base was read from, as they are now."""
        return None if self.base.file is None else read_document(self.base.file.path)

    def _rebuilt(self, ontology: Ontology) -> Environment:
        """The base's environment with templates expanded by another ontology, and with the declarations."""
        parts = [read_declared(f"declared by {name}", _exact(one.document)) for name, one in self.declared.items()]
        files, faults = [file for file, _ in parts], [fault for _, more in parts for fault in more]
        document = self._document
        if document is not None:
            whole = replace(document, files=(*document.files, *files), faults=(*document.faults, *faults))
            return api.world_of(whole, ontology).environment
        base = self.base.environment
        if not parts:
            return base
        alone = Document(Path(), EnvironmentPart(format=FORMAT), tuple(files), tuple(faults))
        more = api.world_of(alone, ontology).environment
        try:
            library, targets = (*base.library, *more.library), (*base.targets, *more.targets)
            return replace(base, units=(), library=library, targets=targets)
        except InvalidValueError as error:
            raise InputError.of(str(error), mend="give each a name of its own") from None

    def _changed(self, change: changes.WorldChange) -> WorldVersion:
        world = self.world.environment
        match change:
            case changes.Add(targets, transformations, individuals):
                return replace(
                    self,
                    targets=self.targets.adding({each.label: each for each in targets}),
                    transformations=self.transformations.adding({each.label: each for each in transformations}),
                    individuals=self.individuals.adding({each.name: each for each in individuals}),
                )
            case changes.Remove(labels, of_library, names):
                _check_known("target", labels, world.target)
                _check_known("transformation", of_library, world.transformation)
                _check_known("individual", names, self.world.ontology.individuals)
                declared = {one.name for each in self.declared.values() for one in each.individuals}
                only_added = set(names) - declared - set(self.base.ontology.individuals)
                return replace(
                    self,
                    targets=self.targets.removing(labels),
                    transformations=self.transformations.removing(of_library),
                    individuals=self.individuals.removing(names).restoring(only_added),
                )
            case changes.Declare(name):
                return self._declaring(name, change)
            case changes.Withdraw(name):
                _check_known("addition", [name], self.declared)
                return replace(self, declared=_without(self.declared, [name]))
            case changes.Restore(names):
                _check_known("removed name", names, dict.fromkeys(self.removed))
                return self._restoring(names, names, names)
            case changes.ReplaceWorld(base):
                old, new = self.base.environment, base.environment
                return replace(
                    self,
                    base=base,
                    targets=self.targets.forgetting(_told(old.target, new.target)),
                    transformations=self.transformations.forgetting(_told(old.transformation, new.transformation)),
                    individuals=self.individuals.restoring(self.individuals.removed - set(base.ontology.individuals)),
                )

    def _restoring(
        self, targets: Iterable[str], transformations: Iterable[str], individuals: Iterable[str]
    ) -> WorldVersion:
        return replace(
            self,
            targets=self.targets.restoring(targets),
            transformations=self.transformations.restoring(transformations),
            individuals=self.individuals.restoring(individuals),
        )

    def _declaring(self, name: str, change: changes.Declare) -> WorldVersion:
        """Add a declaration. Its declarations come back, even after a request has removed them."""
        declared = replace(self, declared={**self.declared, name: change})
        after = declared._restoring((), (), [one.name for one in change.individuals])
        if not (self.targets.removed or self.transformations.removed):
            return after
        (_, said), (_, besides) = after._said, replace(after, declared=_without(after.declared, [name]))._said
        new, of_library = said.target.keys() - besides.target.keys(), said.transformation.keys()
        return after._restoring(new, of_library - besides.transformation.keys(), ())


def refuse_hosts(world: World) -> None:
    """Raise InputError if a world has hosts: for a run whose units are all processes of this computer."""
    hosts = ", ".join(world.environment.host)
    if hosts:
        message = f"this run is on one computer, and can't place units on hosts ({hosts})"
        mend = "add --local to try all hosts on this computer, or --connect to reach their agents"
        raise InputError.of(message, file=str(world.file.path) if world.file else None, mend=mend)


def _told(old: Mapping[str, object], new: Mapping[str, object]) -> set[str]:
    """The labels whose values differ between the old base and the new one."""
    return {label for label in {*old, *new} if old.get(label) != new.get(label)}


def _without(known: Mapping[str, T], names: Iterable[str]) -> Mapping[str, T]:
    gone = set(names)
    return {name: value for name, value in known.items() if name not in gone}


def _choice(names: Mapping[str, object]) -> str:
    return f"choose one of {some(sorted(names), 8)}" if names else "the run has none"


def _check_known(what: str, names: Iterable[str], known: Mapping[str, object]) -> None:
    faults = [
        Fault(f"there is no {what} {name!r}", mend=did_you_mean(name, known.keys(), _choice(known)))
        for name in names
        if name not in known
    ]
    if faults:
        raise InputError(faults)


def _check_tags(transformations: Iterable[Transformation], targets: Iterable[Target], ontology: Ontology) -> None:
    faults: list[Fault] = []
    tagged = [(f"target {target.label!r}", target.tag) for target in targets if target.run is None]
    for transformation in transformations:
        of = f"of transformation {transformation.label!r}"
        tagged += [(f"input {port.name} {of}", port.tag) for port in transformation.inputs]
        tagged += [(f"output {port.name} {of}", port.tag) for port in transformation.outputs]
    for who, tag in tagged:
        try:
            check_tag(tag, ontology)
        except TagError as error:
            faults.append(Fault(f"the tag {tag!r} of {who}: {error.message}", column=error.column, mend=error.mend))
    if faults:
        raise InputError(faults)


def _exact(value: Any) -> Any:
    """Plain values with each float replaced by the Decimal that a YAML file's text would give."""
    if isinstance(value, float):
        return Decimal(repr(value))
    if isinstance(value, Mapping):
        return {key: _exact(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_exact(item) for item in value]
    return value


def with_individuals(ontology: Ontology, come: Iterable[changes.Individual], gone: Collection[str]) -> Ontology:
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
    return ontology.with_axioms(kept)


def _axioms(one: changes.Individual, iris: dict[str, str], ontology: Ontology) -> Iterable[str]:
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


def _own_iri(one: changes.Individual, ontology: Ontology) -> str:
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
