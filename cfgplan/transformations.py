"""Transformations, which make up the library, with their tagged ports (paper, section IV-A, Definition 2)."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from operator import attrgetter
from types import MappingProxyType
from typing import Annotated, Literal, NamedTuple, TypeAlias

from cfgplan.arguments import AtLeast, Natural, checked
from cfgplan.canonical import fields_of, refuse_duplicates, store_resources, store_sorted
from cfgplan.errors import InvalidValueError
from cfgplan.facts import check_requirement
from cfgplan.features import Feature, states
from cfgplan.qualities import Contribution, units
from cfgplan.selectors import check_selector

ALL = 0
"""The `count` of an input that takes every matching stream."""


ProgramFormat: TypeAlias = Literal["json", "msgpack"]
"""How a program that is a unit reads and writes messages."""
ContainerKind: TypeAlias = Literal["plain", "mt", "isolated"]
"""How a container of ROS 2 components runs them: in one thread, in several, or each by an executor of its own."""

DEFAULT_LABOR_US = 1_000_000
"""The labor of a transformation that declares none, in microseconds: a start is never free."""


@dataclass(frozen=True, slots=True, order=True)
@checked
class InputPort:
    """A named input of a transformation and the tag that it demands.

    Ports of one transformation in the same `distinct` group must be fed by different transformations. A `feedback` port
    may close a cycle of the wiring. A `service` input asks for replies: it may close a cycle too, and its elements
    start no step.

    An input takes `count` streams of different units; with ALL every matching stream of the other running units, and at
    least one. An `optional` one may stay unfed, which costs `worth_us` each second; if that is 0, only units that run
    anyway feed it, and nothing is started for it.

    For units that are ROS nodes, `type` is the message type, `remap` the name that the unit's code has for the port if
    it differs, and `qos` the quality of service that it asks for, such as `reliable transient_local`.
    """

    name: str
    tag: str
    distinct: str | None = states(default=None, limit="distinct")
    feedback: bool = False
    optional: bool = states(default=False, feature=Feature.OPTIONAL)
    worth_us: Natural = 0
    count: Natural = states(default=1, feature=Feature.COUNTS, limit="count")
    service: bool = False
    type: str | None = None
    remap: str | None = None
    qos: str | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "feedback", self.feedback or self.service)

    @property
    def is_usual(self) -> bool:
        """Whether it takes one stream, always."""
        return self.count == 1 and not self.optional

    @property
    def starts_nothing(self) -> bool:
        """Whether it is no reason for a unit to run."""
        return self.optional and not self.worth_us

    @property
    def is_told_apart(self) -> bool:
        """Whether two units may differ in how many streams they take there, or from which transformations."""
        return self.optional or self.distinct is not None or self.count == ALL

    def takes(self, number: int) -> bool:
        """Whether it may be fed by so many streams."""
        return (self.optional and not number) or (number > 0 if self.count == ALL else number == self.count)


@dataclass(frozen=True, slots=True, order=True)
@checked
class OutputPort:
    """A named output of a transformation and the tag that it offers.

    `quality` says how it contributes to each quality attribute. The stream has `rate_uhz` elements in a million
    seconds, of `size_bytes` each; their product determines the cost of carrying it between hosts. At most `serves`
    inputs and topics take it; None: any number. `type` and `remap` are as of an input, and `qos` is the quality of
    service on offer. `topic` is its topic for ROS 2 nodes outside of the run.
    """

    name: str
    tag: str
    quality: tuple[Contribution, ...] = ()
    rate_uhz: Natural = 0
    size_bytes: Natural = 0
    serves: Annotated[int, AtLeast(1)] | None = states(default=None, feature=Feature.LIMITS, limit="serves")
    type: str | None = None
    remap: str | None = None
    qos: str | None = None
    topic: str | None = None

    def __post_init__(self) -> None:
        if self.quality:
            store_sorted(self, "quality", self.quality, attrgetter("attribute"))
            refuse_duplicates(f"quality attribute of output {self.name!r}", [q.attribute for q in self.quality])

    @property
    def bytes_per_s(self) -> int:
        """The bytes per second of the stream, rounded up."""
        return -(-self.rate_uhz * self.size_bytes // 1_000_000)


CPU, MEMORY, POWER = "cpu", "memory", "power"
"""The resources of hosts that have units of their own, and no limit where a host does not say one."""


def amount_of(resource: str, amount: int) -> str:
    """An amount of a resource for people: `0.2 s of CPU time each second`, `300 MB of memory`, `1 gpu`."""
    if resource == CPU:
        return f"{units(amount):f} s of CPU time each second"
    return f"{amount} { {MEMORY: 'MB of memory', POWER: 'W of power'}.get(resource, resource) }"


START_MODES = ("all", "any", "aligned")
LEAST_HANG_S = 2
STATE_NAME = r"(?!([Tt]rue|TRUE|[Ff]alse|FALSE|[Nn]ull|NULL)$)[A-Za-z_][A-Za-z0-9_]*"
"""The name of a state; words that files take for other values are none."""


@dataclass(frozen=True, slots=True)
@checked
class RunOptions:
    """How the units of a transformation run; planning uses only `memory_mb`, and only with hosts.

    `start` is the condition of a step: `all` inputs fresh, `any` input, inputs `aligned` in time within `tolerance_us`,
    or a port's name. `rate_hz` is a source's. `queue` elements wait at each input; if it is full, the oldest is
    dropped, or the producer waits if it `blocks`. A unit that is silent for `hang_us` (0: it may be silent) or takes
    more than `memory_mb` megabytes is killed; so is one that does not end within `stop_us` of being told to (None: the
    runtime's default, 2 s). With `state`, a new unit continues with the last unit's state; transformations with the
    same name as `state` share it. A `lifecycle` node of ROS 2 is configured as a cold spare, and activated as a unit.
    A `container` of a ROS 2 component is the plain one of rclcpp, one with several threads (`mt`), or one that gives
    each component its own executor (`isolated`). A unit that is a program reads and writes messages in `format`.
    Raises InvalidValueError for a `hang_us` of less than 2 s.
    """

    start: str = "all"
    tolerance_us: Natural = 0
    rate_hz: Annotated[float, AtLeast(0)] | None = None
    queue: Annotated[int, AtLeast(1)] = 256
    blocks: bool = False
    hang_us: Natural | None = None
    memory_mb: Natural | None = None
    state: bool | str = False
    lifecycle: bool = False
    stop_us: Natural | None = None
    format: ProgramFormat = "json"
    container: ContainerKind = "plain"

    def __post_init__(self) -> None:
        if isinstance(self.state, str) and not re.fullmatch(STATE_NAME, self.state):
            raise InvalidValueError(f"{self.state!r} is no name of a state: letters, digits and underscores make one")
        if self.hang_us is not None and self.hang_us != 0 and self.hang_us < LEAST_HANG_S * 1_000_000:
            raise InvalidValueError(
                f"signs of life come once a second, and {self.hang_us / 1e6:g} s is too short to miss one: "
                f"allow {LEAST_HANG_S} s or more, or 0 for never"
            )


@dataclass(frozen=True)
@checked
class Transformation:
    """A streaming function that can be instantiated (Definition 2, section IV-A).

    `labor_us` is the CPU time of one start in microseconds (default: one second), `upkeep_us` the CPU time in
    microseconds that a running unit takes each second. Running units of a `pinned` transformation are kept even if no
    target needs them; a `required` one serves some target whenever that is possible (section V-C).

    If the environment has hosts, units run on `host`; if that is None, on one of `hosts`, or anywhere if that is empty.
    The host's labels and name must fit the selector `on` (such as `robot and not spot`). A unit takes the resources of
    `takes`: CPU time, memory and `needs`, integer amounts of other resources. On a host in `seen_us` a unit costs the
    labor and upkeep given there, instead of `labor_us` and `upkeep_us` adjusted by the host's speed.

    No unit, running or cold spare, may exist beside one of a transformation in `conflicts`, or on one host with one of
    a transformation in `conflicts_on_host`. On its host there runs a unit of each in `beside`. At least `min_instances`
    units run. There are at most `max_instances` units, and at most `per_host` on one host, cold spares included;
    without hosts all are on one. All hosts together that a selector in `at_most` chooses have at most so many, cold
    spares included. A cold spare takes `standby_us` each second; None: it has none. Units run only while facts meet the
    expression `requires`, such as `visibility >= 2.25 and not night`.
    """

    label: str
    inputs: tuple[InputPort, ...] = ()
    outputs: tuple[OutputPort, ...] = ()
    labor_us: Natural = DEFAULT_LABOR_US
    upkeep_us: Natural = 0
    pinned: bool = False
    required: bool = False
    source: str | None = None
    host: str | None = states(default=None, is_of_hosts=True)
    kind: str | None = None
    params: Mapping[str, object] = field(default_factory=dict, hash=False)
    run: RunOptions = RunOptions()
    hosts: tuple[str, ...] = states(default=(), limit="host", is_of_hosts=True)
    memory_mb: Natural | None = None
    conflicts: tuple[str, ...] = states(default=(), feature=Feature.CONFLICTS, limit="conflicts")
    min_instances: Natural = states(default=0, feature=Feature.INSTANCES, limit="min_instances")
    max_instances: Natural | None = states(
        default=None, feature=Feature.INSTANCES, limit="max_instances", limits_units=True
    )
    standby_us: Natural | None = None
    needs: Mapping[str, Natural] = states(default_factory=dict, hash=False, limit="needs")
    seen_us: Mapping[str, tuple[Natural, Natural]] = states(default_factory=dict, hash=False, is_of_hosts=True)
    per_host: Annotated[int, AtLeast(1)] | None = states(
        default=None, feature=Feature.INSTANCES, limit="per_host", limits_units=True, is_by_host=True
    )
    conflicts_on_host: tuple[str, ...] = states(
        default=(), feature=Feature.CONFLICTS, limit="conflicts: host", is_by_host=True
    )
    on: str | None = states(default=None, limit="on", is_of_hosts=True)
    beside: tuple[str, ...] = states(default=(), feature=Feature.BESIDE, limit="with")
    requires: str | None = None
    at_most: Mapping[str, Natural] = states(
        default_factory=dict,
        hash=False,
        feature=Feature.INSTANCES,
        limit="at_most",
        limits_units=True,
        is_by_host=True,
        is_of_hosts=True,
        shown=lambda most: [f"(at most {number} on {text})" for text, number in most.items()],
    )

    def __post_init__(self) -> None:
        store_sorted(self, "inputs", self.inputs, attrgetter("name"))
        store_sorted(self, "outputs", self.outputs, attrgetter("name"))
        refuse_duplicates(
            f"port of transformation {self.label!r}", [*(p.name for p in self.inputs), *(p.name for p in self.outputs)]
        )
        if self.inputs and self.run.rate_hz is not None:
            raise InvalidValueError(f"transformation {self.label!r} has inputs and a rate: only a source has a rate")
        if self.hosts or self.conflicts or self.conflicts_on_host or self.beside:
            for name in ("hosts", "conflicts", "conflicts_on_host", "beside"):
                store_sorted(self, name, getattr(self, name), str)
            refuse_duplicates(f"host of transformation {self.label!r}", list(self.hosts))
        if self.host is not None and self.hosts:
            raise InvalidValueError(f"transformation {self.label!r} has a host and a choice of hosts")
        if CPU in self.needs:
            raise InvalidValueError(f"transformation {self.label!r} needs cpu: what a unit takes is its upkeep")
        store_resources(self, "needs", {MEMORY: "memory_mb"})
        if self.max_instances is not None and self.max_instances < self.min_instances:
            raise InvalidValueError(f"transformation {self.label!r} asks for more instances than it allows")
        if self.at_most:
            store_resources(self, "at_most", {})
        for text in (*self.at_most, *(() if self.on is None else (self.on,))):
            check_selector(text)
        if self.requires is not None:
            check_requirement(self.requires)

    __getstate__ = fields_of

    @property
    def needs_mb(self) -> int:
        """The megabytes that a unit takes on its host: `memory_mb`, or else the most that it may take."""
        return (self.run.memory_mb or 0) if self.memory_mb is None else self.memory_mb

    @property
    def state_name(self) -> str | None:
        """The name of the state that a new unit continues with; None if units keep none."""
        state = self.run.state
        return state if isinstance(state, str) else self.label if state else None

    @cached_property
    def takes(self) -> Mapping[str, int]:
        """The resources of a unit on a host of speed 1: CPU in microseconds each second, megabytes, and its `needs`."""
        return MappingProxyType({CPU: self.upkeep_us, MEMORY: self.needs_mb, **self.needs})

    @cached_property
    def input(self) -> Mapping[str, InputPort]:
        """The input ports by name."""
        return MappingProxyType({port.name: port for port in self.inputs})

    @cached_property
    def needed_inputs(self) -> tuple[InputPort, ...]:
        """The inputs that are never unfed."""
        return tuple([port for port in self.inputs if not port.optional])

    @cached_property
    def idle_inputs(self) -> frozenset[str]:
        """The names of the inputs that start nothing."""
        return frozenset([port.name for port in self.inputs if port.starts_nothing])

    @cached_property
    def output(self) -> Mapping[str, OutputPort]:
        """The output ports by name."""
        return MappingProxyType({port.name: port for port in self.outputs})


class Statement(NamedTuple):
    """The place where an output states a quality attribute."""

    transformation: str
    output: str
    attribute: str

    def __str__(self) -> str:
        return f"{self.transformation}/{self.output} {self.attribute}"


def as_taught(transformation: Transformation, seen: Mapping[Statement, int]) -> Transformation:
    """The transformation as observed streams have taught it."""
    outputs = (
        replace(
            port,
            quality=tuple(
                each.taught(seen.get(Statement(transformation.label, port.name, each.attribute), 0))
                for each in port.quality
            ),
        )
        for port in transformation.outputs
    )
    return replace(transformation, outputs=tuple(outputs))
