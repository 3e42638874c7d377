"""The environment file's definition, from which its validation and its JSON Schema are made."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Discriminator, Field, Tag

from cfgplan.formats.schema_values import (
    FULL_FORM,
    SHORT_FORM,
    Cost,
    FileName,
    Micro,
    Name,
    Params,
    PortName,
    PositiveMicro,
    Rate,
    Seconds,
    Silence,
    Span,
    TagText,
    form_of,
)
from cfgplan.planning import MOST_INSTANCES

FORMAT = "cfgplan/1"
LONGEST_HORIZON_S = 1_000_000_000
LONGEST_QUEUE = 1_000_000

DEFAULT_HORIZON_S = 600
DEFAULT_LABOR_US = 1_000_000
DEFAULT_UPKEEP_US = 0


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)


class InputPart(_Part):
    """An input port that needs more than a tag."""

    tag: TagText
    distinct: Name | None = Field(default=None, description="ports of one group are fed by different transformations")
    feedback: bool = Field(default=False, description="this input may close a cycle of the wiring")


class ContributionPart(_Part):
    """What an output makes of a quality attribute: exactly one of `add`, `limit`, `scale` and `set`."""

    add: Micro | None = Field(default=None, description="added to the value of the inputs")
    limit: PositiveMicro | None = Field(default=None, description="the value is no better than this")
    scale: PositiveMicro | None = Field(default=None, description="a factor on the value of the inputs")
    set: PositiveMicro | None = Field(default=None, description="the value, whatever the inputs are")
    of: Literal["worst", "best", "mean", "sum"] = Field(default="worst", description="how several inputs count")


Quality = Annotated[
    Annotated[Micro, Tag(SHORT_FORM)] | Annotated[ContributionPart, Tag(FULL_FORM)],
    Discriminator(form_of),
]


class OutputPart(_Part):
    """An output port that says more than a tag."""

    tag: TagText
    quality: dict[Name, Quality] | None = Field(default=None, description="attribute to what it makes of it")
    rate: PositiveMicro = Field(default=0, description="elements per second, for what it costs to change hosts")
    size: int = Field(default=0, ge=0, le=LONGEST_HORIZON_S, description="bytes of one element")


Input = Annotated[
    Annotated[TagText, Tag(SHORT_FORM)] | Annotated[InputPart, Tag(FULL_FORM)],
    Discriminator(form_of),
]
Output = Annotated[
    Annotated[TagText, Tag(SHORT_FORM)] | Annotated[OutputPart, Tag(FULL_FORM)],
    Discriminator(form_of),
]


Names = Annotated[
    Annotated[Name, Tag(SHORT_FORM)] | Annotated[list[Name], Tag(FULL_FORM)],
    Discriminator(form_of),
]
FileNames = Annotated[
    Annotated[FileName, Tag(SHORT_FORM)] | Annotated[list[FileName], Tag(FULL_FORM)],
    Discriminator(form_of),
]


class RunPart(_Part):
    """How the units of a transformation run."""

    start: PortName = Field(
        default="all", description="what starts a step: all inputs fresh, any input, aligned in time, or a port's name"
    )
    tolerance: Seconds = Field(default=0, description="how far apart aligned inputs may be, in seconds")
    rate: Rate | None = Field(default=None, description="how often a source gives an element, per second")
    queue: int = Field(default=256, ge=1, le=LONGEST_QUEUE, description="how many elements may wait at an input")
    when_full: Literal["drop_oldest", "block"] = Field(
        default="drop_oldest", description="drop the oldest element, or let the producer wait"
    )
    hang: Silence | None = Field(
        default=None, description="kill a unit that is silent for so many seconds, at least 2; 0: never; 10 if absent"
    )
    memory: int | None = Field(
        default=None, ge=1, le=LONGEST_QUEUE, description="the most memory that a unit may take, in megabytes"
    )
    state: bool = Field(default=False, description="a new unit goes on with the state of the last")


class TransformationPart(_Part):
    """A streaming function that can be instantiated; `${Class}` in it stands for each individual of a class."""

    label: Name = Field(description="unique; mentions every template variable of the transformation")
    source: Name | None = Field(
        default=None, description="package.module:Class, or units.py:Class relative to this file"
    )
    kind: Name | None = Field(default=None, description="free text, the paper's type attribute")
    host: Names | None = Field(default=None, description="where its units run: a host, or a list to choose from")
    params: Params = Field(default={}, description="the configuration its units are started with")
    labor: Cost | None = Field(default=None, description="CPU seconds of one start")
    upkeep: Cost | None = Field(default=None, description="CPU seconds that a running unit takes per second")
    pinned: bool = Field(default=False, description="running units are kept even where no target needs them")
    required: bool = Field(default=False, description="must be used wherever that is possible at all")
    memory: int | None = Field(
        default=None,
        ge=0,
        le=LONGEST_QUEUE,
        description="megabytes that a unit takes on its host; run.memory if absent",
    )
    conflicts: list[Name] | None = Field(default=None, description="transformations that may not be there beside it")
    min_instances: int = Field(default=0, ge=0, le=MOST_INSTANCES, description="at least so many of its units run")
    max_instances: int | None = Field(default=None, ge=0, description="at most so many of its units are there")
    standby: Cost | None = Field(default=None, description="CPU seconds per second of a spare that does not run")
    run: RunPart | None = Field(default=None, description="how its units run")
    inputs: dict[PortName, Input] | None = Field(default=None, description="input ports: name to tag")
    outputs: dict[PortName, Output] | None = Field(default=None, description="output ports: name to tag")


class UnitPart(_Part):
    """A running computation unit."""

    id: Name
    transformation: Name = Field(description="the label of its transformation, templates expanded")
    inputs: dict[PortName, Name | None] | None = Field(
        default=None, description="input port to stream (unit/port); null: a gap"
    )
    topics: dict[PortName, list[Name]] | None = Field(
        default=None, description="output port to the topics it is published on"
    )
    host: Name | None = Field(default=None, description="where it runs, if hosts are declared")
    standby: bool = Field(default=False, description="it is a spare that does not run")


class WishPart(_Part):
    """What a target asks of a quality attribute."""

    at_least: PositiveMicro | None = Field(default=None, description="where higher is better: a bound")
    at_most: PositiveMicro | None = Field(default=None, description="where lower is better: a bound")
    weight: Cost = Field(default=0, description="CPU seconds for each unit by which the best is missed")


class TargetPart(_Part):
    """Information that is wanted on a topic."""

    label: Name
    topic: Name
    tag: TagText
    priority: int = Field(default=0, ge=-LONGEST_HORIZON_S, le=LONGEST_HORIZON_S, description="larger matters more")
    quality: dict[Name, WishPart] | None = Field(default=None, description="attribute to what is asked of it")
    host: Name | None = Field(default=None, description="the host that the stream has to come to")
    silent: Span | None = Field(
        default=None, description="in a run it counts as unmet when nothing has come for so long: seconds, or 500ms, 5s"
    )


class HostPart(_Part):
    """A computer that units run on."""

    name: Name
    cpu: Cost | None = Field(default=None, description="CPU seconds per second that units may take; no limit if absent")
    memory: int | None = Field(default=None, ge=0, description="megabytes that units may take; no limit if absent")


class AttributePart(_Part):
    """A quality attribute of streams."""

    name: Name
    better: Literal["lower", "higher"] = Field(description="which values are better")
    rule: Literal["add", "limit", "scale", "set"] = Field(
        default="add", description="what an output that states a number does with it"
    )
    unit: Name | None = Field(default=None, description="what it is measured in, free text")
    worst: PositiveMicro | None = Field(
        default=None, description="the worst value, and that of sources that state none"
    )
    best: PositiveMicro | None = Field(default=None, description="the best value, from which weights count")


class DefaultsPart(_Part):
    """Costs of the transformations that do not say their own."""

    labor: Cost | None = Field(default=None, description="CPU seconds of one start; 1 if absent")
    upkeep: Cost | None = Field(default=None, description="CPU seconds per second; 0 if absent")


class IncludedPart(_Part):
    """A file that an environment includes: transformations and targets only."""

    format: Literal["cfgplan/1"] | None = None
    transformations: list[TransformationPart] | None = None
    targets: list[TargetPart] | None = None


IGNORE = "ignore"

Imports = Annotated[
    Annotated[Literal["ignore"], Tag(SHORT_FORM)] | Annotated[dict[Name, FileName], Tag(FULL_FORM)],
    Discriminator(form_of),
]


class EnvironmentPart(_Part):
    """An environment: the transformations there are, the units that run and the information that is wanted."""

    model_config = ConfigDict(extra="forbid", strict=True, title="cfgplan environment")

    format: Literal["cfgplan/1"]
    ontology: FileNames | None = Field(default=None, description="ontology file or files, relative to this file")
    imports: Imports | None = Field(
        default=None,
        description="IRI that an ontology imports to a file, relative to this file, or to `ignore`; "
        "`ignore` alone: all that can't be found",
    )
    horizon: int = Field(
        default=DEFAULT_HORIZON_S, ge=0, le=LONGEST_HORIZON_S, description="how far ahead upkeep counts, in seconds"
    )
    max_cost: Cost | None = Field(default=None, description="the most that an update may cost, in CPU seconds")
    defaults: DefaultsPart | None = None
    include: list[FileName] | None = Field(
        default=None, description="files and folders with more transformations and targets"
    )
    hosts: list[HostPart] | None = Field(default=None, description="where units run; if absent, nothing is placed")
    transfer: Cost = Field(default=0, description="CPU seconds for each megabyte that goes from host to host")
    qualities: list[AttributePart] | None = Field(default=None, description="the quality attributes of streams")
    survive: Literal[0, 1, "units", "hosts"] = Field(
        default=0, description="single failures to survive; 1: of hosts where hosts are declared, else of units"
    )
    transformations: list[TransformationPart] | None = None
    units: list[UnitPart] | None = None
    targets: list[TargetPart] | None = None


def environment_schema() -> dict[str, Any]:
    """The JSON Schema (draft 2020-12) of the environment file, for editors and other tools."""
    return json_schema(EnvironmentPart)


def json_schema(part: type[BaseModel]) -> dict[str, Any]:
    """The JSON Schema of a definition, strict about the names of ports too."""
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
