"""The words of the problem as frozen values (paper, section III, Definitions 1-7).

Collections are sets in the paper; here they are tuples in a canonical order, so that two values
are equal exactly when they mean the same, whatever order they were written in.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import cached_property
from itertools import groupby
from operator import attrgetter
from types import MappingProxyType
from typing import Annotated, TypeVar

from cfgplan.amounts import core_share
from cfgplan.arguments import Natural, checked
from cfgplan.canonical import fields_of, refuse_duplicates, store_sorted
from cfgplan.errors import InvalidValueError
from cfgplan.facts import Comparison, Fact, FactValue, requirement, variables, why_left_out
from cfgplan.hosts import MANAGER as MANAGER
from cfgplan.hosts import Host as Host
from cfgplan.hosts import Link as Link
from cfgplan.qualities import (
    Better,
    Contribution,
    Curve,
    QualityAttribute,
    QualityRule,
    Told,
    units,
)
from cfgplan.rows import ALL as ALL
from cfgplan.rows import ELEMENT, FOUND, Feature, Row, Use, features
from cfgplan.similarity import Similarity as Similarity
from cfgplan.summary import Summary, counted, cpu, summarised, summary, tabled
from cfgplan.targets import A_UNIT_OF as A_UNIT_OF
from cfgplan.targets import Target as Target
from cfgplan.targets import observing as observing
from cfgplan.transformations import CPU as CPU
from cfgplan.transformations import MEMORY as MEMORY
from cfgplan.transformations import POWER as POWER
from cfgplan.transformations import START_MODES as START_MODES
from cfgplan.transformations import InputPort as InputPort
from cfgplan.transformations import OutputPort as OutputPort
from cfgplan.transformations import RunOptions as RunOptions
from cfgplan.transformations import Statement as Statement
from cfgplan.transformations import Transformation as Transformation
from cfgplan.transformations import amount_of as amount_of
from cfgplan.transformations import as_taught

T = TypeVar("T")


@dataclass(frozen=True, slots=True, order=True)
@checked
class Stream:
    """One output `port` of one computation `unit` (Definition 1); written `unit/port`."""

    unit: str
    port: str

    @classmethod
    def parse(cls, text: str) -> Stream:
        """Read `unit/port`; the port is what follows the last slash. Raises InvalidValueError."""
        unit, slash, port = text.rpartition("/")
        if not (unit and slash and port):
            raise InvalidValueError(f"{text!r} is not a stream: write it as unit/port")
        return cls(unit, port)

    def __str__(self) -> str:
        return f"{self.unit}/{self.port}"


@dataclass(frozen=True, slots=True, order=True)
@checked
class Subscription:
    """An input `port` of a unit and a `stream` that feeds it."""

    port: str
    stream: Stream


@dataclass(frozen=True, slots=True, order=True)
@checked
class Publication:
    """An output `port` of a unit and a `topic` that its stream is published on."""

    port: str
    topic: str


def _unit_summary(unit: ComputationUnit) -> Summary:
    host = f" on {unit.host}" if unit.host is not None else ""
    line = f"unit {unit.id} of {unit.transformation}{host}{', a spare' if unit.standby else ''}"
    taken = (("takes", port, stream) for port, streams in unit.feeds.items() for stream in streams)
    given = (("publishes", each.port, each.topic) for each in unit.publications)
    return summary(line, ("", "port", "stream or topic"), [*taken, *given])


@tabled(_unit_summary)
@dataclass(frozen=True)
@checked
class ComputationUnit:
    """A running instance of a `transformation` (a label; Definition 3), under the name `id`.

    `subscriptions` feed its inputs, `publications` put its outputs on topics. An input port without a subscription is
    the paper's `none`: a gap. `host` is where it runs, if the environment has hosts. A unit in `standby` is a cold
    spare: it is neither wired nor running, only ready.
    """

    id: Annotated[str, Row("the name of the unit; unique")]
    transformation: Annotated[str, Row("the label of its transformation, with template variables filled in")]
    subscriptions: Annotated[
        tuple[Subscription, ...],
        Row(
            "input port to the stream that feeds it, as UNIT/PORT, or to a list of streams; null: nothing feeds it",
            key="inputs",
            form="dict[PortName, OneOrMoreStreams | None]",
            xml=ELEMENT,
        ),
    ] = ()
    publications: Annotated[
        tuple[Publication, ...],
        Row(
            "output port to a list of topics on which it is published",
            key="topics",
            form="dict[PortName, Names]",
            xml=ELEMENT,
        ),
    ] = ()
    host: Annotated[str | None, Row("the host that it runs on; needed if hosts are declared")] = None
    standby: Annotated[bool, Row("true: it is a cold spare, which does not run", feature=Feature.SURVIVAL)] = False

    def __post_init__(self) -> None:
        store_sorted(self, "subscriptions", self.subscriptions, attrgetter("port", "stream"))
        store_sorted(self, "publications", self.publications, attrgetter("port", "topic"))
        refuse_duplicates(f"subscription of unit {self.id!r}", [f"{s.port} <- {s.stream}" for s in self.subscriptions])
        refuse_duplicates(f"topic of unit {self.id!r}", [p.topic for p in self.publications])
        if self.standby and (self.subscriptions or self.publications):
            raise InvalidValueError(f"unit {self.id!r} is in standby: it can't subscribe or publish")

    __getstate__ = fields_of

    @cached_property
    def feeds(self) -> Mapping[str, tuple[Stream, ...]]:
        """The streams that feed each subscribed input port, in order, by the port's name."""
        ports = groupby(self.subscriptions, attrgetter("port"))
        return MappingProxyType({port: tuple([s.stream for s in group]) for port, group in ports})


