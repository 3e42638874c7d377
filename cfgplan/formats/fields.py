"""The environment file's fields, a row each, from which readers, checks, writers and the JSON Schema are derived.

A row has the key, its values, their meaning and the default; `to`, the attribute of the domain's value (the key if
absent); `use`, the part of cfgplan that reads it; and `xml`, the attribute of the XML format (the key if absent). XML
refuses a value that is no text, number or flag, unless it is an ELEMENT. It leaves out an UNSAID value, which means
nothing without a refused one. Every text of a transformation or a target may hold template variables.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from enum import Flag
from functools import cache
from typing import Annotated, Any, ClassVar, Final, Literal, get_args, get_origin, get_type_hints

from pydantic import BaseModel, ConfigDict, Discriminator, Field, Tag, WithJsonSchema

from cfgplan.domain import Transformation
from cfgplan.formats.schema_values import (
    FULL_FORM,
    LARGEST_AMOUNT,
    SHORT_FORM,
    BetterName,
    Cost,
    Count,
    Fact,
    FileList,
    FileName,
    HangTime,
    Horizon,
    InputKind,
    Micro,
    Name,
    Names,
    NoiseText,
    Objectives,
    Params,
    PortName,
    PositiveMicro,
    QosText,
    Rate,
    RequirementText,
    Resources,
    RuleName,
    Seconds,
    SelectorText,
    Selects,
    Speed,
    StateName,
    StreamName,
    StreamNames,
    Survived,
    TagText,
    TimeSpan,
    WhenFull,
    Whole,
    Written,
    form_of,
    list_or_mapping,
)
from cfgplan.planning import MOST_INSTANCES
from cfgplan.qualities import QualityRule
from cfgplan.transformations import ContainerKind, ProgramFormat

FORMAT: Final = "cfgplan/1"
LONGEST_QUEUE = 1_000_000
MOST_COPIES = 1000

DEFAULT_HORIZON_S = 600
DEFAULT_UPKEEP_US = 0

_SHORT, _FULL, _CHOICE = Tag(SHORT_FORM), Tag(FULL_FORM), Discriminator(form_of)
ELEMENT = "<>"
UNSAID = ""
_FIRST_IN_XML = ("type", "labor", "upkeep")
IGNORE = "ignore"


def as_it_is(value: Any) -> Any:
    """The plain form of a text, number or flag; lists for tuples."""
    return list(value) if isinstance(value, tuple) else dict(value) if isinstance(value, Mapping) else value


class Use(Flag):
    """The readers of a field: a change of its value makes saved plans stale (PLANNING), or restarts units (RUNNING)."""

    NONE = 0
    PLANNING = 1
    RUNNING = 2
    BOTH = 3


@dataclass(frozen=True, slots=True)
class FieldRow:
    """A field as readers and writers need it.

    `plain` turns the domain's value into the file's. A field that `selects` has selectors of hosts.
    """

    to: str
    use: Use
    xml: str | None
    default: Any
    is_text: bool
    plain: Callable[[Any], Any]
    selects: bool


@dataclass(frozen=True, slots=True)
class _Said:
    to: str = ""
    use: Use | None = None
    xml: str | None = None


_IN_SCHEMA = {"ge": "minimum", "le": "maximum"}
"""The limits of a number that pydantic forgets in the schema, where a validator of ours comes first."""


def row(
    meaning: str, default: Any = None, to: str = "", use: Use | None = None, xml: str | None = None, **limits: Any
) -> Any:
    """A field of a part. With `...` as default the key can't be absent."""
    in_schema: Any = {_IN_SCHEMA[name]: limit for name, limit in limits.items() if name in _IN_SCHEMA}
    more = {"json_schema_extra": in_schema} if in_schema else {}
    field = Field(default=default, description=meaning, **more, **limits)
    field.metadata.append(_Said(to, use, xml))
    return field


_IS_SAID: Final[Any] = {"not": {"type": "null"}}
_IS_UNSAID: Final[Any] = {"type": "null"}
_ZERO: Final = {"const": 0}
_ABOVE_0: Final = {"exclusiveMinimum": 0}
_IS_TRUE: Final = {"const": True}


