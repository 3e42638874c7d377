"""Transformations, which make up the library, with their tagged ports (paper, section IV-A, Definition 2)."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass, field, replace
from functools import cached_property
from operator import attrgetter
from types import MappingProxyType
from typing import Annotated, Literal, NamedTuple, TypeAlias

from cfgplan.arguments import AtLeast, Natural, checked
from cfgplan.canonical import fields_of, refuse_duplicates, store_resources, store_sorted, unchecked
from cfgplan.errors import InvalidValueError
from cfgplan.facts import check_requirement
from cfgplan.qualities import Contribution, units
from cfgplan.rows import ALL, ELEMENT, MOST_IN_A_QUEUE, QOS, UNSAID, Feature, Row, Use, features, running
from cfgplan.selectors import check_selector

ProgramFormat: TypeAlias = Literal["json", "msgpack"]
"""How a program that is a unit reads and writes messages."""
ContainerKind: TypeAlias = Literal["plain", "mt", "isolated"]
"""How a container of ROS 2 components runs them: in one thread, in several, or each by an executor of its own."""

_MESSAGE_TYPE = Row(
    "in ROS: the message type of the topic, such as `nav_msgs/Odometry`", use=Use.RUNNING, xml="message"
)
_REMAP = Row("in ROS: the name of the topic or service in the node's code; the port's name if absent", use=Use.RUNNING)

MOST_INSTANCES = 64
"""A plan starts at most this many units of one transformation, or as many as one input takes streams."""
DEFAULT_LABOR_US = 1_000_000
"""The labor of a transformation that declares none, in microseconds: a start is never free."""


@dataclass(frozen=True, slots=True, order=True)
@checked
class InputPort:
    """An input of a transformation, by `name`, and the `tag` that it demands.

    Ports of one transformation in the same `distinct` group must be fed by different transformations. A `feedback` port
    may close a cycle of the wiring. A `service` input asks for replies: it may close a cycle too, and its elements
    start no step.

    An input takes `count` streams of different units; with ALL every matching stream of the other running units, and at
    least one. An `optional` one may stay unfed, which costs `worth_us` microseconds of CPU time each second; if that is
    0, only units that run anyway feed it, and nothing is started for it.

    For units that are ROS nodes, `type` is the message type, `remap` the name that the unit's code has for the port if
    it differs, and `qos` the quality of service that it asks for, such as `reliable transient_local`.
    """

    name: str
    tag: Annotated[
        str,
        Row(
            "the information that the input needs: a concept in description logic, or the paper's P(a)",
            form="TagText",
            xml=ELEMENT,
        ),
    ]
    distinct: Annotated[
        str | None,
        Row(
            "the name of a group of inputs, which must be fed by different transformations; in no group if absent",
            is_limit=True,
        ),
    ] = None
    feedback: Annotated[bool, Row("true: this input may close a cycle of streams")] = False
    optional: Annotated[
        bool,
        Row(
            "true: the input may stay unfed; only units that run anyway feed it, unless it has a `worth`",
            feature=Feature.OPTIONAL,
        ),
    ] = False
    worth_us: Annotated[Natural, Row("how many CPU seconds per second it is worth to feed this optional input")] = 0
    count: Annotated[
        Natural,
        Row(
            "the number of streams, each of another unit, that feed the input; `all`: every stream that matches",
            form="Count",
            feature=Feature.COUNTS,
            is_limit=True,
        ),
    ] = 1
    service: Annotated[
        bool,
        Row(
            "`stream`, or `service` for the replies of a service, which start no step and may close a cycle",
            key="kind",
            form="InputKind",
            below="worth",
        ),
    ] = False
    type: Annotated[str | None, _MESSAGE_TYPE] = None
    remap: Annotated[str | None, _REMAP] = None
    qos: Annotated[str | None, QOS] = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "feedback", self.feedback or self.service)

    @property
    def is_usual(self) -> bool:
        """Whether it needs exactly one stream."""
        return self.count == 1 and not self.optional

    @property
    def starts_nothing(self) -> bool:
        """Whether it is no reason for a unit to run."""
        return self.optional and not self.worth_us

    @property
    def is_explicit(self) -> bool:
        """Whether two units may differ in how many streams they take there, or from which transformations."""
        return self.optional or self.distinct is not None or self.count == ALL

    def takes(self, number: int) -> bool:
        """Whether it may be fed by so many streams."""
        return (self.optional and not number) or (number > 0 if self.count == ALL else number == self.count)


@dataclass(frozen=True, slots=True, order=True)
@checked
class OutputPort:
    """An output of a transformation, by `name`, and the `tag` that it offers.

    `quality` says how it contributes to each quality attribute. The stream has `rate_uhz` elements in a million
    seconds, of `size_bytes` each; their product determines the cost of carrying it between hosts. At most `serves`
    inputs and topics take it; None: any number. `type` and `remap` are as of an input, and `qos` is the quality of
    service on offer. `topic` is its topic for ROS 2 nodes outside of the run.
    """

    name: str
    tag: Annotated[
        str,
        Row(
            "the information that the output has: a concept in description logic, or the paper's P(a)",
            form="TagText",
            xml=ELEMENT,
        ),
    ]
    quality: Annotated[
        tuple[Contribution, ...],
        Row(
            "what the output adds to the quality of its stream: quality attribute to a number, or to a mapping",
            form="dict[Name, QualityGiven]",
            xml=UNSAID,
        ),
    ] = ()
    rate_uhz: Annotated[
        Natural,
        Row(
            "elements per second; with `size` it gives the cost of sending the stream to other hosts",
            form="PositiveMicro",
        ),
    ] = 0
    size_bytes: Annotated[Natural, Row("the size of one element in bytes")] = 0
    serves: Annotated[
        Annotated[int, AtLeast(1)] | None,
        Row(
            "the largest number of inputs and topics that its stream may feed; any number if absent",
            most=MOST_IN_A_QUEUE,
            feature=Feature.LIMITS,
            is_limit=True,
        ),
    ] = None
    type: Annotated[str | None, _MESSAGE_TYPE] = None
    remap: Annotated[str | None, _REMAP] = None
    qos: Annotated[str | None, QOS] = None
    topic: Annotated[
        str | None,
        Row(
            "in ROS 2: the topic on which nodes outside of the run can get the stream; none if absent", use=Use.RUNNING
        ),
    ] = None

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

    start: Annotated[
        str,
        Row(
            "when a step starts: `all`: each input has a new element; `any`: one input has; `aligned`: the inputs have "
            "elements of one time; PORT: this input has",
            form="PortName",
            use=Use.RUNNING,
        ),
    ] = "all"
    tolerance_us: Annotated[
        Natural,
        Row(
            "with `start: aligned`: how many seconds the elements of a step may be apart",
            form="Seconds",
            use=Use.RUNNING,
        ),
    ] = 0
    rate_hz: Annotated[
        Annotated[float, AtLeast(0)] | None,
        Row(
            "for a source: elements per second; as fast as its code gives them if absent", form="Rate", use=Use.RUNNING
        ),
    ] = None
    queue: Annotated[
        Annotated[int, AtLeast(1)],
        Row("the largest number of elements that may wait at an input", most=MOST_IN_A_QUEUE, use=Use.RUNNING),
    ] = 256
    blocks: Annotated[
        bool,
        Row(
            "if an input's queue is full: `drop_oldest`, or `block`, which lets the producer wait",
            key="when_full",
            form="WhenFull",
            use=Use.RUNNING,
        ),
    ] = False
    hang_us: Annotated[
        Natural | None,
        Row(
            "the unit is killed after this many seconds without a sign of life: 2 or more; 0: never; 10 if absent",
            form="HangTime",
            use=Use.RUNNING,
        ),
    ] = None
    memory_mb: Annotated[
        Natural | None,
        Row(
            "the unit is killed if it takes more than this many megabytes; no limit if absent",
            least=1,
            most=MOST_IN_A_QUEUE,
            use=Use.BOTH,
        ),
    ] = None
    state: Annotated[
        bool | str,
        Row(
            "true: a new unit continues with the state of the old one; NAME: with the last state saved under NAME",
            form="StateName",
            use=Use.RUNNING,
        ),
    ] = False
    lifecycle: Annotated[
        bool,
        Row(
            "true: this ROS 2 node has a lifecycle; its cold spares are configured, and activated when they are needed",
            use=Use.RUNNING,
        ),
    ] = False
    stop_us: Annotated[
        Natural | None,
        Row(
            "how long a unit may take to end, such as 500ms, before it is killed; 2s if absent",
            form="TimeSpan",
            below="hang",
            use=Use.RUNNING,
        ),
    ] = None
    format: Annotated[
        ProgramFormat,
        Row("for a program: `json`, lines of JSON, or `msgpack`, frames of msgpack", use=Use.RUNNING, below="stop"),
    ] = "json"
    container: Annotated[
        ContainerKind,
        Row(
            "for a ROS 2 component: its container: `plain`, `mt` with several threads, or `isolated`, an executor for "
            "each component",
            use=Use.RUNNING,
        ),
    ] = "plain"

    def __post_init__(self) -> None:
        if isinstance(self.state, str) and not re.fullmatch(STATE_NAME, self.state):
            raise InvalidValueError(f"{self.state!r} can't name a state: write letters, digits and underscores")
        if self.hang_us is not None and self.hang_us != 0 and self.hang_us < LEAST_HANG_S * 1_000_000:
            raise InvalidValueError(
                f"signs of life come once a second, and {self.hang_us / 1e6:g} s is too short to miss one: "
                f"allow {LEAST_HANG_S} s or more, or 0 for never"
            )


@dataclass(frozen=True)
@checked
class Transformation:
    """A streaming function that can be instantiated (Definition 2, section IV-A), identified by its `label`.

    `inputs` and `outputs` are its ports. `source` names its code (such as `units.py:Camera`), whose constructor gets
    `params`; `run` says how its units run, and `kind` is the label of the template that it was made from.
    `labor_us` is the CPU time of one start in microseconds (default: one second), `upkeep_us` the CPU time in
    microseconds that a running unit takes each second. Running units of a `pinned` transformation are kept even if no
    target needs them; a `required` one serves some target whenever that is possible (section V-C).

    If the environment has hosts, units run on `host`; if that is None, on one of `hosts`, or anywhere if that is empty.
    The host's labels and name must fit the selector `on` (such as `robot and not spot`). A unit takes the resources of
    `takes`: CPU time, `memory_mb` megabytes, and `needs`, integer amounts of other resources. On a host in `seen_us` a
    unit costs the labor and upkeep given there, instead of `labor_us` and `upkeep_us` adjusted by the host's speed.

    No unit, running or cold spare, may exist beside one of a transformation in `conflicts`, or on one host with one of
    a transformation in `conflicts_on_host`. On its host there runs a unit of each in `beside`. At least `min_instances`
    units run. There are at most `max_instances` units, and at most `per_host` on one host, cold spares included;
    without hosts all units count as on one. `at_most` limits the units, cold spares included, on all hosts together
    that a selector chooses. A cold spare takes `standby_us` each second; None: it can't be one. Units run only while
    facts meet the expression `requires`, such as `visibility >= 2.25 and not night`.
    """

    label: Annotated[
        str,
        Row(
            "the name of the transformation; unique; contains every template variable of the transformation",
            use=Use.BOTH,
            xml=ELEMENT,
        ),
    ]
    inputs: Annotated[
        tuple[InputPort, ...],
        Row(
            "input ports: name to tag, or to a mapping; none if absent",
            form="dict[PortName, InputGiven]",
            xml=ELEMENT,
            below="run",
        ),
    ] = ()
    outputs: Annotated[
        tuple[OutputPort, ...],
        Row(
            "output ports: name to tag, or to a mapping; none if absent",
            form="dict[PortName, OutputGiven]",
            xml=ELEMENT,
            below="inputs",
        ),
    ] = ()
    labor_us: Annotated[
        Natural, Row("CPU seconds of one start; `labor` of `defaults` if absent", absent=None, below="params")
    ] = DEFAULT_LABOR_US
    upkeep_us: Annotated[
        Natural,
        Row(
            "CPU seconds per second of a running unit: 0.05 is 5 % of a core; `upkeep` of `defaults` if absent",
            absent=None,
            below="labor",
        ),
    ] = 0
    _: KW_ONLY
    source: Annotated[
        str | None,
        Row(
            "the unit code: package.module:Class, units.py:Class relative to this file, or program:./FILE; in ROS "
            "node:PACKAGE/EXECUTABLE and other forms; needed for a run",
            use=Use.RUNNING,
            xml=ELEMENT,
        ),
    ] = None
    kind: Annotated[
        str | None, Row("free text for people, the paper's type attribute", use=Use.RUNNING, xml="type")
    ] = None
    host: Annotated[
        str | None,
        Row(
            "the host that its units run on, or a list to choose from; any host if absent",
            form="OneOrMoreNames",
            use=Use.BOTH,
            xml="host",
            is_of_hosts=True,
        ),
    ] = None
    hosts: Annotated[tuple[str, ...], Row(key="host", is_limit=True, is_of_hosts=True)] = ()
    on: Annotated[
        str | None,
        Row(
            "the hosts that its units may run on: an expression such as `robot and not spot`; any host if absent",
            form="SelectorText",
            is_limit=True,
            is_of_hosts=True,
        ),
    ] = None
    params: Annotated[
        Mapping[str, object],
        Row(
            "the parameters of its unit code: name to value; none if absent",
            form="Params",
            use=Use.RUNNING,
            absent={},
            xml=ELEMENT,
        ),
    ] = field(default_factory=dict, hash=False)
    requires: Annotated[
        str | None,
        Row(
            "when its units may run: an expression over facts, such as `depth >= 2 and not night`; always if absent",
            form="RequirementText",
            xml=UNSAID,
        ),
    ] = None
    pinned: Annotated[bool, Row("true: keep its running units even if no target needs them")] = False
    required: Annotated[bool, Row("true: use it if any valid plan can use it")] = False
    memory_mb: Annotated[
        Natural | None,
        Row("megabytes that a unit takes on its host; `memory` of `run` if absent, else 0", most=MOST_IN_A_QUEUE),
    ] = None
    needs: Annotated[
        Mapping[str, Natural],
        Row(
            "other resources of its host that a unit takes: name to amount, a whole number; none if absent",
            is_limit=True,
        ),
    ] = field(default_factory=dict, hash=False)
    beside: Annotated[
        tuple[str, ...],
        Row(
            "labels of transformations; wherever a unit of this one runs, a unit of each runs too; none if absent",
            key="with",
            feature=Feature.BESIDE,
            is_limit=True,
        ),
    ] = ()
    conflicts: Annotated[
        tuple[str, ...],
        Row(
            "labels of transformations whose units may not run together with its units; none if absent",
            form="ConflictsGiven",
            feature=Feature.CONFLICTS,
            is_limit=True,
        ),
    ] = ()
    conflicts_on_host: Annotated[
        tuple[str, ...], Row(key="conflicts: host", feature=Feature.CONFLICTS, is_limit=True, is_by_host=True)
    ] = ()
    min_instances: Annotated[
        Natural,
        Row("the smallest number of its units that run", most=MOST_INSTANCES, feature=Feature.INSTANCES, is_limit=True),
    ] = 0
    max_instances: Annotated[
        Natural | None,
        Row(
            "the largest number of its units, spares included; if absent, any number may run, plans mostly start one",
            feature=Feature.INSTANCES,
            is_limit=True,
            limits_units=True,
        ),
    ] = None
    per_host: Annotated[
        Annotated[int, AtLeast(1)] | None,
        Row(
            "the largest number of its units on one host, spares included; no limit if absent",
            feature=Feature.INSTANCES,
            is_limit=True,
            limits_units=True,
            is_by_host=True,
        ),
    ] = None
    at_most: Annotated[
        Mapping[str, Natural],
        Row(
            "selector of hosts to the largest number of its units on all of these hosts together; no limit if absent",
            form="dict[SelectorText, AtMost]",
            feature=Feature.INSTANCES,
            is_limit=True,
            limits_units=True,
            is_by_host=True,
            is_of_hosts=True,
            shown=lambda most: [f"(at most {number} on {text})" for text, number in most.items()],
        ),
    ] = field(default_factory=dict, hash=False)
    standby_us: Annotated[
        Natural | None,
        Row("CPU seconds per second of a cold spare, which does not run; it has no cold spares if absent"),
    ] = None
    run: Annotated[
        RunOptions,
        Row(
            "how its units run: a mapping; the defaults below if absent",
            form="RunPart",
            use=Use.BOTH,
            absent=None,
            xml=ELEMENT,
        ),
    ] = RunOptions()
    seen_us: Annotated[Mapping[str, tuple[Natural, Natural]], Row(use=Use.NONE, is_of_hosts=True)] = field(
        default_factory=dict, hash=False
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
    def features(self) -> frozenset[Feature]:
        """The features that it and its ports ask for."""
        of_ports = features(InputPort, self.inputs) | features(OutputPort, self.outputs)
        return features(Transformation, [self]) | of_ports

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
    def distinct_groups(self) -> tuple[tuple[InputPort, ...], ...]:
        """The groups of inputs that must be fed by different transformations, without optional ones.

        An input that takes several streams is repeated under different names.
        """
        groups: dict[str, list[InputPort]] = {}
        for port in self.inputs:
            if port.distinct is not None and not port.optional:
                several = [replace(port, name=f"{port.name} ({n})", count=1) for n in range(1, port.count + 1)]
                groups.setdefault(port.distinct, []).extend(several if len(several) > 1 else [port])
        return tuple([tuple(group) for _, group in sorted(groups.items()) if len(group) > 1])

    @cached_property
    def idle_inputs(self) -> frozenset[str]:
        """The names of the inputs that start nothing."""
        return frozenset([port.name for port in self.inputs if port.starts_nothing])

    @cached_property
    def output(self) -> Mapping[str, OutputPort]:
        """The output ports by name."""
        return MappingProxyType({port.name: port for port in self.outputs})


_UNBOUND = frozenset(
    ("label", "inputs", "outputs", "labor_us", "upkeep_us", "source", "kind", "params", "pinned", "required")
)
"""The fields of a transformation that only their types and the names of ports limit."""


def transformation_of(said: Mapping[str, object]) -> Transformation:
    """Return the transformation with these fields; `inputs` and `outputs` are in order, and their names differ.

    The values must have the right types, as a file's reader makes sure. Fields that limit each other are checked.
    """
    return unchecked(Transformation, said) if said.keys() <= _UNBOUND else Transformation(**said)  # type: ignore[arg-type]


def running_fields(transformation: Transformation) -> tuple[object, ...]:
    """Return the ports and all fields that affect a running unit: if they are equal, so is how the units run."""
    ports = [(port.name, *running(port)) for port in transformation.inputs]
    ports += [(port.name, *running(port)) for port in transformation.outputs]
    observed = [
        (port.name, stated.attribute, *running(stated))
        for port in transformation.outputs
        for stated in port.quality
        if stated.observe is not None
    ]
    return *running(transformation), *ports, *observed, len(transformation.inputs)


class Statement(NamedTuple):
    """The place where an output states a quality attribute; with a `host`, for units on this host."""

    transformation: str
    output: str
    attribute: str
    host: str | None = None

    def __str__(self) -> str:
        where = f" on {self.host}" if self.host is not None else ""
        return f"{self.transformation}/{self.output} {self.attribute}{where}"


def as_taught(transformation: Transformation, learned: Mapping[Statement, Mapping[str | None, int]]) -> Transformation:
    """Return the transformation with its learned qualities. `learned` has the deviations by host, in micro-units, for
    each statement without its host.
    """
    outputs = (
        replace(
            port,
            quality=tuple(
                each.taught(learned.get(Statement(transformation.label, port.name, each.attribute), {}))
                for each in port.quality
            ),
        )
        for port in transformation.outputs
    )
    return replace(transformation, outputs=tuple(outputs))
