"""The parts of the environment file, from which readers, checks, writers and the JSON Schema are derived.

Most keys are made of the rows of the domain (`cfgplan.rows`); a part writes down only those that are not just an
attribute. A key has its values, their meaning and the default; `to`, the attribute of the domain's value (the key if
absent); `use`, the part of cfgplan that reads it; and `xml`, the attribute of the XML format (the key if absent). XML
refuses a value that is no text, number or flag, unless it is an ELEMENT. It leaves out an UNSAID value, which means
nothing without a refused one. Every text of a transformation or a target may hold template variables.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import MISSING, dataclass, replace
from functools import cache
from typing import Annotated, Any, ClassVar, Final, Literal, get_args, get_origin

from cfgplan.arguments import AtLeast, Natural
from cfgplan.domain import ComputationUnit, Host, Link, Target
from cfgplan.facts import HOST_MARK
from cfgplan.facts import Fact as FactOfTheWorld
from cfgplan.formats import schema_values
from cfgplan.formats.forms import Choice, Form, Limits, Reader, RefusedError, Schema, reader_of
from cfgplan.formats.schema_values import (
    FULL_FORM,
    SHORT_FORM,
    Cost,
    FileList,
    FileName,
    Horizon,
    Micro,
    Name,
    Names,
    Objectives,
    Point,
    PositiveMicro,
    Selects,
    StreamName,
    StreamNames,
    Survived,
    TagText,
    Whole,
    Written,
    form_of,
    list_or_mapping,
)
from cfgplan.qualities import Contribution, QualityAttribute, QualityRule, Wish
from cfgplan.rows import ELEMENT as ELEMENT
from cfgplan.rows import LARGEST_AMOUNT, Attribute, attributes
from cfgplan.rows import UNSAID as UNSAID
from cfgplan.rows import Use as Use
from cfgplan.transformations import (
    ContainerKind,
    InputPort,
    OutputPort,
    ProgramFormat,
    RunOptions,
    Transformation,
)

FORMAT: Final = "cfgplan/1"
MOST_COPIES = 1000

DEFAULT_HORIZON_S = 600
DEFAULT_UPKEEP_US = 0

_SHORT, _FULL, _CHOICE = Form(SHORT_FORM), Form(FULL_FORM), Choice(form_of)
_FIRST_IN_XML = ("type", "labor", "upkeep")
IGNORE = "ignore"


def as_it_is(value: Any) -> Any:
    """The plain form of a text, number or flag; lists for tuples."""
    return list(value) if isinstance(value, tuple) else dict(value) if isinstance(value, Mapping) else value


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
class Key:
    """A key of a part: the form of its value, its meaning, and the default, which is `...` if the key can't be absent.

    `limits` are those of the value as in `forms.Limits`; the others are as of `FieldRow`.
    """

    form: Any
    meaning: str
    default: Any
    to: str
    use: Use
    xml: str | None
    below: str
    limits: Mapping[str, Any]


def row(
    meaning: str,
    default: Any = None,
    to: str = "",
    use: Use = Use.PLANNING,
    xml: str | None = None,
    below: str = "",
    form: Any = None,
    **limits: Any,
) -> Any:
    """A key of a part. With `...` as default the key can't be absent."""
    return Key(form, meaning, default, to, use, xml, below, limits)


def _keys_of(part: type[Part]) -> dict[str, Key]:
    """Return the keys of a part, in order: its own come first, then the rows of the domain's value."""
    found = {key: replace(each, form=eval(part.own_forms[key], _names())) for key, each in part.own_rows.items()}
    if part.domain is not None:
        found |= {each.key: _made_of(each) for each in attributes(part.domain) if each.row.meaning}
    below: dict[str, list[str]] = {}
    for key, each in found.items():
        below.setdefault(each.below, []).append(key)

    def in_order(key: str) -> Iterator[str]:
        for other in below.get(key, ()):
            yield other
            yield from in_order(other)

    return {key: found[key] for key in in_order("")}


@cache
def _names() -> dict[str, Any]:
    """The names that forms are written with."""
    return {**vars(schema_values), **globals()}


