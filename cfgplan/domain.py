"""The words of the problem as frozen values (paper, section III, Definitions 1-7).

Collections are sets in the paper; here they are tuples in a canonical order, so that two values
are equal exactly when they mean the same, whatever order they were written in.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from operator import attrgetter
from types import MappingProxyType
from typing import TypeVar

from cfgplan.errors import InvalidValueError

T = TypeVar("T")


@dataclass(frozen=True, slots=True, order=True)
class Stream:
    """One output port of one computation unit (Definition 1); written `unit/port`."""

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
class InputPort:
    """A named input of a transformation and the tag that says what it needs.

    Ports of one transformation in the same `distinct` group must be fed by different
    transformations. A `feedback` port may close a cycle of the wiring.
    """

    name: str
    tag: str
    distinct: str | None = None
    feedback: bool = False


@dataclass(frozen=True, slots=True, order=True)
class OutputPort:
    """A named output of a transformation and the tag that says what it gives."""

    name: str
    tag: str


START_MODES = ("all", "any", "aligned")


@dataclass(frozen=True, slots=True)
class RunOptions:
    """How the units of a transformation run; planning never looks at it.

    `start` says what starts a step: `all` inputs fresh, `any` input, inputs `aligned` in time within
    `tolerance_us`, or a port's name. `rate_hz` is a source's. `queue` elements wait at each input; when full,
    the oldest is dropped, or the producer waits if it `blocks`. A unit that is silent for `hang_us` (0: it
    may be silent) or takes more than `memory_mb` megabytes is killed. With `state`, a new unit goes on with the
    state of the last.
    """

    start: str = "all"
    tolerance_us: int = 0
    rate_hz: float | None = None
    queue: int = 256
    blocks: bool = False
    hang_us: int | None = None
    memory_mb: int | None = None
    state: bool = False


@dataclass(frozen=True)
class Transformation:
    """A streaming function that can be instantiated (Definition 2, section IV-A).

    `labor_us` is the CPU time of one start in microseconds, `upkeep_us` the CPU time in
    microseconds that a running unit takes each second. The running units of a `pinned`
    transformation are kept even where no target needs them; a `required` one is used by some target
    wherever that is possible at all (section V-C).
    """

    label: str
    inputs: tuple[InputPort, ...] = ()
    outputs: tuple[OutputPort, ...] = ()
    labor_us: int = 0
    upkeep_us: int = 0
    pinned: bool = False
    required: bool = False
    source: str | None = None
    host: str | None = None
    kind: str | None = None
    params: Mapping[str, object] = field(default_factory=dict, hash=False)
    run: RunOptions = RunOptions()

    def __post_init__(self) -> None:
        _store_sorted(self, "inputs", self.inputs, attrgetter("name"))
        _store_sorted(self, "outputs", self.outputs, attrgetter("name"))
        _refuse_duplicates(
            f"port of transformation {self.label!r}", [*(p.name for p in self.inputs), *(p.name for p in self.outputs)]
        )
        if self.labor_us < 0 or self.upkeep_us < 0:
            raise InvalidValueError(f"transformation {self.label!r} has a negative cost")

    @cached_property
    def input(self) -> Mapping[str, InputPort]:
        """The input ports by name."""
        return MappingProxyType({port.name: port for port in self.inputs})

    @cached_property
    def output(self) -> Mapping[str, OutputPort]:
        """The output ports by name."""
        return MappingProxyType({port.name: port for port in self.outputs})


@dataclass(frozen=True, slots=True, order=True)
class Subscription:
    """An input port of a unit and the stream that feeds it."""

    port: str
    stream: Stream


@dataclass(frozen=True, slots=True, order=True)
class Publication:
    """An output port of a unit and a topic that its stream is published on."""

    port: str
    topic: str


@dataclass(frozen=True)
class ComputationUnit:
    """A running instance of a transformation (Definition 3).

    An input port without a subscription is the paper's `none`: a gap.
    """

    id: str
    transformation: str
    subscriptions: tuple[Subscription, ...] = ()
    publications: tuple[Publication, ...] = ()

    def __post_init__(self) -> None:
        _store_sorted(self, "subscriptions", self.subscriptions, attrgetter("port", "stream"))
        _store_sorted(self, "publications", self.publications, attrgetter("port", "topic"))
        _refuse_duplicates(f"subscribed port of unit {self.id!r}", [s.port for s in self.subscriptions])
        _refuse_duplicates(f"topic of unit {self.id!r}", [p.topic for p in self.publications])

    @cached_property
    def feeds(self) -> Mapping[str, Stream]:
        """The stream that feeds each subscribed input port, by the port's name."""
        return MappingProxyType({s.port: s.stream for s in self.subscriptions})


@dataclass(frozen=True, slots=True)
class Target:
    """A semantic subscription from outside (Definition 4); a larger `priority` matters more."""

    label: str
    tag: str
    topic: str
    priority: int = 0


