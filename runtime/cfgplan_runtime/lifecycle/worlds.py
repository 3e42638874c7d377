"""The world as its file says it, with what was asked for since: targets, transformations, individuals."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from decimal import Decimal
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

from cfgplan import api
from cfgplan.api import World
from cfgplan.domain import Environment, Target, Transformation
from cfgplan.errors import Fault, InputError, InvalidValueError
from cfgplan.formats import Document, read_declared, read_document
from cfgplan.formats.fields import FORMAT, EnvironmentPart
from cfgplan.matching import Ontology, TagError, check_tag
from cfgplan_runtime.lifecycle.changes import (
    AddIndividuals,
    AddTargets,
    AddTransformations,
    Declare,
    Individual,
    RemoveIndividuals,
    RemoveTargets,
    RemoveTransformations,
    ReplaceWorld,
    Restore,
    Withdraw,
    WorldChange,
)
from cfgplan_runtime.lifecycle.individuals import with_individuals

T = TypeVar("T")


@dataclass(frozen=True)
class LivingWorld:
    """A world and the changes requested since. Immutable: `after` returns the next one.

    The latest word on a label holds: an added value replaces that of the base, a removed label stays away, both until
    the base says something else of that label.
    """

    base: World
    targets: Mapping[str, Target] = field(default_factory=dict)
    transformations: Mapping[str, Transformation] = field(default_factory=dict)
    individuals: Mapping[str, Individual] = field(default_factory=dict)
    declared: Mapping[str, Declare] = field(default_factory=dict)
    without_targets: frozenset[str] = frozenset()
    without_transformations: frozenset[str] = frozenset()
    without_individuals: frozenset[str] = frozenset()
    refuses_hosts: bool = False

    def after(self, change: WorldChange) -> LivingWorld:
        """The world after a change. Raises InputError if the change, or the world after it, is bad."""
        changed = self._changed(change)
        _ = changed.world  # it is made now, and is bad or not
        return changed

    @property
    def removed(self) -> tuple[str, ...]:
        """Labels and names that were removed on request and would otherwise be there."""
        _, said = self._said
        gone = self.without_targets & said.target.keys() | self.without_transformations & said.transformation.keys()
        return tuple(sorted(gone | self.without_individuals))

    @cached_property
    def world(self) -> World:
        """The base with all changes. Raises InputError."""
        ontology, environment = self._said
        library = _changed(
            {t.label: t for t in environment.library}, self.transformations, self.without_transformations
        )
        targets = _changed({t.label: t for t in environment.targets}, self.targets, self.without_targets)
        _check_tags(self.transformations.values(), self.targets.values(), ontology)
        try:
            environment = replace(
                environment, units=(), library=tuple(library.values()), targets=tuple(targets.values())
            )
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
        come = [*self.individuals.values(), *(one for one in declared if one.name not in self.without_individuals)]
        ontology = with_individuals(self.base.ontology, come, self.without_individuals)
        if self.declared or ontology is not self.base.ontology:
            return ontology, self._rebuilt(ontology)
        return ontology, self.base.environment

    @cached_property
    def _document(self) -> Document | None:
        """The files that the base was read from, as they are now."""
        return None if self.base.file is None else read_document(self.base.file.path)

    def _rebuilt(self, ontology: Ontology) -> Environment:
        """The base's environment with templates expanded by another ontology, and with what was declared."""
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

    def _changed(self, change: WorldChange) -> LivingWorld:
        world = self.world.environment
        match change:
            case AddTargets(targets):
                more = {**self.targets, **{target.label: target for target in targets}}
                return replace(self, targets=more, without_targets=self.without_targets - set(more))
            case RemoveTargets(labels):
                _check_known("target", labels, world.target)
                gone = self.without_targets | set(labels)
                return replace(self, targets=_without(self.targets, labels), without_targets=gone)
            case AddTransformations(transformations):
                made = {**self.transformations, **{t.label: t for t in transformations}}
                gone = self.without_transformations - set(made)
                return replace(self, transformations=made, without_transformations=gone)
            case RemoveTransformations(labels):
                _check_known("transformation", labels, world.transformation)
                left = _without(self.transformations, labels)
                return replace(
                    self, transformations=left, without_transformations=self.without_transformations | set(labels)
                )
            case AddIndividuals(individuals):
                come = {**self.individuals, **{one.name: one for one in individuals}}
                return replace(self, individuals=come, without_individuals=self.without_individuals - set(come))
            case RemoveIndividuals(names):
                _check_known("individual", names, self.world.ontology.individuals)
                added = _without(self.individuals, names)
                known = {
                    *self.base.ontology.individuals,
                    *(o.name for d in self.declared.values() for o in d.individuals),
                }
                beyond = self.without_individuals | known.intersection(names)
                return replace(self, individuals=added, without_individuals=beyond)
            case Declare(name):
                return self._declaring(name, change)
            case Withdraw(name):
                _check_known("declaration", [name], self.declared)
                return replace(self, declared=_without(self.declared, [name]))
            case Restore(names):
                _check_known("removed name", names, dict.fromkeys(self.removed))
                return replace(
                    self,
                    without_targets=self.without_targets.difference(names),
                    without_transformations=self.without_transformations.difference(names),
                    without_individuals=self.without_individuals.difference(names),
                )
            case ReplaceWorld(base):
                old, new = self.base.environment, base.environment
                told, told_of_library = _told(old.target, new.target), _told(old.transformation, new.transformation)
                return replace(
                    self,
                    base=base,
                    targets=_without(self.targets, told),
                    transformations=_without(self.transformations, told_of_library),
                    without_targets=self.without_targets - told,
                    without_transformations=self.without_transformations - told_of_library,
                    without_individuals=self.without_individuals.intersection(base.ontology.individuals),
                )

    def _declaring(self, name: str, change: Declare) -> LivingWorld:
        """Add a declaration. What it declares comes back, even if a request had removed it."""
        back = self.without_individuals.difference(one.name for one in change.individuals)
        after = replace(self, declared={**self.declared, name: change}, without_individuals=back)
        if not (self.without_targets or self.without_transformations):
            return after
        (_, said), (_, besides) = after._said, replace(after, declared=_without(after.declared, [name]))._said
        return replace(
            after,
            without_targets=self.without_targets - (said.target.keys() - besides.target.keys()),
            without_transformations=self.without_transformations
            - (said.transformation.keys() - besides.transformation.keys()),
        )


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


def _changed(base: Mapping[str, T], more: Mapping[str, T], without: frozenset[str]) -> Mapping[str, T]:
    return {**{label: value for label, value in base.items() if label not in without}, **more}


def _without(known: Mapping[str, T], names: Iterable[str]) -> Mapping[str, T]:
    gone = set(names)
    return {name: value for name, value in known.items() if name not in gone}


def _check_known(what: str, names: Iterable[str], known: Mapping[str, object]) -> None:
    faults = [
        Fault(f"there is no {what} {name!r}", mend=f"choose one of {', '.join(sorted(known)[:8])}" if known else None)
        for name in names
        if name not in known
    ]
    if faults:
        raise InputError(faults)


def _check_tags(transformations: Iterable[Transformation], targets: Iterable[Target], ontology: Ontology) -> None:
    faults: list[Fault] = []
    tagged = [(f"target {target.label!r}", target.tag) for target in targets]
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