def _made_of(attribute: Attribute) -> Key:
    """The key that is made from a row."""
    said, usual = attribute.row, attribute.default
    name = said.form or _form_of(attribute)
    form = eval(name, _names())
    if said.absent is not ...:
        usual = said.absent
    elif usual in (None, (), {}):
        usual = None
    elif usual is MISSING:
        usual = ...
    else:
        usual = _plain_of(_pieces(form))(usual)
    limits: dict[str, Any] = {}
    if name == "Whole":
        least = next((note.least for note in _pieces(attribute.type) if isinstance(note, AtLeast)), None)
        limits = {"ge": least if said.least is None else said.least, "le": said.most}
    form = form if usual is not None else form | None
    return Key(form, said.meaning, usual, attribute.name, said.use, said.xml, said.below, limits)


_FORMS: Final[Mapping[Any, str]] = {
    bool: "bool",
    str: "Name",
    int: "Whole",
    tuple[str, ...]: "Names",
    Mapping[str, Natural]: "Resources",
    ProgramFormat: "ProgramFormat",
    ContainerKind: "ContainerKind",
}


def _form_of(attribute: Attribute) -> str:
    """The values of a key by the attribute's type: those of a cost in microseconds, a text, a number and so on."""
    if attribute.name.endswith("_us"):
        return "Cost"
    types = [attribute.type]
    while types[0] not in _FORMS:
        types = [*get_args(types[0]), *types[1:]]
    return _FORMS[types[0]]


_IS_EMPTY: Final[Any] = {"maxProperties": 0}
_IS_SAID: Final[Any] = {"not": {"type": "null"}}
_IS_UNSAID: Final[Any] = {"type": "null"}
_ZERO: Final = {"const": 0}
_ABOVE_0: Final = {"exclusiveMinimum": 0}
_IS_TRUE: Final = {"const": True}


def _either(*forms: Mapping[str, Any]) -> Mapping[str, Any]:
    """The JSON Schema of keys that go together or do not, in any of some forms; readers check it in words."""
    of_forms: list[Any] = [
        {
            "required": [key for key, said in form.items() if said not in (_IS_UNSAID, _IS_EMPTY, _ZERO)],
            "properties": {**form},
        }
        for form in forms
    ]
    return {"anyOf": of_forms}


class Part:
    """A mapping in the file: its values by key, as attributes; absent keys have their defaults.

    A part is made of the rows `of` a domain's value, after the keys that its class writes down. `schema` has more keys
    for its JSON Schema, `title` names it there.
    """

    domain: ClassVar[type[Any] | None] = None
    schema: ClassVar[Mapping[str, Any] | None] = None
    title: ClassVar[str | None] = None
    own_rows: ClassVar[Mapping[str, Key]] = {}
    own_forms: ClassVar[Mapping[str, str]] = {}

    def __init_subclass__(
        cls, of: type[Any] | None = None, schema: Mapping[str, Any] | None = None, title: str | None = None
    ) -> None:
        cls.domain, cls.schema, cls.title = of, schema, title
        cls.own_rows = {name: each for name, each in vars(cls).items() if isinstance(each, Key)}
        cls.own_forms = vars(cls).get("__annotations__", {})
        for name in cls.own_rows:
            delattr(cls, name)

    def __init__(self, **said: Any) -> None:
        self.all_keys()
        vars(self).update(said)

    def __getattr__(self, key: str) -> Any:
        """Return the default of an absent key."""
        try:
            return type(self).all_keys()[key].default
        except KeyError:
            raise AttributeError(key) from None

    @classmethod
    @cache
    def all_keys(cls) -> Mapping[str, Key]:
        """The keys in the order in which they are written. They are found at first use: few files have every part."""
        found = _keys_of(cls)
        for key, each in found.items():
            setattr(cls, key, each.default)
        return found

    @classmethod
    @cache
    def reader(cls) -> Reader:
        """The function that makes a part of plain data. It raises RefusedError without saying why; see `models`.

        The reader of a key is made when the key first occurs: most files use few of the keys.
        """
        keys, readers = cls.all_keys(), dict[str, Reader]()
        needed = frozenset(key for key, each in keys.items() if each.default is ...)
        reader_by_key = readers.get

        def read(data: Any) -> Any:
            if type(data) is not dict or not needed <= data.keys():
                raise RefusedError
            part = object.__new__(cls)
            values = part.__dict__
            for key, value in data.items():
                reader = reader_by_key(key)
                if reader is None:
                    if key not in keys:
                        raise RefusedError
                    reader = readers[key] = _reader_of_key(keys[key])
                values[key] = reader(value)
            return part

        return read

    @classmethod
    @cache
    def rows(cls) -> Mapping[str, FieldRow]:
        """The rows by key, in the order in which they are written."""
        return {key: _row(key, each) for key, each in cls.all_keys().items()}

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

    @classmethod
    @cache
    def selecting(cls) -> tuple[str, ...]:
        """The keys whose values choose hosts by their labels."""
        return tuple(key for key, row in cls.rows().items() if row.selects)

    @classmethod
    @cache
    def domain_names(cls) -> Mapping[str, str]:
        """The attribute of the domain's value for each key."""
        return {key: row.to for key, row in cls.rows().items()}

    def values(self) -> dict[str, Any]:
        """The file's values, under the domain's names; tuples for lists.

        Template variables may have made two entries of a list one.
        """
        name_of = self.domain_names()
        return {
            name_of[key]: tuple(dict.fromkeys(value)) if type(value) is list else value
            for key, value in vars(self).items()
            if value is not None
        }


