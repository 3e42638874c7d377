"""The environment file's fields, a row each, from which readers, checks, writers and the JSON Schema are derived.

A row says the key, its values, their meaning and the default; `to`, the attribute of the domain's value (the key if
absent); `use`, who looks at it; and `xml`, the attribute of the XML format (the key if absent). XML refuses a value
that is no text, number or flag, unless it is an ELEMENT. It leaves out an UNSAID value, which means nothing without a
refused one. Every text of a transformation or a target may hold template variables.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from enum import Flag
from functools import cache
from typing import Annotated, Any, ClassVar, Final, Literal, get_args, get_origin, get_type_hints

from pydantic import BaseModel, ConfigDict, Discriminator, Field, Tag

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
from cfgplan.transformations import ProgramFormat

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
    """Who looks at a field. If its value changes, PLANNING makes another plan, and RUNNING starts units anew."""

    NONE = 0
    PLANNING = 1
    RUNNING = 2
    BOTH = 3


@dataclass(frozen=True, slots=True)
class FieldRow:
    """A field as readers and writers need it; `plain` turns the domain's value into the file's."""

    to: str
    use: Use
    xml: str | None
    default: Any
    is_text: bool
    plain: Callable[[Any], Any]


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
        return {key: _row(cls, key, [*_pieces(hints[key])]) for key in cls.model_fields}

    @classmethod
    @cache
    def attributes(cls) -> Mapping[str, str]:
        """The keys by attribute of the XML format; the paper's attributes and the costs come first."""
        found = {row.xml: key for key, row in cls.rows().items() if row.xml not in (None, ELEMENT, UNSAID)}
        return {str(name): found[name] for name in sorted(found, key=lambda name: name not in _FIRST_IN_XML)}

    @classmethod
    def plain(cls, key: str, value: object) -> Any:
        """What a file says of a domain's value under a key; None if it is the default."""
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


def _row(part: type[Part], key: str, pieces: list[Any]) -> FieldRow:
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
    )


def _pieces(hint: Any) -> Iterator[Any]:
    """What a type is made of: its plain types, the values of its literals, and what is annotated."""
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
_REMAP = "in ROS: what the node calls its topic or service; the port's name if absent"


class InputPart(Part):
    """An input port that needs more than a tag."""

    model_config = _either({"worth": _ZERO}, {"optional": _IS_TRUE})

    tag: TagText = row("what it needs, a concept in description logic or the paper's P(a)", ..., xml=ELEMENT)
    distinct: Name | None = row("ports of one group are fed by different transformations")
    feedback: bool = row("this input may close a cycle of the wiring", False)
    optional: bool = row("it may stay unfed; fed wherever streams of what runs anyway may feed it", False)
    worth: Cost = row("what it is worth to feed an optional input, CPU seconds per second", 0, "worth_us")
    kind: InputKind = row("a service's replies start no step, and may close a cycle", "stream", "service")
    count: Count = row("how many streams of different units feed it; `all`: every one that matches", 1)
    type: Name | None = row(_MESSAGE_TYPE, use=Use.RUNNING, xml="message")
    remap: Name | None = row(_REMAP, use=Use.RUNNING)
    qos: QosText | None = row(_QOS, use=Use.RUNNING)


class CurvePart(Part):
    """A value that follows a fact of the world: straight lines between points, level beyond the ends."""

    by: Name = row("the fact, a number", ...)
    points: list[Annotated[list[Micro], Field(min_length=2, max_length=2)]] = row(
        "two or more pairs, a value of the fact and the one that follows from it; the least fact first",
        ...,
        min_length=2,
    )


MicroGiven = Annotated[Annotated[Micro, _SHORT] | Annotated[CurvePart, _FULL], _CHOICE]
PositiveGiven = Annotated[Annotated[PositiveMicro, _SHORT] | Annotated[CurvePart, _FULL], _CHOICE]


class ContributionPart(Part):
    """What an output makes of a quality attribute: exactly one of `add`, `limit`, `scale` and `set`."""

    model_config = _either(*(dict.fromkeys(QualityRule, _IS_UNSAID) | {rule: _IS_SAID} for rule in QualityRule))

    add: MicroGiven | None = row("added to the value of the inputs")
    limit: PositiveGiven | None = row("the value is no better than this")
    scale: PositiveGiven | None = row("a factor on the value of the inputs")
    set: PositiveGiven | None = row("the value, whatever the inputs are")
    of: Literal["worst", "best", "mean", "sum"] = row("how several inputs count", "worst")
    observe: Name | None = row("where an element holds how good it is; `pose.error` leads further in", use=Use.RUNNING)