@dataclass(frozen=True)
class Similarity:
    """The relation ~ between tags (Definition 5): which offered tag may feed which demanded tag.

    `offers` maps each demanded tag to the offered tags that it accepts; collected over the ports
    of a library this is the paper's validity matrix. `unknown` holds the (offered, demanded) pairs
    that no reasoner could decide in time: they do not match.
    """

    offers: Mapping[str, frozenset[str]] = field(hash=False)
    unknown: frozenset[tuple[str, str]] = frozenset()

    def holds(self, offered: str, demanded: str) -> bool:
        """Whether an output tagged `offered` may feed an input or a target tagged `demanded`."""
        return offered in self.offers.get(demanded, ())


@dataclass(frozen=True)
class ChangeSet:
    """Additions and removals (Definition 6).

    Over units it has three disjoint parts: `started` and `rewired` hold units as they are
    afterwards, `stopped` holds ids.
    """

    started: tuple[ComputationUnit, ...] = ()
    rewired: tuple[ComputationUnit, ...] = ()
    stopped: tuple[str, ...] = ()
    added_transformations: tuple[Transformation, ...] = ()
    removed_transformations: tuple[str, ...] = ()
    added_targets: tuple[Target, ...] = ()
    removed_targets: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        _store_sorted(self, "started", self.started, attrgetter("id"))
        _store_sorted(self, "rewired", self.rewired, attrgetter("id"))
        _store_sorted(self, "stopped", self.stopped, str)
        _refuse_duplicates(
            "unit of a change set", [*(u.id for u in self.started), *(u.id for u in self.rewired), *self.stopped]
        )

    def __bool__(self) -> bool:
        """Whether an update by this change set changes anything."""
        return any(getattr(self, name) for name in self.__dataclass_fields__)


@dataclass(frozen=True)
class Environment:
    """Computation units, library and targets (Definition 5); ~ is a `Similarity` beside it."""

    units: tuple[ComputationUnit, ...] = ()
    library: tuple[Transformation, ...] = ()
    targets: tuple[Target, ...] = ()

    def __post_init__(self) -> None:
        _store_sorted(self, "units", self.units, attrgetter("id"))
        _store_sorted(self, "library", self.library, attrgetter("label"))
        _store_sorted(self, "targets", self.targets, attrgetter("label"))
        _refuse_duplicates("unit", [unit.id for unit in self.units])
        _refuse_duplicates("transformation", [transformation.label for transformation in self.library])
        _refuse_duplicates("target", [target.label for target in self.targets])
        _refuse_duplicates("topic of a target", [target.topic for target in self.targets])

    @cached_property
    def unit(self) -> Mapping[str, ComputationUnit]:
        """The units by id."""
        return MappingProxyType({unit.id: unit for unit in self.units})

    @cached_property
    def transformation(self) -> Mapping[str, Transformation]:
        """The transformations by label."""
        return MappingProxyType({transformation.label: transformation for transformation in self.library})

    @cached_property
    def target(self) -> Mapping[str, Target]:
        """The targets by label."""
        return MappingProxyType({target.label: target for target in self.targets})

    def update(self, change_set: ChangeSet) -> Environment:
        """The environment after the update by `change_set` (Definition 7): additions, then removals.

        Raises InvalidValueError if a unit to rewire or stop does not run or one to start does.
        """
        for unit in change_set.started:
            if unit.id in self.unit:
                raise InvalidValueError(f"unit {unit.id!r} can't be started: it runs already")
        for unit_id in (*(unit.id for unit in change_set.rewired), *change_set.stopped):
            if unit_id not in self.unit:
                raise InvalidValueError(f"unit {unit_id!r} can't be rewired or stopped: it does not run")
        return Environment(
            _updated(self.unit, {u.id: u for u in (*change_set.started, *change_set.rewired)}, change_set.stopped),
            _updated(
                self.transformation,
                {t.label: t for t in change_set.added_transformations},
                change_set.removed_transformations,
            ),
            _updated(self.target, {t.label: t for t in change_set.added_targets}, change_set.removed_targets),
        )

    def change_to(self, units: Iterable[ComputationUnit]) -> ChangeSet:
        """The change set over units whose update makes `units` the computation graph."""
        after = {unit.id: unit for unit in units}
        return ChangeSet(
            started=tuple(unit for unit in after.values() if unit.id not in self.unit),
            rewired=tuple(unit for unit in after.values() if unit.id in self.unit and unit != self.unit[unit.id]),
            stopped=tuple(unit_id for unit_id in self.unit if unit_id not in after),
        )


def _store_sorted(holder: object, name: str, values: Iterable[T], key: Callable[[T], object]) -> None:
    object.__setattr__(holder, name, tuple(sorted(values, key=key)))  # type: ignore[arg-type]


def _refuse_duplicates(what: str, names: list[str]) -> None:
    if len(set(names)) != len(names):
        twice = sorted(name for name, times in Counter(names).items() if times > 1)
        raise InvalidValueError(f"each {what} must be named once, but {', '.join(map(repr, twice))} is named again")


def _updated(before: Mapping[str, T], added: Mapping[str, T], removed: Iterable[str]) -> tuple[T, ...]:
    after = {**before, **added}
    for name in removed:
        after.pop(name, None)
    return tuple(after.values())