def _row(key: str, each: Key) -> FieldRow:
    pieces = [*_pieces(each.form)]
    holds_more = any(piece in (list, dict) or (isinstance(piece, type) and issubclass(piece, Part)) for piece in pieces)
    return FieldRow(
        to=each.to or key,
        use=each.use,
        xml=key if each.xml is None and not holds_more else each.xml,
        default=each.default,
        is_text=any(piece is str or isinstance(piece, str) for piece in pieces)
        and not any(piece is bool or piece == 0 for piece in pieces),
        plain=_plain_of(pieces),
        selects=_selects(each.form),
    )


def _reader_of_key(key: Key) -> Reader:
    return reader_of(Annotated[key.form, Limits(**key.limits)] if key.limits else key.form, _reader_in)


def _reader_in(form: Any) -> Reader:
    """Return the reader of a part that is a value of another. Raises TypeError for a class that is none."""
    if not (isinstance(form, type) and issubclass(form, Part)):
        raise TypeError(f"{form} has no reader")
    return lambda data: form.reader()(data)  # the part's forms are found when the first one is read


def _selects(hint: Any) -> bool:
    """Whether a type has texts that choose hosts, perhaps as the keys of a mapping."""
    return isinstance(hint, Selects) or any(map(_selects, get_args(hint)))


def _plain_of(pieces: Iterable[Any]) -> Callable[[Any], Any]:
    return next((piece.plain for piece in pieces if isinstance(piece, Written)), as_it_is)


def _pieces(hint: Any) -> Iterator[Any]:
    """Yield the parts of a type: its plain types, the values of its literals, and its annotations."""
    if get_origin(hint) in (list, dict):
        yield get_origin(hint)
    elif get_args(hint):
        for piece in get_args(hint):
            yield from _pieces(piece)
    else:
        yield hint


class InputPart(Part, of=InputPort, schema=_either({"worth": _ZERO}, {"optional": _IS_TRUE})):
    """An input port that needs more than a tag."""


class CurvePart(Part):
    """A value that follows a fact of the world: straight lines between points, level beyond the ends."""

    by: Name = row("the name of the fact, whose value is a number", ...)
    points: list[Point] = row(
        "two or more pairs [FACT, VALUE]: at FACT the value is VALUE; FACT rises from pair to pair",
        ...,
        min_length=2,
    )


MicroGiven = Annotated[Annotated[Micro, _SHORT] | Annotated[CurvePart, _FULL], _CHOICE]
PositiveGiven = Annotated[Annotated[PositiveMicro, _SHORT] | Annotated[CurvePart, _FULL], _CHOICE]


class ContributionPart(
    Part,
    of=Contribution,
    schema=_either(*(dict.fromkeys(QualityRule, _IS_UNSAID) | {rule: _IS_SAID} for rule in QualityRule)),
):
    """The contribution of an output to a quality attribute: exactly one of `add`, `limit`, `scale` and `set`."""

    add: MicroGiven | None = row("a number that is added to the combined value of the inputs")
    limit: PositiveGiven | None = row("a number that the value is never better than")
    scale: PositiveGiven | None = row("a factor by which the combined value of the inputs is multiplied")
    set: PositiveGiven | None = row("the value itself, independent of the inputs")
    of: Literal["worst", "best", "mean", "sum"] = row(
        "`worst`, `best`, `mean` or `sum`: how the values of several inputs are combined", "worst"
    )