def _either(*forms: Mapping[str, Any]) -> ConfigDict:
    """The JSON Schema of keys that go together or do not, in any of some forms; readers check it in words."""
    of_forms: list[Any] = [
        {"required": [key for key, said in form.items() if said not in (_IS_UNSAID, _ZERO)], "properties": {**form}}
        for form in forms
    ]
    return ConfigDict(json_schema_extra={"anyOf": of_forms})


class Part(BaseModel):
    """A mapping in the file, and its fields."""

    model_config = ConfigDict(extra="forbid", strict=True, defer_build=True)
    USUAL_USE: ClassVar[Use] = Use.PLANNING

    @classmethod
    @cache
    def rows(cls) -> Mapping[str, FieldRow]:
        """The rows by key, in the order in which they are written."""
        hints = get_type_hints(cls, include_extras=True)
        return {key: _row(cls, key, [*_pieces(hints[key])], selects=_selects(hints[key])) for key in cls.model_fields}

    @classmethod
    @cache
    def attributes(cls) -> Mapping[str, str]:
        """The keys by attribute of the XML format; the paper's attributes and the costs come first."""
        found = {row.xml: key for key, row in cls.rows().items() if row.xml not in (None, ELEMENT, UNSAID)}
        return {str(name): found[name] for name in sorted(found, key=lambda name: name not in _FIRST_IN_XML)}

    @classmethod
    def plain(cls, key: str, value: object) -> Any:
        """Return the plain form of a domain's value for a key of the file; None if it is the default."""
        row = cls.rows()[key]
        own = getattr(value, row.to)
        plain = None if own is None else row.plain(own)
        return None if plain == row.default or plain in ([], {}) else plain

    @classmethod
    def written(cls, value: object, **said: Any) -> dict[str, Any]:
        """A domain's value as a file writes it, without defaults.

        `said` has the plain values of keys that are not just one attribute of it; None and empty ones are left out.
        """
        found = ((key, said[key] if key in said else cls.plain(key, value)) for key in cls.rows())
        return {key: plain for key, plain in found if plain is not None and plain not in ([], {})}

    def values(self) -> dict[str, Any]:
        """The file's values, under the domain's names."""
        rows = self.rows()
        said = ((rows[key].to, getattr(self, key)) for key in self.model_fields_set)
        return {to: _frozen(value) for to, value in said if value is not None}


def _frozen(value: Any) -> Any:
    """A tuple for a list. Template variables may have made two of its entries one."""
    return tuple(dict.fromkeys(value)) if isinstance(value, list) else value


def _row(part: type[Part], key: str, pieces: list[Any], *, selects: bool) -> FieldRow:
    field = part.model_fields[key]
    said = next((each for each in field.metadata if isinstance(each, _Said)), _Said())
    holds_more = any(piece in (list, dict) or (isinstance(piece, type) and issubclass(piece, Part)) for piece in pieces)
    return FieldRow(
        to=said.to or key,
        use=part.USUAL_USE if said.use is None else said.use,
        xml=key if said.xml is None and not holds_more else said.xml,
        default=field.default,
        is_text=any(piece is str or isinstance(piece, str) for piece in pieces)
        and not any(piece is bool or piece == 0 for piece in pieces),
        plain=next((piece.plain for piece in pieces if isinstance(piece, Written)), as_it_is),
        selects=selects,
    )


def _selects(hint: Any) -> bool:
    """Whether a type has texts that choose hosts, perhaps as the keys of a mapping."""
    return isinstance(hint, Selects) or any(map(_selects, get_args(hint)))


def _pieces(hint: Any) -> Iterator[Any]:
    """Yield the parts of a type: its plain types, the values of its literals, and its annotations."""
    if get_origin(hint) in (list, dict):
        yield get_origin(hint)
    elif get_args(hint):
        for piece in get_args(hint):
            yield from _pieces(piece)
    else:
        yield hint


_MESSAGE_TYPE = "in ROS: the message type, such as `nav_msgs/Odometry`"
_QOS = (
    "in ROS 2: the quality of service, such as `best_effort` or `reliable transient_local deadline=0.1`; "
    "`cfgplan check` names pairs that it keeps apart"
)
_REMAP = "in ROS: the node's own name of the topic or service; the port's name if absent"