def _following(transformation: Transformation, facts: Mapping[str, Fact]) -> Transformation:
    """The transformation with the qualities that follow from facts."""

    def stated(contribution: Contribution) -> Contribution:
        fact = facts.get(contribution.by.fact) if contribution.by is not None else None
        if contribution.by is None or fact is None or isinstance(fact.value, bool | str):
            return contribution
        plain = replace(contribution, value=contribution.by.at(fact.value), seen=0, seen_on=())
        return plain.taught(contribution.learned)

    outputs = (replace(port, quality=tuple(map(stated, port.quality))) for port in transformation.outputs)
    return replace(transformation, outputs=tuple(outputs))


CHANGE_HEADS = ("", "name", "on", "fed by")


def change_rows(changes: ChangeSet) -> Iterator[tuple[str, ...]]:
    """A row for each change, as a notebook shows them."""
    for what, changed in (("start", changes.started), ("rewire", changes.rewired)):
        for unit in changed:
            yield what, unit.id, "spare" if unit.standby else unit.host or "", _feeds(unit)
    for unit_id in changes.stopped:
        yield "stop", unit_id, "", ""
    for what, parts in _OTHER_CHANGES.items():
        for part in getattr(changes, f"added_{parts}"):
            yield f"add {what}", part.label if hasattr(part, "label") else part.name, "", ""
        for name in getattr(changes, f"removed_{parts}"):
            yield f"remove {what}", name, "", ""


_OTHER_CHANGES = {
    "transformation": "transformations",
    "target": "targets",
    "host": "hosts",
    "quality": "qualities",
}
"""The parts of an environment that a change set adds and removes beside units, each by the noun for one of them."""


def _feeds(unit: ComputationUnit) -> str:
    return ", ".join(f"{port} from {' and '.join(map(str, streams))}" for port, streams in unit.feeds.items())


def changes_in_words(changes: ChangeSet) -> str:
    """The number of units to start, to rewire and to stop."""
    numbers = [(changes.started, "to start"), (changes.rewired, "to rewire"), (changes.stopped, "to stop")]
    return ", ".join(f"{len(units)} {to}" for units, to in numbers)


@tabled(lambda each: summary(changes_in_words(each), CHANGE_HEADS, change_rows(each)))
@dataclass(frozen=True)
@checked
class ChangeSet:
    """Additions and removals (Definition 6).

    Units have three disjoint parts: `started` and `rewired` hold units as they are afterwards, `stopped` holds ids.
    `added_transformations`, `added_targets`, `added_hosts` and `added_qualities` hold items, each of which replaces an
    existing one of the same name; `removed_transformations`, `removed_targets` (labels), `removed_hosts` and
    `removed_qualities` hold names.
    """

    started: tuple[ComputationUnit, ...] = ()
    rewired: tuple[ComputationUnit, ...] = ()
    stopped: tuple[str, ...] = ()
    added_transformations: tuple[Transformation, ...] = ()
    removed_transformations: tuple[str, ...] = ()
    added_targets: tuple[Target, ...] = ()
    removed_targets: tuple[str, ...] = ()
    added_hosts: tuple[Host, ...] = ()
    removed_hosts: tuple[str, ...] = ()
    added_qualities: tuple[QualityAttribute, ...] = ()
    removed_qualities: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        store_sorted(self, "started", self.started, attrgetter("id"))
        store_sorted(self, "rewired", self.rewired, attrgetter("id"))
        store_sorted(self, "stopped", self.stopped, str)
        refuse_duplicates(
            "unit of a change set", [*(u.id for u in self.started), *(u.id for u in self.rewired), *self.stopped]
        )

    def __bool__(self) -> bool:
        """Whether an update by this change set changes anything."""
        return any(getattr(self, name) for name in self.__dataclass_fields__)