QualityGiven = Annotated[Annotated[Micro, _SHORT] | Annotated[ContributionPart, _FULL], _CHOICE]


class OutputPart(Part):
    """An output port that says more than a tag."""

    tag: TagText = row("what it gives, a concept in description logic or the paper's P(a)", ..., xml=ELEMENT)
    quality: dict[Name, QualityGiven] | None = row("attribute to what it makes of it", xml=UNSAID)
    rate: PositiveMicro = row("elements per second, for what it costs to change hosts", 0, "rate_uhz")
    size: Whole = row("bytes of one element", 0, "size_bytes", ge=0, le=LARGEST_AMOUNT)
    serves: Whole | None = row("at most so many inputs and topics take its stream", ge=1, le=LONGEST_QUEUE)
    type: Name | None = row(_MESSAGE_TYPE, use=Use.RUNNING, xml="message")
    remap: Name | None = row(_REMAP, use=Use.RUNNING)
    qos: QosText | None = row(_QOS, use=Use.RUNNING)
    topic: Name | None = row(
        "in ROS 2: the topic by which nodes outside of the run know it, published while one listens", use=Use.RUNNING
    )


InputGiven = Annotated[Annotated[TagText, _SHORT] | Annotated[InputPart, _FULL], _CHOICE]
OutputGiven = Annotated[Annotated[TagText, _SHORT] | Annotated[OutputPart, _FULL], _CHOICE]
OneOrMoreNames = Annotated[Annotated[Name, _SHORT] | Annotated[Names, _FULL], _CHOICE]
OneOrMoreStreams = Annotated[Annotated[StreamName, _SHORT] | Annotated[StreamNames, _FULL], _CHOICE]
FileNames = Annotated[Annotated[FileName, _SHORT] | Annotated[FileList, _FULL], _CHOICE]
Imports = Annotated[Annotated[Literal["ignore"], _SHORT] | Annotated[dict[Name, FileName], _FULL], _CHOICE]


class RunPart(Part):
    """How the units of a transformation run."""

    USUAL_USE = Use.RUNNING

    start: PortName = row("what starts a step: all inputs fresh, any input, aligned in time, or a port's name", "all")
    tolerance: Seconds = row("how far apart aligned inputs may be, in seconds", 0, "tolerance_us")
    rate: Rate | None = row("how often a source, which has no inputs, gives an element, per second", to="rate_hz")
    queue: Whole = row("how many elements may wait at an input", 256, ge=1, le=LONGEST_QUEUE)
    when_full: WhenFull = row("drop the oldest element, or let the producer wait", "drop_oldest", "blocks")
    hang: HangTime | None = row(
        "kill a unit that is silent for so many seconds, at least 2; 0: never; 10 if absent", to="hang_us"
    )
    stop: TimeSpan | None = row(
        "how long a unit that is told to end may take, such as 500ms; then it is killed; 2s if absent", to="stop_us"
    )
    format: ProgramFormat = row("how a program reads and writes: lines of JSON, or frames of msgpack", "json")
    memory: Whole | None = row(
        "the most memory that a unit may take, in megabytes", None, "memory_mb", Use.BOTH, ge=1, le=LONGEST_QUEUE
    )
    state: StateName = row("a new unit goes on with the state of the last; a name: of the last with that name", False)
    lifecycle: bool = row("cold spares of this ROS 2 node are configured, and activated when they are needed", False)