class InputPart(Part):
    """An input port that needs more than a tag."""

    model_config = _either({"worth": _ZERO}, {"optional": _IS_TRUE})

    tag: TagText = row(
        "the information it needs: a concept in description logic, or the paper's P(a)", ..., xml=ELEMENT
    )
    distinct: Name | None = row("name of a group of ports; the ports of a group are fed by different transformations")
    feedback: bool = row("this input may close a cycle of the wiring", False)
    optional: bool = row("it may stay unfed; it is fed by units that run anyway, and starts none", False)
    worth: Cost = row("feeding this optional input is worth so many CPU seconds per second", 0, "worth_us")
    kind: InputKind = row("a service's replies start no step, and may close a cycle", "stream", "service")
    count: Count = row("number of streams, of different units, that feed it; `all`: every stream that matches", 1)
    type: Name | None = row(_MESSAGE_TYPE, use=Use.RUNNING, xml="message")
    remap: Name | None = row(_REMAP, use=Use.RUNNING)
    qos: QosText | None = row(_QOS, use=Use.RUNNING)


class CurvePart(Part):
    """A value that follows a fact of the world: straight lines between points, level beyond the ends."""

    by: Name = row("the fact, a number", ...)
    points: list[Annotated[list[Micro], Field(min_length=2, max_length=2)]] = row(
        "two or more pairs of a value of the fact and the resulting value, by rising value of the fact",
        ...,
        min_length=2,
    )


MicroGiven = Annotated[Annotated[Micro, _SHORT] | Annotated[CurvePart, _FULL], _CHOICE]
PositiveGiven = Annotated[Annotated[PositiveMicro, _SHORT] | Annotated[CurvePart, _FULL], _CHOICE]


class ContributionPart(Part):
    """The contribution of an output to a quality attribute: exactly one of `add`, `limit`, `scale` and `set`."""

    model_config = _either(*(dict.fromkeys(QualityRule, _IS_UNSAID) | {rule: _IS_SAID} for rule in QualityRule))

    add: MicroGiven | None = row("added to the value of the inputs")
    limit: PositiveGiven | None = row("the value is no better than this")
    scale: PositiveGiven | None = row("a factor on the value of the inputs")
    set: PositiveGiven | None = row("the value, whatever the inputs are")
    of: Literal["worst", "best", "mean", "sum"] = row("how several inputs count", "worst")
    observe: Name | None = row(
        "the field in which an element says its quality; `pose.error` is a nested field, `covariance.0` a list's value",
        use=Use.RUNNING,
    )


QualityGiven = Annotated[Annotated[Micro, _SHORT] | Annotated[ContributionPart, _FULL], _CHOICE]


class OutputPart(Part):
    """An output port that says more than a tag."""

    tag: TagText = row(
        "the information it gives: a concept in description logic, or the paper's P(a)", ..., xml=ELEMENT
    )
    quality: dict[Name, QualityGiven] | None = row(
        "quality attribute to its contribution: a number, or a mapping", xml=UNSAID
    )
    rate: PositiveMicro = row("elements per second; with `size`, for the cost of streams between hosts", 0, "rate_uhz")
    size: Whole = row("bytes of one element", 0, "size_bytes", ge=0, le=LARGEST_AMOUNT)
    serves: Whole | None = row("the most inputs and topics that its stream may feed", ge=1, le=LONGEST_QUEUE)
    type: Name | None = row(_MESSAGE_TYPE, use=Use.RUNNING, xml="message")
    remap: Name | None = row(_REMAP, use=Use.RUNNING)
    qos: QosText | None = row(_QOS, use=Use.RUNNING)
    topic: Name | None = row(
        "in ROS 2: the topic for nodes outside of the run, published while one subscribes", use=Use.RUNNING
    )