QualityGiven = Annotated[Annotated[Micro, _SHORT] | Annotated[ContributionPart, _FULL], _CHOICE]


class OutputPart(Part, of=OutputPort):
    """An output port that says more than a tag."""


InputGiven = Annotated[Annotated[TagText, _SHORT] | Annotated[InputPart, _FULL], _CHOICE]
OutputGiven = Annotated[Annotated[TagText, _SHORT] | Annotated[OutputPart, _FULL], _CHOICE]
OneOrMoreNames = Annotated[Annotated[Name, _SHORT] | Annotated[Names, _FULL], _CHOICE]
OneOrMoreStreams = Annotated[Annotated[StreamName, _SHORT] | Annotated[StreamNames, _FULL], _CHOICE]
_AT_MOST: Final = {"type": "integer", "minimum": 0, "maximum": LARGEST_AMOUNT}
AtMost = Annotated[Whole, Limits(ge=0, le=LARGEST_AMOUNT), Schema(_AT_MOST)]
FileNames = Annotated[Annotated[FileName, _SHORT] | Annotated[FileList, _FULL], _CHOICE]
Imports = Annotated[Annotated[Literal["ignore"], _SHORT] | Annotated[dict[Name, FileName], _FULL], _CHOICE]


class RunPart(Part, of=RunOptions):
    """How the units of a transformation run."""


class ConflictsPart(Part):
    """Transformations that a transformation may not be together with."""

    host: Names | None = row(
        "labels of transformations whose units may not run on one host with its units; none if absent",
        to="conflicts_on_host",
    )
    system: Names | None = row(
        "labels of transformations whose units may not run anywhere together with its units; `conflicts: [A, B]` means "
        "these; none if absent",
        to="conflicts",
    )


ConflictsGiven = Annotated[Annotated[Names, _SHORT] | Annotated[ConflictsPart, _FULL], Choice(list_or_mapping)]


_RATE_OR_INPUTS: Final[Any] = [
    {"properties": {"inputs": {"anyOf": [_IS_UNSAID, {"maxProperties": 0}]}}},
    {"properties": {"run": {"properties": {"rate": _IS_UNSAID}}}},
]
"""Only a source has a rate; readers check it in words."""


class TransformationPart(Part, of=Transformation, schema={"anyOf": _RATE_OR_INPUTS}):
    """A streaming function that can be instantiated; `${Class}` in it stands for each individual of a class."""


class UnitPart(Part, of=ComputationUnit):
    """A running computation unit."""


class WishPart(Part, of=Wish, schema=_either({"at_least": _IS_SAID}, {"at_most": _IS_SAID}, {"weight": _ABOVE_0})):
    """A target's demand on a quality attribute."""

    at_least: PositiveMicro | None = row(
        "for an attribute with `better: higher`: the smallest value allowed; no bound if absent", to="bound"
    )
    at_most: PositiveMicro | None = row(
        "for an attribute with `better: lower`: the largest value allowed; no bound if absent", to="bound"
    )


OF_A_STREAM = ("topic", "tag", "type", "quality", "host", "silent")
"""The keys by which a target describes the stream that it wants."""


class TargetPart(
    Part,
    of=Target,
    schema=_either(
        {"topic": _IS_SAID, "tag": _IS_SAID, "run": _IS_UNSAID},
        {"run": _IS_SAID, **dict.fromkeys(OF_A_STREAM, _IS_UNSAID)},
    ),
):
    """Information that is wanted on a topic, or a unit that is wanted though it gives nothing."""


class HostPart(Part, of=Host):
    """A computer that units run on."""

    copies: Whole = row(
        "the number of identical hosts NAME.1, NAME.2 and so on, each with the label NAME; with 1 the host is NAME",
        1,
        use=Use.NONE,
        below="name",
        ge=1,
        le=MOST_COPIES,
    )


class LinkPart(
    Part, of=Link, schema=_either({"latency": _ZERO, "adds": _IS_UNSAID}, {"latency": _ABOVE_0, "adds": _IS_SAID})
):
    """A link that carries streams between hosts."""


class AttributePart(Part, of=QualityAttribute):
    """A quality attribute of streams."""