class ConflictsPart(Part):
    """Transformations that a transformation may not be together with."""

    host: Names | None = row("none of their units is on one host with a unit of it", to="conflicts_on_host")
    system: Names | None = row("none of their units is there; a list, without a mapping, says these", to="conflicts")


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
    params: Params = row("the configuration its units are started with", {}, use=Use.RUNNING, xml=ELEMENT)
    labor: Cost | None = row("CPU seconds of one start", to="labor_us")
    upkeep: Cost | None = row("CPU seconds that a running unit takes per second", to="upkeep_us")
    requires: RequirementText | None = row(
        "its units run only while facts meet it: an expression such as `visibility >= 2.25 and not night`", xml=UNSAID
    )
    pinned: bool = row("running units are kept even where no target needs them", False)
    required: bool = row("must be used wherever that is possible at all", False)
    memory: Whole | None = row(
        "megabytes that a unit takes on its host; run.memory if absent", None, "memory_mb", ge=0, le=LONGEST_QUEUE
    )
    needs: Resources | None = row("how much of other resources of its host a unit takes, by name: whole numbers")
    # `with` is a word of Python's, so that it can't be written as the others are.
    __annotations__["with"] = "Names | None"
    locals()["with"] = row("transformations of each of which a unit runs on the host of a running unit", to="beside")
    conflicts: ConflictsGiven | None = row("transformations that may not be there together with it")
    min_instances: Whole = row("at least so many of its units run", 0, ge=0, le=MOST_INSTANCES)
    max_instances: Whole | None = row("at most so many of its units are there", ge=0, le=LARGEST_AMOUNT)
    per_host: Whole | None = row("at most so many of its units are on one host", ge=1, le=LARGEST_AMOUNT)
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
    host: Name | None = row("where it runs, if hosts are declared")
    standby: bool = row("it is a spare that does not run", False)


class WishPart(Part):
    """A target's demand on a quality attribute."""

    model_config = _either({"at_least": _IS_SAID}, {"at_most": _IS_SAID}, {"weight": _ABOVE_0})

    at_least: PositiveMicro | None = row("where higher is better: a bound", to="bound")
    at_most: PositiveMicro | None = row("where lower is better: a bound", to="bound")
    weight: Cost = row("CPU seconds for each unit by which the best is missed", 0, "weight_us")


OF_A_STREAM = ("topic", "tag", "type", "quality", "host", "silent")
"""What a target says of the stream that it wants."""