class Objective(StrEnum):
    """The quantities of an update that can be minimised."""

    RENT = "rent"
    """The rent of used hosts over the horizon, in microseconds; it is part of the cost too."""
    COST = "cost"
    """Definition 8, in microseconds."""
    UNITS = "units"
    """Running units."""
    HOSTS = "hosts"
    """Hosts that units are on, spares too."""
    REWIRED = "rewired"
    """Kept units with another wiring."""
    STARTED = "started"
    """New units, spares too."""


ENVIRONMENT_HEADS = ("", "name", "takes", "gives", "labor", "upkeep")


def environment_rows(environment: Environment) -> Iterator[tuple[str, ...]]:
    """A row for each target, unit and transformation, as a notebook shows them."""
    for target in environment.targets:
        yield "target", target.label, target.tag or f"a unit of {target.run}", target.topic, "", ""
    for unit in environment.units:
        kind = environment.transformation.get(unit.transformation)
        gaps = [port for port in kind.inputs if port.name not in unit.feeds] if kind and not unit.standby else []
        unfed = [f"{port.name} unfed" if port.optional else f"{port.name}: a gap" for port in gaps]
        takes = ", ".join([*filter(None, [_feeds(unit)]), *unfed])
        gives = ", ".join(f"{each.port} to {each.topic}" for each in unit.publications)
        yield "unit", unit.id, takes, gives, "", ""
    for kind in environment.library:
        takes, gives = (
            ", ".join(f"{port.name}: {port.tag}" for port in ports) for ports in (kind.inputs, kind.outputs)
        )
        yield "transformation", kind.label, takes, gives, cpu(kind.labor_us), core_share(kind.upkeep_us)


_NAMED = (
    ("units", "id", "unit"),
    ("library", "label", "transformation"),
    ("targets", "label", "target"),
    ("hosts", "name", "host"),
    ("qualities", "name", "quality attribute"),
    ("facts", "name", "fact"),
)
"""The parts of an environment, the attribute that names each, and the noun for one of them."""