InputGiven = Annotated[Annotated[TagText, _SHORT] | Annotated[InputPart, _FULL], _CHOICE]
OutputGiven = Annotated[Annotated[TagText, _SHORT] | Annotated[OutputPart, _FULL], _CHOICE]
OneOrMoreNames = Annotated[Annotated[Name, _SHORT] | Annotated[Names, _FULL], _CHOICE]
OneOrMoreStreams = Annotated[Annotated[StreamName, _SHORT] | Annotated[StreamNames, _FULL], _CHOICE]
_AT_MOST: Final = {"type": "integer", "minimum": 0, "maximum": LARGEST_AMOUNT}
AtMost = Annotated[Whole, Field(ge=0, le=LARGEST_AMOUNT), WithJsonSchema(_AT_MOST)]
FileNames = Annotated[Annotated[FileName, _SHORT] | Annotated[FileList, _FULL], _CHOICE]
Imports = Annotated[Annotated[Literal["ignore"], _SHORT] | Annotated[dict[Name, FileName], _FULL], _CHOICE]


class RunPart(Part):
    """How the units of a transformation run."""

    USUAL_USE = Use.RUNNING

    start: PortName = row(
        "what starts a step: `all` inputs fresh, `any` input, inputs `aligned` in time, or a port's name", "all"
    )
    tolerance: Seconds = row(
        "the largest difference between the times of aligned inputs, in seconds", 0, "tolerance_us"
    )
    rate: Rate | None = row("elements per second of a source, which has no inputs", to="rate_hz")
    queue: Whole = row("how many elements may wait at an input", 256, ge=1, le=LONGEST_QUEUE)
    when_full: WhenFull = row("drop the oldest element, or let the producer wait", "drop_oldest", "blocks")
    hang: HangTime | None = row(
        "seconds of silence after which a unit is killed, at least 2; 0: never; 10 if absent", to="hang_us"
    )
    stop: TimeSpan | None = row(
        "time for a unit to end after it was told to, such as 500ms; then it is killed; 2s if absent", to="stop_us"
    )
    format: ProgramFormat = row("how a program reads and writes: lines of JSON, or frames of msgpack", "json")
    memory: Whole | None = row(
        "the most memory that a unit may take, in megabytes", None, "memory_mb", Use.BOTH, ge=1, le=LONGEST_QUEUE
    )
    state: StateName = row(
        "true: a new unit continues with the state of the last one; a name: with the last state under this name", False
    )
    lifecycle: bool = row("cold spares of this ROS 2 node are configured, and activated when they are needed", False)
    container: ContainerKind = row(
        "the container of this ROS 2 component: rclcpp's plain one, one with several threads (`mt`), or one that runs"
        " each component by itself (`isolated`)",
        "plain",
    )


class ConflictsPart(Part):
    """Transformations that a transformation may not be together with."""

    host: Names | None = row("none of their units may run on a host with a unit of it", to="conflicts_on_host")
    system: Names | None = row(
        "none of their units may run together with a unit of it; `conflicts: [A, B]` means these", to="conflicts"
    )


ConflictsGiven = Annotated[Annotated[Names, _SHORT] | Annotated[ConflictsPart, _FULL], Discriminator(list_or_mapping)]


_RATE_OR_INPUTS: Final[Any] = [
    {"properties": {"inputs": {"anyOf": [_IS_UNSAID, {"maxProperties": 0}]}}},
    {"properties": {"run": {"properties": {"rate": _IS_UNSAID}}}},
]
"""Only a source has a rate; readers check it in words."""