class TargetPart(Part):
    """Information that is wanted on a topic, or a unit that is wanted though it gives nothing."""

    model_config = _either(
        {"topic": _IS_SAID, "tag": _IS_SAID, "run": _IS_UNSAID},
        {"run": _IS_SAID, **dict.fromkeys(OF_A_STREAM, _IS_UNSAID)},
    )

    label: Name = row("unique; mentions every template variable of the target", ..., xml=ELEMENT)
    topic: Name | None = row("where its stream is published; unique", xml=ELEMENT)
    tag: TagText | None = row("what is wanted, a concept in description logic or the paper's P(a)", xml=ELEMENT)
    type: Name | None = row(f"{_MESSAGE_TYPE}; `cfgplan run --ros2` publishes it", use=Use.RUNNING, xml="message")
    run: Name | None = row("a transformation of which a unit is wanted, in place of `topic` and `tag`")
    priority: Whole = row("larger matters more", 0, ge=-LARGEST_AMOUNT, le=LARGEST_AMOUNT)
    quality: dict[Name, WishPart] | None = row("attribute to what is asked of it")
    host: Name | None = row("the host that the stream has to come to")
    silent: TimeSpan | None = row(
        "in a run it counts as unmet when nothing has come for so long: seconds, or 500ms, 5s",
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
    labels: Names | None = row("what selectors such as `on` choose it by, beside its name")
    cpu: Cost | None = row("CPU seconds per second that units may take; no limit if absent", to="cpu_us")
    memory: Whole | None = row(
        "megabytes that units may take; no limit if absent", to="memory_mb", ge=0, le=LARGEST_AMOUNT
    )
    offers: Resources | None = row("how much it has of other resources, by name; nothing of what is absent")
    rent: Cost = row("CPU seconds per second that it costs while a unit is there, spares too", 0, "rent_us")
    energy: Whole | None = row(
        "watt seconds for the `power` (watts) that units there need over the horizon; no limit if absent",
        ge=0,
        le=LARGEST_AMOUNT**2,
    )
    speed: Speed = row("what the CPU seconds of labor, upkeep and standby are divided by on it", 1)


class LinkPart(Part):
    """A link that carries streams between hosts."""

    model_config = _either({"latency": _ZERO, "adds": _IS_UNSAID}, {"latency": _ABOVE_0, "adds": _IS_SAID})

    between: list[SelectorText] = row("two selectors of hosts, for its two ends", ..., min_length=2, max_length=2)
    bandwidth: Whole | None = row(
        "bytes per second of all that is carried over it; no limit if absent", ge=0, le=LARGEST_AMOUNT**2
    )
    price: Cost | None = row("CPU seconds for each megabyte over it; `transfer` if absent", to="price_us")
    latency: PositiveMicro = row("what it adds to a quality of each stream that it carries", 0)
    adds: Name | None = row("the attribute that `latency` is added to, one of which less is better")


class AttributePart(Part):
    """A quality attribute of streams."""

    name: Name = row("unique", ...)
    better: BetterName = row("which values are better", ...)
    rule: RuleName = row("what an output that states a number does with it", "add", use=Use.NONE)
    unit: Name | None = row("what it is measured in, free text", use=Use.NONE)
    worst: PositiveMicro | None = row("the worst value, and that of sources that state none")
    best: PositiveMicro | None = row("the best value, from which weights count")


class FactPart(Part):
    """A fact of the world that transformations may require."""

    model_config = _either(
        {"by": _IS_SAID, "topic": _IS_UNSAID},
        {"topic": _IS_SAID, "by": _IS_UNSAID},
        dict.fromkeys(("by", "topic", "field", "noise", "silent"), _IS_UNSAID),
    )

    declared: Fact = row("what is so: a number, true, false or a word", ...)
    unit: Name | None = row("what it is measured in, free text", use=Use.NONE)
    by: TagText | None = row("the tag of the stream that observes it in a run; what gives it is planned as for targets")
    topic: Name | None = row("in place of `by`: the topic of a target, whose stream observes it", use=Use.RUNNING)
    field: Name | None = row("where an element holds the value; `pose.x` leads further in", use=Use.RUNNING)
    noise: NoiseText | None = row("the standard deviation of a value, or `20 %` of it", use=Use.RUNNING)
    silent: TimeSpan | None = row(
        "what is declared counts again when nothing has come for so long: seconds, or 500ms, 5s",
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
    transformations: list[TransformationPart] | None = row("what can be started", xml=ELEMENT)
    targets: list[TargetPart] | None = row("what is wanted", xml=ELEMENT)


class EnvironmentPart(Part):
    """An environment: the transformations there are, the units that run and the information that is wanted."""

    model_config = ConfigDict(extra="forbid", strict=True, title="cfgplan environment")

    format: Literal["cfgplan/1"] = row("the format of the file: cfgplan/1", ...)
    ontology: FileNames | None = row("ontology file or files, relative to this file", xml=ELEMENT)
    imports: Imports | None = row(
        "IRI that an ontology imports to a file, relative to this file, or to `ignore`; "
        "`ignore` alone: all that can't be found"
    )
    rules: Literal["ignore"] | None = row("`ignore`: the ontology counts without its rules (SWRL)")
    prefer: OneOrMoreNames | None = row(
        "prefix or namespace whose name is meant if several ontologies have one; of a list, the first that has it",
        xml=ELEMENT,
    )
    horizon: Horizon = row("how far ahead upkeep counts: whole seconds, or `10m`, `1h`", DEFAULT_HORIZON_S, "horizon_s")
    max_cost: Cost | None = row("the most that an update may cost, in CPU seconds", to="max_cost_us")
    defaults: DefaultsPart | None = row("costs of transformations that state none", xml=ELEMENT)
    include: FileNames | None = row("file or folder, or several, with more transformations and targets", xml=ELEMENT)
    hosts: list[HostPart] | None = row("where units run; if absent, nothing is placed")
    transfer: Cost = row("CPU seconds for each megabyte that goes from host to host", 0, "transfer_us")
    links: list[LinkPart] | None = row("what carries streams from host to host: the first that fits two hosts")
    minimise: Objectives = row(
        "what is minimised, the most important first; the cost follows if it is not named", ["cost"]
    )
    qualities: list[AttributePart] | None = row("the quality attributes of streams")
    facts: dict[Name, FactPart] | None = row("facts of the world, which `requires` of transformations asks about")
    survive: Survived = row("single failures to survive; 1: of hosts where hosts are declared, else of units", 0)
    transformations: list[TransformationPart] | None = row("what can be started", xml=ELEMENT)
    units: list[UnitPart] | None = row("what runs", xml=ELEMENT)
    targets: list[TargetPart] | None = row("what is wanted", xml=ELEMENT)


def what_runs(transformation: Transformation) -> tuple[object, ...]:
    """What is equal if units of two transformations run alike: the fields that running uses, and the ports."""
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