class FactPart(
    Part,
    of=FactOfTheWorld,
    schema=_either(
        *(
            {**form, **owner, **{key: observed for key in ("by", "topic") if form[key] is _IS_SAID}}
            for form in (
                {"by": _IS_SAID, "topic": _IS_UNSAID, "type": _IS_UNSAID, "qos": _IS_UNSAID},
                {"topic": _IS_SAID, "by": _IS_UNSAID, "qos": _IS_UNSAID},
                {"topic": _IS_SAID, "by": _IS_UNSAID, "type": _IS_SAID},
                dict.fromkeys(("by", "topic", "field", "type", "qos", "noise", "silent"), _IS_UNSAID),
            )
            for owner, observed in (
                ({"of": _IS_UNSAID, "hosts": _IS_EMPTY}, _IS_SAID),
                ({"of": _IS_SAID}, {"type": "string", "pattern": re.escape(HOST_MARK)}),
            )
        )
    ),
):
    """A fact of the world that transformations may require."""


class DefaultsPart(Part):
    """Costs of the transformations that do not say their own."""

    labor: Cost | None = row("CPU seconds of one start of a transformation without `labor`; 1 if absent", to="labor_us")
    upkeep: Cost | None = row(
        "CPU seconds per second of a unit of a transformation without `upkeep`; 0 if absent", to="upkeep_us"
    )


class IncludedPart(Part):
    """A file that an environment includes: transformations and targets only."""

    format: Literal["cfgplan/1"] | None = row("the format of the file: cfgplan/1")
    transformations: list[TransformationPart] | None = row(
        "the library: transformations of which units can be started; none if absent", xml=ELEMENT
    )
    targets: list[TargetPart] | None = row("the streams and units that must run; none if absent", xml=ELEMENT)


class EnvironmentPart(Part, title="cfgplan environment"):
    """An environment: the library of transformations, the running units, and the targets."""

    format: Literal["cfgplan/1"] = row("the format of the file: cfgplan/1", ...)
    ontology: FileNames | None = row(
        "ontology file, or a list of files, relative to this file; if absent, only the tags tell what matches",
        xml=ELEMENT,
    )
    imports: Imports | None = row(
        "the files of imported ontologies: IRI to a file, relative to this file, or to `ignore`; "
        "`imports: ignore` skips every import that is not found; if absent, such an import is an error"
    )
    rules: Literal["ignore"] | None = row("`ignore`: use the ontology without its rules (SWRL); with them if absent")
    prefer: OneOrMoreNames | None = row(
        "the prefix or namespace of a name that is in several ontologies, or a list to try in order; if absent, "
        "such a name is an error",
        xml=ELEMENT,
    )
    horizon: Horizon = row(
        "how far ahead a plan counts upkeep: whole seconds, or `10m`, `1h`", DEFAULT_HORIZON_S, "horizon_s"
    )
    max_cost: Cost | None = row("the largest cost of an update, in CPU seconds; no limit if absent", to="max_cost_us")
    defaults: DefaultsPart | None = row("costs of transformations that state none: a mapping", xml=ELEMENT)
    include: FileNames | None = row(
        "file or folder, or a list of them, with more transformations and targets; none if absent", xml=ELEMENT
    )
    hosts: list[HostPart] | None = row(
        "the computers that units run on; if absent, a plan does not say where units run"
    )
    transfer: Cost = row("CPU seconds for each megabyte sent from host to host", 0, "transfer_us")
    links: list[LinkPart] | None = row(
        "links between hosts; streams between two hosts use the first link that fits both; none if absent"
    )
    minimise: Objectives = row(
        "objectives to minimise, the most important first: `rent`, `cost`, `units`, `hosts`, `rewired`, `started`; "
        "cost comes last if it is not named",
        ["cost"],
    )
    qualities: list[AttributePart] | None = row("the quality attributes of streams; none if absent")
    facts: dict[Name, FactPart] | None = row(
        "facts of the world, for `requires` of transformations and for qualities: name to a mapping; none if absent"
    )
    survive: Survived = row(
        "single failures after which every target is still met: 0 for none, `units`, `hosts`, or 1 for hosts if any "
        "are declared, else units",
        0,
    )
    transformations: list[TransformationPart] | None = row(
        "the library: transformations of which units can be started; none if absent", xml=ELEMENT
    )
    units: list[UnitPart] | None = row("the running units; none if absent", xml=ELEMENT)
    targets: list[TargetPart] | None = row("the streams and units that must run; none if absent", xml=ELEMENT)