class TransformationPart(Part):
    """A streaming function that can be instantiated; `${Class}` in it stands for each individual of a class."""

    model_config = ConfigDict(json_schema_extra={"anyOf": _RATE_OR_INPUTS})

    label: Name = row("unique; mentions every template variable of the transformation", ..., use=Use.BOTH, xml=ELEMENT)
    source: Name | None = row(
        "package.module:Class, units.py:Class relative to this file, or program:./FILE; in ROS node:PACKAGE/EXECUTABLE "
        "and others",
        use=Use.RUNNING,
        xml=ELEMENT,
    )
    kind: Name | None = row("free text, the paper's type attribute", use=Use.RUNNING, xml="type")
    host: OneOrMoreNames | None = row("where its units run: a host, or a list to choose from", use=Use.BOTH, xml="host")
    on: SelectorText | None = row("the hosts that its units may run on: an expression such as `robot and not spot`")
    params: Params = row("the parameters of its unit code", {}, use=Use.RUNNING, xml=ELEMENT)
    labor: Cost | None = row("CPU seconds of one start", to="labor_us")
    upkeep: Cost | None = row("CPU seconds that a running unit takes per second", to="upkeep_us")
    requires: RequirementText | None = row(
        "its units run only while facts meet it: an expression such as `visibility >= 2.25 and not night`", xml=UNSAID
    )
    pinned: bool = row("running units are kept even where no target needs them", False)
    required: bool = row("must be used if any valid plan can use it", False)
    memory: Whole | None = row(
        "megabytes that a unit takes on its host; run.memory if absent", None, "memory_mb", ge=0, le=LONGEST_QUEUE
    )
    needs: Resources | None = row("amounts of other resources of its host that a unit takes, by name: whole numbers")
    # `with` is a word of Python's, so that it can't be written as the others are.
    __annotations__["with"] = "Names | None"
    locals()["with"] = row(
        "transformations: on each host where a unit of it runs, a unit of each of these runs too", to="beside"
    )
    conflicts: ConflictsGiven | None = row("transformations whose units may not run together with its units")
    min_instances: Whole = row("the least number of its units that run", 0, ge=0, le=MOST_INSTANCES)
    max_instances: Whole | None = row("the most units of it, spares included", ge=0, le=LARGEST_AMOUNT)
    per_host: Whole | None = row("the most units of it on one host", ge=1, le=LARGEST_AMOUNT)
    at_most: dict[SelectorText, AtMost] | None = row(
        "the most units of it on all hosts together that a selector chooses: selector to number"
    )
    standby: Cost | None = row("CPU seconds per second of a spare that does not run", to="standby_us")
    run: RunPart | None = row("how its units run", use=Use.BOTH, xml=ELEMENT)
    inputs: dict[PortName, InputGiven] | None = row("input ports: name to tag", xml=ELEMENT)
    outputs: dict[PortName, OutputGiven] | None = row("output ports: name to tag", xml=ELEMENT)


class UnitPart(Part):
    """A running computation unit."""

    id: Name = row("unique", ...)
    transformation: Name = row("the label of its transformation, templates expanded", ...)
    inputs: dict[PortName, OneOrMoreStreams | None] | None = row(
        "input port to stream (unit/port), or to a list of several; null: a gap", to="subscriptions", xml=ELEMENT
    )
    topics: dict[PortName, Names] | None = row(
        "output port to the topics it is published on", to="publications", xml=ELEMENT
    )
    host: Name | None = row("the host it runs on, if hosts are declared")
    standby: bool = row("it is a spare that does not run", False)


class WishPart(Part):
    """A target's demand on a quality attribute."""

    model_config = _either({"at_least": _IS_SAID}, {"at_most": _IS_SAID}, {"weight": _ABOVE_0})

    at_least: PositiveMicro | None = row("where higher is better: a bound", to="bound")
    at_most: PositiveMicro | None = row("where lower is better: a bound", to="bound")
    weight: Cost = row("CPU seconds for each unit of the attribute between the value and the best one", 0, "weight_us")


OF_A_STREAM = ("topic", "tag", "type", "quality", "host", "silent")
"""The keys by which a target describes the stream that it wants."""


class TargetPart(Part):
    """Information that is wanted on a topic, or a unit that is wanted though it gives nothing."""

    model_config = _either(
        {"topic": _IS_SAID, "tag": _IS_SAID, "run": _IS_UNSAID},
        {"run": _IS_SAID, **dict.fromkeys(OF_A_STREAM, _IS_UNSAID)},
    )

    label: Name = row("unique; mentions every template variable of the target", ..., xml=ELEMENT)
    topic: Name | None = row("the topic on which its stream is published; unique", xml=ELEMENT)
    tag: TagText | None = row(
        "the information that is wanted: a concept in description logic, or the paper's P(a)", xml=ELEMENT
    )
    type: Name | None = row(f"{_MESSAGE_TYPE}; `cfgplan run --ros2` publishes it", use=Use.RUNNING, xml="message")
    run: Name | None = row("the label of a transformation that has to run, in place of `topic` and `tag`")
    priority: Whole = row("larger matters more", 0, ge=-LARGEST_AMOUNT, le=LARGEST_AMOUNT)
    quality: dict[Name, WishPart] | None = row("quality attribute to the demand on it")
    host: Name | None = row("the host to which the stream is sent")
    silent: TimeSpan | None = row(
        "in a run, it counts as unmet after so long without an element: seconds, or 500ms, 5s",
        to="silent_us",
        use=Use.RUNNING,
    )