@summarised(lambda each: summary(each.counted, ENVIRONMENT_HEADS, environment_rows(each)))
@dataclass(frozen=True)
@checked
class Environment:
    """Computation `units`, `library` and `targets` (Definition 5); ~ is a `Similarity` beside it.

    `qualities` are the attributes that streams and targets may speak of. Without `hosts` nothing is placed; with them
    every unit has one. `transfer_us` is the price of carrying a megabyte (10**6 bytes) from host to host, in
    microseconds of CPU time, unless the first of the `links` that joins the two hosts has a price of its own.
    `minimise` lists the objectives of an update, the most important first; the cost comes last unless it is listed, and
    ties are broken by fewer rewired, then fewer started units. Planners get `possible`: the environment whose library
    omits transformations that require other `facts`. `omitted` are these transformations, each with the reason.
    """

    units: tuple[ComputationUnit, ...] = ()
    library: tuple[Transformation, ...] = ()
    targets: tuple[Target, ...] = ()
    hosts: Annotated[tuple[Host, ...], Row(feature=Feature.HOSTS)] = ()
    qualities: tuple[QualityAttribute, ...] = ()
    transfer_us: Natural = 0
    links: tuple[Link, ...] = ()
    minimise: Annotated[tuple[Objective, ...], Row(feature=Feature.ORDER)] = (Objective.COST,)
    facts: Annotated[tuple[Fact, ...], Row(use=Use.NONE)] = ()
    omitted: Annotated[tuple[tuple[Transformation, str], ...], FOUND] = field(default=(), compare=False)

    def __post_init__(self) -> None:
        if Objective.COST not in self.minimise:
            object.__setattr__(self, "minimise", (*self.minimise, Objective.COST))
        refuse_duplicates("objective", [*self.minimise])
        for name, key, what in _NAMED:
            store_sorted(self, name, getattr(self, name), attrgetter(key))
            refuse_duplicates(what, [getattr(each, key) for each in getattr(self, name)])
        if self.facts:
            refuse_duplicates("fact", [fact.key for fact in variables(self.facts, [host.name for host in self.hosts])])
        refuse_duplicates("topic of a target", [target.topic for target in self.stream_targets])
        for attribute in [link.adds for link in self.links if link.adds is not None]:
            if attribute not in self.quality or self.quality[attribute].better is Better.HIGHER:
                raise InvalidValueError(f"a link adds to {attribute}, which is not an attribute with `better: lower`")
        placed = next((unit for unit in self.units if unit.host is not None), None)
        if placed is not None and not self.hosts:
            raise InvalidValueError(f"unit {placed.id!r} runs on {placed.host}, but the environment has no hosts")
        for target in self.targets:
            for wish in target.quality:
                if wish.attribute not in self.quality:
                    raise InvalidValueError(
                        f"target {target.label!r} asks for {wish.attribute}, which is not declared under `qualities:`"
                    )
            if target.host is not None and target.host not in self.host:
                raise InvalidValueError(
                    f"target {target.label!r} is at {target.host}, which is not declared under `hosts:`"
                )

    __getstate__ = fields_of

    @property
    def counted(self) -> str:
        """The size in words: `14 transformations, 5 units, 1 target`."""
        parts = [(self.library, "transformation"), (self.units, "unit"), (self.targets, "target")]
        parts += [(self.hosts, "host")] if self.hosts else []
        return ", ".join(counted(len(things), noun) for things, noun in parts)

    def with_units(self, units: Iterable[ComputationUnit]) -> Environment:
        """Return the environment with other units, which must be valid: nothing checks them. Values that were derived
        from its other parts are kept.
        """
        copy = object.__new__(Environment)
        vars(copy).update(vars(self), units=tuple(sorted(units, key=attrgetter("id"))))
        vars(copy).pop("unit", None)
        return copy

    @cached_property
    def features(self) -> frozenset[Feature]:
        """The features beyond the paper of the library, targets and hosts; quality counts only if a target asks for it.

        Running units are left out, so that the value holds for any units.
        """
        asked = features(Environment, [self]) | features(Target, self.targets)
        asked = asked.union(*{transformation.features for transformation in self.library})
        if not self.links:
            return asked
        wished = {wish.attribute for target in self.targets for wish in target.quality}
        return asked.union([Feature.LATENCY] if any(link.adds in wished for link in self.links) else ())

    @cached_property
    def outputs(self) -> Mapping[str, str]:
        """The tag of each output of the library, by its name `transformation/port`."""
        return MappingProxyType({f"{t.label}/{port.name}": port.tag for t in self.library for port in t.outputs})

    @cached_property
    def demands(self) -> Mapping[str, str]:
        """The tag of each input of the library, by its name `transformation/port`, and of each `target LABEL`."""
        inputs = {f"{t.label}/{port.name}": port.tag for t in self.library for port in t.inputs}
        return MappingProxyType({**inputs, **{f"target {each.label}": each.tag for each in self.stream_targets}})

    @cached_property
    def unit(self) -> Mapping[str, ComputationUnit]:
        """The units by id."""
        return MappingProxyType({unit.id: unit for unit in self.units})

    @cached_property
    def transformation(self) -> Mapping[str, Transformation]:
        """The transformations by label."""
        return MappingProxyType({transformation.label: transformation for transformation in self.library})

    @cached_property
    def required(self) -> tuple[str, ...]:
        """The labels of the required transformations, in the library's order."""
        return tuple(transformation.label for transformation in self.library if transformation.required)

    @cached_property
    def companions(self) -> frozenset[str]:
        """The labels that other transformations run with."""
        return frozenset(label for transformation in self.library for label in transformation.beside)

    @cached_property
    def target(self) -> Mapping[str, Target]:
        """The targets by label."""
        return MappingProxyType({target.label: target for target in self.targets})

    @cached_property
    def stream_targets(self) -> tuple[Target, ...]:
        """The targets that want a stream."""
        return tuple(target for target in self.targets if target.run is None)

    @cached_property
    def wanted_to_run(self) -> Mapping[str, str]:
        """The transformations that targets want to run, by the targets' labels."""
        return MappingProxyType({target.label: target.run for target in self.targets if target.run is not None})

    def meeting(self, units: Collection[ComputationUnit]) -> dict[str, ComputationUnit]:
        """Return the unit that meets each target, by the target's label; targets that none of `units` meets are
        missing.

        The unit publishes the target's stream. For a target that wants a transformation to run, it is the first running
        unit of it, by id.
        """
        publishing = {publication.topic: unit for unit in units for publication in unit.publications}
        found = {target.label: publishing.get(target.topic) for target in self.stream_targets}
        for label, wanted in self.wanted_to_run.items():
            running = (unit for unit in units if unit.transformation == wanted and not unit.standby)
            found[label] = min(running, key=attrgetter("id"), default=None)
        return {label: unit for label, unit in found.items() if unit is not None}

    @cached_property
    def host(self) -> Mapping[str, Host]:
        """The hosts by name."""
        return MappingProxyType({host.name: host for host in self.hosts})

    @cached_property
    def quality(self) -> Mapping[str, QualityAttribute]:
        """The quality attributes by name."""
        return MappingProxyType({attribute.name: attribute for attribute in self.qualities})

    @cached_property
    def fact(self) -> Mapping[str, Fact]:
        """The facts by name."""
        return MappingProxyType({fact.name: fact for fact in self.facts})

    @cached_property
    def variable(self) -> Mapping[str, Fact]:
        """The facts that have one value, by key; a fact of hosts once for each host, such as `r1.battery`."""
        return MappingProxyType({fact.key: fact for fact in variables(self.facts, self.host)})

    def _facts_on(self, host: str) -> Mapping[str, Fact]:
        """The facts by name, as they are on a host."""
        return {fact.name: fact if fact.of is None else fact.on(host) for fact in self.facts}

    @cached_property
    def comparisons(self) -> Mapping[str, tuple[Comparison, ...]]:
        """The comparisons that transformations make with each fact, by its name; only facts that some transformation
        requires.
        """
        asked = sorted({t.requires for t in self.library if t.requires is not None})
        found = dict.fromkeys(each for requires in asked for each in requirement(requires).comparisons)
        return MappingProxyType({name: tuple(c for c in found if c.fact == name) for name in {c.fact for c in found}})

    @cached_property
    def bounds(self) -> Mapping[str, tuple[int, ...]]:
        """The numbers that facts are compared with, in order, by the fact's name; see `Comparison.bound`."""
        found = {
            name: {bound for each in some if (bound := each.bound) is not None}
            for name, some in self.comparisons.items()
        }
        return MappingProxyType({name: tuple(sorted(some)) for name, some in found.items()})

    @cached_property
    def left_out(self) -> Mapping[str, str]:
        """Why the present facts forbid transformations, by label: `visibility is 1 m`.

        Raises InvalidValueError if a requirement compares an unknown fact, or a fact with a value of another kind.
        """
        asked = {t.label: t.requires for t in self.library if t.requires is not None}
        for label, requires in asked.items():
            for comparison in requirement(requires).comparisons:
                if misfit := comparison.misfit(self.fact):
                    raise InvalidValueError(f"transformation {label!r}: {misfit[0]}")
        why = {label: self._why_nowhere(self.transformation[label], requires) for label, requires in asked.items()}
        return MappingProxyType({label: reason for label, reason in why.items() if reason is not None})

    def _why_nowhere(self, transformation: Transformation, requires: str) -> str | None:
        """Why no unit of a transformation may run as the facts are; None if one may somewhere."""
        against = self._against.get(requires)
        if against is None:
            return why_left_out(requires, self.fact)
        hosts = self._chosen(transformation)
        if not hosts or any(host not in against for host in hosts):
            return None
        return " and ".join(dict.fromkeys(against[host] for host in hosts))

    @cached_property
    def _against(self) -> Mapping[str, Mapping[str, str]]:
        """Why each host does not meet a requirement of its own facts, by the requirement; hosts that do are missing."""
        of_hosts = {fact.name for fact in self.facts if fact.of is not None}
        if not (of_hosts and self.hosts):
            return MappingProxyType({})
        asked = {t.requires for t in self.library if t.requires is not None}
        found: dict[str, dict[str, str]] = {}
        for requires in (text for text in asked if of_hosts & {one.fact for one in requirement(text).comparisons}):
            why = {host: why_left_out(requires, self._facts_on(host)) for host in self.host}
            found[requires] = {host: reason for host, reason in why.items() if reason is not None}
        return MappingProxyType(found)

    @cached_property
    def barred(self) -> Mapping[str, Mapping[str, str]]:
        """Why the present facts of hosts forbid transformations on some of their hosts, by label and host:
        `needs battery > 20, battery is 15 % on r1`.

        Transformations that are left out, or may run on all of their hosts, are missing.
        """
        found = {
            t.label: {host: f"needs {t.requires}, {against[host]}" for host in self._chosen(t) if host in against}
            for t in self.library
            if t.requires is not None and t.label not in self.left_out and (against := self._against.get(t.requires))
        }
        return MappingProxyType({label: hosts for label, hosts in found.items() if hosts})

    def with_facts(self, values: Mapping[str, FactValue]) -> Environment:
        """Return the environment in which facts have other values, by key; values of another kind are ignored.

        Qualities that follow a fact get the values that follow from it. An environment without facts is returned as is.
        """
        if not self.facts:
            return self
        facts = {fact.name: self._being(fact, values) for fact in self.facts}
        changed = {label: _following(self.transformation[label], facts) for label in self.following}
        library = tuple(changed.get(t.label, t) for t in self.library) if changed else self.library
        return replace(self, facts=tuple(facts.values()), library=library)

    def _being(self, fact: Fact, values: Mapping[str, FactValue]) -> Fact:
        if fact.of is None:
            return fact.being(values.get(fact.name))
        return fact.being_on({host: values[key] for host in self.host if (key := f"{host}.{fact.name}") in values})

    def with_qualities(self, seen: Mapping[Statement, int]) -> Environment:
        """The environment with the learned qualities of outputs; an output without any keeps its stated one.

        `seen` has the deviation of each output's own contribution from the stated one, in micro-units. The deviation of
        a statement with a host counts on that host, of one without a host on all other hosts.
        """
        learned: dict[Statement, dict[str | None, int]] = {}
        for one, by in seen.items():
            learned.setdefault(one._replace(host=None), {})[one.host] = by
        touched = {one.transformation for one in seen} | self.taught.keys()
        changed = {t.label: as_taught(t, learned) for t in self.library if t.label in touched}
        return replace(self, library=tuple(changed.get(t.label, t) for t in self.library)) if changed else self

    def stated(self, statement: Statement) -> Contribution | None:
        """Return the contribution of an output to a quality attribute, on the statement's host; None if the environment
        lacks the contribution, the output or the host.
        """
        transformation = self.transformation.get(statement.transformation)
        port = None if transformation is None else transformation.output.get(statement.output)
        if port is None or (statement.host is not None and statement.host not in self.host):
            return None
        found = next((each for each in port.quality if each.attribute == statement.attribute), None)
        return None if found is None else found.on(statement.host)

    @cached_property
    def observable(self) -> tuple[Statement, ...]:
        """The statements whose quality a run can observe."""
        return tuple(
            Statement(transformation.label, port.name, each.attribute)
            for transformation in self.library
            for port in transformation.outputs
            for each in port.quality
            if each.observe is not None
        )

    @cached_property
    def observable_on(self) -> Mapping[str, frozenset[str]]:
        """By transformation whose quality a run can observe: the hosts where it may run, whatever the facts are."""
        labels = dict.fromkeys(statement.transformation for statement in self.observable)
        return MappingProxyType({label: frozenset(self._chosen(self.transformation[label])) for label in labels})

    @cached_property
    def told(self) -> Mapping[Statement, Told]:
        """The statements whose quality topics of ROS 2 tell beside the streams."""
        stated = ((statement, self.stated(statement)) for statement in self.observable)
        found = {statement: each.told for statement, each in stated if each is not None and each.told is not None}
        return MappingProxyType(found)

    @cached_property
    def losing(self) -> tuple[Statement, ...]:
        """Return the statements whose loss of elements is measured at the inputs that their streams feed."""
        stated = ((statement, self.stated(statement)) for statement in self.observable)
        return tuple(statement for statement, each in stated if each is not None and each.measured == "loss")

    @cached_property
    def taught(self) -> Mapping[str, tuple[Statement, ...]]:
        """The statements with a value learned from streams, by their transformation; other statements are missing."""
        found = {
            t.label: tuple(
                Statement(t.label, port.name, each.attribute, host)
                for port in t.outputs
                for each in port.quality
                for host in each.learned
            )
            for t in self.library
        }
        return MappingProxyType({label: stated for label, stated in found.items() if stated})

    @property
    def as_declared(self) -> Environment:
        """The environment in which every fact and quality has its declared value."""
        plain = self.with_qualities({})
        return plain.with_facts({key: fact.declared for key, fact in self.variable.items()}) if self.facts else plain

    @property
    def sides(self) -> Mapping[str, bool]:
        """Whether each comparison that some transformation requires holds for the present facts, by its text."""
        found = (
            (replace(each, fact=fact.key), fact)
            for fact in self.variable.values()
            for each in self.comparisons.get(fact.name, ())
        )
        return {str(each): each.holds(fact.value) for each, fact in sorted(found, key=lambda one: str(one[0]))}

    @cached_property
    def following(self) -> Mapping[str, tuple[tuple[str, Contribution], ...]]:
        """The qualities that follow facts, each with its output, by transformation; other transformations are
        missing.
        """
        found = {
            t.label: tuple((port.name, each) for port in t.outputs for each in port.quality if each.by is not None)
            for t in self.library
        }
        return MappingProxyType({label: stated for label, stated in found.items() if stated})

    @cached_property
    def curves(self) -> Mapping[str, tuple[Curve, ...]]:
        """The curves by which qualities follow each fact, by its name; only facts that some quality follows."""
        found = {each.by for stated in self.following.values() for _, each in stated if each.by is not None}
        return MappingProxyType(
            {
                fact: tuple(sorted(curve for curve in found if curve.fact == fact))
                for fact in {each.fact for each in found}
            }
        )

    def shown(self, contribution: Contribution, value: int) -> str:
        """Format a `value` (micro-units) of the `contribution` that an output states, for people: `0.3 m`, or a
        factor.
        """
        attribute = self.quality.get(contribution.attribute)
        is_number = attribute is None or contribution.rule is QualityRule.SCALE
        return f"{units(value):f}" if is_number or attribute is None else attribute.shown(value)

    @property
    def qualities_now(self) -> dict[str, str]:
        """The qualities that follow facts or were observed: `camera/image error` to `0.82 m, brightness is 0.2`."""
        found = {
            str(Statement(label, port, each.attribute)): f"{self.shown(each, each.value)}, {self.fact[each.by.fact]}"
            for label, stated in self.following.items()
            for port, each in stated
            if each.by is not None and each.by.fact in self.fact
        }
        for statement in (each for some in self.taught.values() for each in some):
            if each := self.stated(statement):
                value, stated_value = self.shown(each, each.value), self.shown(each, each.stated)
                found[str(statement)] = f"{value} observed, {stated_value} declared"
        return found

    def with_link_rates(self, rates: Mapping[tuple[str, str], int]) -> Environment:
        """Return the environment whose links carry at most these measured rates, in bytes per second.

        A rate belongs to the declared link between its two selectors, or else to a link of its own.
        """
        known = tuple(
            replace(link, bandwidth=rates[link.between], is_measured=True, declared=link.bandwidth)
            if link.between in rates
            else link
            for link in self.links
        )
        new = rates.keys() - {link.between for link in self.links}
        return replace(self, links=(*known, *(Link(ends, rates[ends], is_measured=True) for ends in sorted(new))))

    @property
    def with_declared_links(self) -> Environment:
        """The environment whose links carry as much as declared."""
        if not any(link.is_measured for link in self.links):
            return self
        links = (
            replace(link, bandwidth=link.declared, is_measured=False) if link.is_measured else link
            for link in self.links
        )
        return replace(self, links=tuple(links))

    @property
    def possible(self) -> Environment:
        """The environment whose library omits the transformations that the present facts forbid."""
        if not self.left_out:
            return self
        return self.omitting(self.left_out)

    def omitting(self, labels: Mapping[str, str]) -> Environment:
        """Return the environment whose library also omits the transformations of these labels, each with the reason."""
        omitted = (*self.omitted, *((t, labels[t.label]) for t in self.library if t.label in labels))
        return replace(self, library=tuple(t for t in self.library if t.label not in labels), omitted=omitted)

    def hosts_for(self, transformation: Transformation) -> tuple[str | None, ...]:
        """Return the names of the hosts where the present facts let units of a transformation run, in order; (None,)
        without hosts.
        """
        if not self.hosts:
            return (None,)
        against = self._against.get(transformation.requires, {}) if transformation.requires is not None else {}
        return tuple(host for host in self._chosen(transformation) if host not in against)

    def _chosen(self, transformation: Transformation) -> tuple[str, ...]:
        """The hosts that a transformation names or selects, whatever the facts are."""
        wanted = transformation.hosts if transformation.host is None else (transformation.host,)
        return tuple(
            host.name
            for host in self.hosts
            if (not wanted or host.name in wanted) and (transformation.on is None or host.fits(transformation.on))
        )

    def places_for(self, transformation: Transformation) -> tuple[Host | None, ...]:
        """Return the hosts where units of a transformation may run; (None,) without hosts."""
        return tuple(None if name is None else self.host[name] for name in self.hosts_for(transformation))

    @cached_property
    def link(self) -> Mapping[tuple[str, str], Link]:
        """The link between two hosts, by their names in any order; pairs without a link are missing."""
        pairs = [(one, other) for one in self.hosts for other in self.hosts if one != other] if self.links else []
        first = {(a.name, b.name): next((link for link in self.links if link.joins(a, b)), None) for a, b in pairs}
        return MappingProxyType({pair: link for pair, link in first.items() if link is not None})

    @cached_property
    def prices_us(self) -> tuple[int, ...]:
        """The possible prices of carrying a megabyte from host to host, in ascending order."""
        return tuple(sorted({self.transfer_us, *(link.price_us for link in self.links if link.price_us is not None)}))

    def price_us(self, one: str | None, other: str | None) -> int:
        """Return the price of carrying a megabyte between the hosts `one` and `other`, in microseconds of CPU time."""
        link = self.link.get((one or "", other or ""))
        return self.transfer_us if link is None or link.price_us is None else link.price_us

    def latency(self, attribute: str, one: str | None, other: str | None) -> int:
        """Return the amount (micro-units) that a transfer between the hosts `one` and `other` adds to a stream's value
        of `attribute`.
        """
        link = self.link.get((one or "", other or ""))
        return 0 if link is None or link.adds != attribute else link.latency

    def place_of(self, unit: ComputationUnit) -> Host | None:
        """The host of a unit; None if it has none that is known."""
        return None if unit.host is None else self.host.get(unit.host)

    def update(self, change_set: ChangeSet | None) -> Environment:
        """The environment after the update by `change_set` (Definition 7): additions, then removals.

        Raises InvalidValueError if a unit to rewire or stop does not run, if one to start does, or if `change_set` is
        None since no plan was found.
        """
        if change_set is None:
            raise InvalidValueError("no plan was found, so there is no change set; the plan's `reasons` say why")
        for unit in change_set.started:
            if unit.id in self.unit:
                raise InvalidValueError(f"unit {unit.id!r} can't be started: it runs already")
        for unit_id in (*(unit.id for unit in change_set.rewired), *change_set.stopped):
            if unit_id not in self.unit:
                raise InvalidValueError(f"unit {unit_id!r} can't be rewired or stopped: it does not run")
        changes = change_set
        return replace(
            self,
            units=_updated(self.unit, "id", (*changes.started, *changes.rewired), changes.stopped),
            library=_updated(
                self.transformation, "label", changes.added_transformations, changes.removed_transformations
            ),
            targets=_updated(self.target, "label", changes.added_targets, changes.removed_targets),
            hosts=_updated(self.host, "name", changes.added_hosts, changes.removed_hosts),
            qualities=_updated(self.quality, "name", changes.added_qualities, changes.removed_qualities),
        )

    def without_unit(self, unit_id: str) -> Environment:
        """Return the environment after a unit has died; the inputs that it fed lose their subscriptions."""
        left = tuple(
            replace(unit, subscriptions=tuple(s for s in unit.subscriptions if s.stream.unit != unit_id))
            for unit in self.units
            if unit.id != unit_id
        )
        return replace(self, units=left)

    def change_to(self, units: Iterable[ComputationUnit]) -> ChangeSet:
        """Return the change set that turns the running units into `units`."""
        after = {unit.id: unit for unit in units}
        return ChangeSet(
            started=tuple(unit for unit in after.values() if unit.id not in self.unit),
            rewired=tuple(unit for unit in after.values() if unit.id in self.unit and unit != self.unit[unit.id]),
            stopped=tuple(unit_id for unit_id in self.unit if unit_id not in after),
        )


def _updated(before: Mapping[str, T], key: str, added: Iterable[T], removed: Iterable[str]) -> tuple[T, ...]:
    after, gone = {**before, **{getattr(each, key): each for each in added}}, {*removed}
    return tuple(each for name, each in after.items() if name not in gone)