class HostPart(Part):
    """A computer that units run on."""

    name: Name = row("unique", ...)
    copies: Whole = row(
        "so many identical hosts name.1, name.2 and so on; each has the name without number as a label",
        1,
        use=Use.NONE,
        ge=1,
        le=MOST_COPIES,
    )
    labels: Names | None = row("words by which selectors such as `on` choose it, besides its name")
    cpu: Cost | None = row("CPU seconds per second that units may take; no limit if absent", to="cpu_us")
    memory: Whole | None = row(
        "megabytes that units may take; no limit if absent", to="memory_mb", ge=0, le=LARGEST_AMOUNT
    )
    offers: Resources | None = row("amounts of other resources that it has, by name; 0 of a resource that is absent")
    rent: Cost = row("CPU seconds per second that it costs while it has a unit or a spare", 0, "rent_us")
    energy: Whole | None = row(
        "watt seconds for the `power` (watts) that units there need over the horizon; no limit if absent",
        ge=0,
        le=LARGEST_AMOUNT**2,
    )
    speed: Speed = row("CPU seconds of labor, upkeep and standby are divided by this number on it", 1)


class LinkPart(Part):
    """A link that carries streams between hosts."""

    model_config = _either({"latency": _ZERO, "adds": _IS_UNSAID}, {"latency": _ABOVE_0, "adds": _IS_SAID})

    between: list[SelectorText] = row("two selectors of hosts, for its two ends", ..., min_length=2, max_length=2)
    bandwidth: Whole | None = row(
        "bytes per second of all streams over it; no limit if absent", ge=0, le=LARGEST_AMOUNT**2
    )
    price: Cost | None = row("CPU seconds for each megabyte over it; `transfer` if absent", to="price_us")
    latency: PositiveMicro = row("added to a quality of each stream that it carries", 0)
    adds: Name | None = row("the attribute to which `latency` is added; its `better` is `lower`")


class AttributePart(Part):
    """A quality attribute of streams."""

    name: Name = row("unique", ...)
    better: BetterName = row("which values are better", ...)
    rule: RuleName = row("the rule of outputs that state only a number", "add", use=Use.NONE)
    unit: Name | None = row("its unit of measure, free text", use=Use.NONE)
    worst: PositiveMicro | None = row("the worst value, which sources have that state none")
    best: PositiveMicro | None = row("the best value, from which weights count")


class FactPart(Part):
    """A fact of the world that transformations may require."""

    model_config = _either(
        {"by": _IS_SAID, "topic": _IS_UNSAID},
        {"topic": _IS_SAID, "by": _IS_UNSAID},
        dict.fromkeys(("by", "topic", "field", "noise", "silent"), _IS_UNSAID),
    )

    declared: Fact = row("its value unless another one is observed or set: a number, true, false or a word", ...)
    unit: Name | None = row("its unit of measure, free text", use=Use.NONE)
    by: TagText | None = row("the tag of the stream that observes it in a run; the stream is planned as for a target")
    topic: Name | None = row("in place of `by`: the topic of a target, whose stream observes it", use=Use.RUNNING)
    field: Name | None = row(
        "the field of an element that holds the value; `pose.x` is a nested field", use=Use.RUNNING
    )
    noise: NoiseText | None = row("the standard deviation of a value, or `20 %` of it", use=Use.RUNNING)
    silent: TimeSpan | None = row(
        "the declared value counts again after so long without an element: seconds, or 500ms, 5s",
        to="silent_us",
        use=Use.RUNNING,
    )


class DefaultsPart(Part):
    """Costs of the transformations that do not say their own."""

    labor: Cost | None = row("CPU seconds of one start; 1 if absent", to="labor_us")
    upkeep: Cost | None = row("CPU seconds per second; 0 if absent", to="upkeep_us")


class IncludedPart(Part):
    """A file that an environment includes: transformations and targets only."""

    format: Literal["cfgplan/1"] | None = row("the format of the file: cfgplan/1")
    transformations: list[TransformationPart] | None = row(
        "the library: transformations that can be started", xml=ELEMENT
    )
    targets: list[TargetPart] | None = row("the streams and units that are wanted", xml=ELEMENT)


class EnvironmentPart(Part):
    """An environment: the library of transformations, the running units, and the targets."""

    model_config = ConfigDict(extra="forbid", strict=True, title="cfgplan environment")

    format: Literal["cfgplan/1"] = row("the format of the file: cfgplan/1", ...)
    ontology: FileNames | None = row("ontology file or files, relative to this file", xml=ELEMENT)
    imports: Imports | None = row(
        "IRI that an ontology imports to a file, relative to this file, or to `ignore`; "
        "`ignore` alone skips every import that is not found"
    )
    rules: Literal["ignore"] | None = row("`ignore`: the ontology counts without its rules (SWRL)")
    prefer: OneOrMoreNames | None = row(
        "prefix or namespace that is meant if several ontologies have a name; in a list, the first that has the name",
        xml=ELEMENT,
    )
    horizon: Horizon = row(
        "how far ahead a plan looks, for upkeep: whole seconds, or `10m`, `1h`", DEFAULT_HORIZON_S, "horizon_s"
    )
    max_cost: Cost | None = row("the most that an update may cost, in CPU seconds", to="max_cost_us")
    defaults: DefaultsPart | None = row("costs of transformations that state none", xml=ELEMENT)
    include: FileNames | None = row("file or folder, or several, with more transformations and targets", xml=ELEMENT)
    hosts: list[HostPart] | None = row("the computers that units run on; if absent, plans place no units")
    transfer: Cost = row("CPU seconds for each megabyte sent from host to host", 0, "transfer_us")
    links: list[LinkPart] | None = row("links between hosts; the first that fits two hosts carries their streams")
    minimise: Objectives = row(
        "the objectives that are minimised, the most important first; the cost follows if it is not named", ["cost"]
    )
    qualities: list[AttributePart] | None = row("the quality attributes of streams")
    facts: dict[Name, FactPart] | None = row("facts of the world, for `requires` of transformations")
    survive: Survived = row("single failures to survive; 1: of hosts where hosts are declared, else of units", 0)
    transformations: list[TransformationPart] | None = row(
        "the library: transformations that can be started", xml=ELEMENT
    )
    units: list[UnitPart] | None = row("the running units", xml=ELEMENT)
    targets: list[TargetPart] | None = row("the streams and units that are wanted", xml=ELEMENT)


def what_runs(transformation: Transformation) -> tuple[object, ...]:
    """Return the ports, and the fields that running uses: units of two transformations with equal ones run equally."""
    ports = [(port.name, *_running(InputPart, port)) for port in transformation.inputs]
    ports += [(port.name, *_running(OutputPart, port)) for port in transformation.outputs]
    observed = [
        (port.name, stated.attribute, *_running(ContributionPart, stated))
        for port in transformation.outputs
        for stated in port.quality
        if stated.observe is not None
    ]
    return *_running(TransformationPart, transformation), *ports, *observed, len(transformation.inputs)


def _running(part: type[Part], value: object) -> Iterator[object]:
    return (getattr(value, row.to) for row in part.rows().values() if Use.RUNNING in row.use)


def json_schema(part: type[BaseModel]) -> dict[str, Any]:
    """The JSON Schema (draft 2020-12) of a definition, strict about the names of ports too."""
    schema = part.model_json_schema()
    _bar_other_names(schema)
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}


def _bar_other_names(schema: Any) -> None:
    if isinstance(schema, dict):
        if "patternProperties" in schema:
            schema["additionalProperties"] = False
        for inner in schema.values():
            _bar_other_names(inner)
    elif isinstance(schema, list):
        for inner in schema:
            _bar_other_names(inner)
