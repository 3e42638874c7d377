"""The values of the environment file: names, tags, costs, qualities, each with its validation, JSON Schema and dump."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from decimal import Decimal, DecimalException
from enum import Enum
from functools import lru_cache
from typing import Annotated, Any, Literal, TypeVar

from cfgplan.amounts import MICROSECONDS
from cfgplan.canonical import normal
from cfgplan.costs import LARGEST_COST_US, LONGEST_HORIZON_S, SPAN, microseconds, seconds, span_s
from cfgplan.domain import Objective
from cfgplan.errors import InvalidValueError
from cfgplan.facts import LARGEST_FACT, FactValue
from cfgplan.formats.forms import After, Before, Described, Instead, Limits, MoreSchema, RefusedError, Schema
from cfgplan.noise import Noise
from cfgplan.qualities import LARGEST_QUALITY, MICRO, Better, QualityRule, micro_units, units
from cfgplan.rows import ALL, LARGEST_AMOUNT
from cfgplan.transformations import CPU, LEAST_HANG_S, STATE_NAME, RunOptions

SPEEDS = (Decimal("0.001"), 1000)
"""The least and the largest speed of a host."""
LARGEST_RATE_HZ = 100_000
MOST_COUNTED = 1000
"""The most streams that an input may count."""
NAME_PATTERN = r"^[^\s\x00-\x1f\x7f]([^\x00-\x1f\x7f]*[^\s\x00-\x1f\x7f])?$"
QOS = (
    r"^(reliable|best_effort|volatile|transient_local|manual|(deadline|lease)=[0-9]+([.][0-9]+)?)"
    r"( (reliable|best_effort|volatile|transient_local|manual|(deadline|lease)=[0-9]+([.][0-9]+)?))*$"
)
PERCENT = r"(?!0+(\.0+)? ?%)(100|[1-9]?[0-9](\.[0-9]{1,4})?) ?%"
PORT = r"^[^\s\x00-\x1f\x7f/]([^\x00-\x1f\x7f/]*[^\s\x00-\x1f\x7f/])?$"

SHORT_FORM = "(short)"
"""How errors name the form of a port that is only a tag, or of a list that is one text."""
FULL_FORM = "(full)"
"""How errors name the form of a port that is a mapping, or of a list that is a list."""


T = TypeVar("T")


def _member(kind: type[Enum]) -> After:
    """Turn a checked text into the member of an enumeration.

    The class itself can't be the validator: since Python 3.12 its signature takes any number of values.
    """
    return After(lambda value: kind(value))


def _taken(convert: Callable[[Any], T], value: object) -> T:
    """Return the converted value; the domain's error becomes a refusal with the same words."""
    try:
        return convert(value)
    except InvalidValueError as error:
        message, _, mend = str(error).partition(": ")
        raise RefusedError(message, mend or "write a number") from None
    except DecimalException:
        raise RefusedError("the number is too large", "write a smaller one") from None


@lru_cache(maxsize=65536)
def _microseconds(value: Decimal | int) -> int:
    return _taken(microseconds, value)


def _number(value: object, is_what: str, kind: str = "number_type") -> Decimal | int:
    if type(value) is int or type(value) is Decimal:
        return value
    raise RefusedError(is_what, kind=kind)


def _cost(value: object) -> int:
    return _microseconds(_number(value, "a cost is a number of CPU seconds", "cost_type"))


def _seconds(value: object) -> int:
    return _microseconds(_number(value, "a time is a number of seconds", "time_type"))


def _silence(value: object) -> int:
    """Return how long a unit may be silent, in microseconds; 0: without limit."""
    silence_us = _seconds(value)
    _taken(lambda hang_us: RunOptions(hang_us=hang_us), silence_us)
    return silence_us


def _span(value: object) -> int:
    """A span of time that is not empty, in microseconds."""
    mend = "write a number of seconds above 0, or 500ms, 5s, 2m or 1h"
    number = span_s(value) if type(value) is str else value
    if type(number) is not int and type(number) is not Decimal:
        raise RefusedError("this is not a span of time", mend)
    span_us = _microseconds(number)
    if not span_us:
        raise RefusedError("the span of time is 0", mend)
    return span_us


def _whole(value: object) -> object:
    """The whole number of 2.0, as JSON Schema has it; anything else as it is."""
    is_whole = type(value) is Decimal and value.is_finite() and abs(value) < 2**63 and value == int(value)
    return int(value) if is_whole else value  # type: ignore[call-overload]


def _whole_span(value: object) -> object:
    """The seconds of a text such as 5m, if they are whole; a number as it is."""
    span = _whole(span_s(value) if type(value) is str else value)
    return span if type(span) is int else value


def _no_flag(value: object) -> object:
    """A number or a name; Python takes `true` for 1."""
    if type(value) is bool:
        raise RefusedError(f"this must be 0, 1, units or hosts, but is {str(value).lower()}", "write one of these")
    return value


def _rate(value: object) -> float:
    number = _finite_number(_number(value, "a rate is a number"))
    if number is None or not 0 < number <= LARGEST_RATE_HZ:
        raise RefusedError(
            f"a rate of {value} is out of range", f"write a number above 0 and up to {LARGEST_RATE_HZ:,}"
        )
    return float(number)


def _micro(value: object) -> int:
    return _taken(micro_units, _number(value, "a quality is a number"))


def _fact_number(value: object) -> int:
    """A fact that is a number, in millionths."""
    return _taken(lambda number: micro_units(number, LARGEST_FACT), _number(value, "this fact is a number"))


def _fact_value(value: object) -> FactValue:
    """True or false, a number in millionths, or a word."""
    if type(value) is bool:
        return value
    if type(value) is str and value.strip():
        return normal(value)
    if type(value) is int or type(value) is Decimal:
        return _fact_number(value)
    raise RefusedError("this can't be the value of a fact", "write a number, true, false or a word")


def _state(value: object) -> bool | str:
    """True or false, or the name of a state."""
    if type(value) is bool:
        return value
    if type(value) is str and re.fullmatch(STATE_NAME, value):
        return value
    mend = "write true, false or a name of letters, digits and underscores"
    raise RefusedError("this says of no state that it is kept", mend)


def _plain_fact(value: FactValue) -> object:
    return plain_quality(value) if type(value) is int else value


def _noise(value: object) -> Noise:
    """A standard deviation in millionths, or in millionths of the value."""
    if type(value) is str and re.fullmatch(PERCENT, value):
        return Noise(_micro(Decimal(value.rstrip("% "))) // 100, is_share=True)
    if type(value) is int or type(value) is Decimal:
        micro = _fact_number(value)
        if micro > 0:
            return Noise(micro)
    raise RefusedError("this can't be a noise", "write a standard deviation above 0, or a percentage such as 20 %")


def _positive_micro(value: object) -> int:
    micro = _micro(value)
    if micro < 0:
        raise RefusedError(f"{value} is negative", "write a number of 0 or more")
    return micro


def _finite(value: object) -> object:
    """Parameters as plain values: Decimal becomes float, which every file format can say again."""
    if type(value) is Decimal:
        number = float(value)
        if number - number != 0:
            raise RefusedError(f"{value} is not a finite number", "quote it")
        return number
    if type(value) is dict:
        return {key: _finite(item) for key, item in value.items()}
    if type(value) is list:
        return [_finite(item) for item in value]
    return value


def _params(value: object) -> object:
    if value is None:
        return {}
    if type(value) is not dict:
        raise RefusedError("params must be a mapping", kind="dict_type")
    return _finite(value)


def _finite_number(value: object) -> Decimal | int | None:
    """The value if it is a number that is finite; None for any other."""
    if isinstance(value, Decimal):
        return value if value.is_finite() else None
    return value if type(value) is int else None


def _amount(value: object) -> Decimal | int:
    number = _finite_number(value)
    if number is None or not 0 <= number <= LARGEST_AMOUNT:
        shown = repr(value) if type(value) is str else str(value)
        raise RefusedError(
            f"{shown} can't be an amount of a resource", f"write a whole number from 0 to {LARGEST_AMOUNT:,}"
        )
    return number


def _speed(value: object) -> int:
    """The speed of a host in millionths."""
    micro = _taken(micro_units, _number(value, "a speed is a number"))
    if not SPEEDS[0] * MICRO <= micro <= SPEEDS[1] * MICRO:
        mend = f"write a number from {SPEEDS[0]} to {SPEEDS[1]}; 1 is where costs were measured"
        raise RefusedError(f"{value} can't be the speed of a host", mend)
    return micro


def _resources(amounts: dict[str, Decimal | int]) -> dict[str, int]:
    """Amounts of resources by name: whole numbers, and for CPU time microseconds per second."""
    found = {name: _microseconds(amount) if name == CPU else _whole(amount) for name, amount in amounts.items()}
    parts = next((f"{amount} of `{name}`" for name, amount in found.items() if type(amount) is not int), None)
    if parts is not None:
        raise RefusedError(f"there can't be {parts}", "write a whole number; only cpu has parts")
    return {name: amount for name, amount in found.items() if type(amount) is int}


def _count(value: object) -> int:
    """How many streams an input takes."""
    if value == "all":
        return ALL
    value = _whole(value)
    if type(value) is not int or not 1 <= value <= MOST_COUNTED:
        raise RefusedError(
            f"{value} can't be a number of streams", f"write a whole number from 1 to {MOST_COUNTED}, or all"
        )
    return value


def _once_each(values: list[T]) -> list[T]:
    """A list whose entries differ."""
    seen = set[T]()
    for value in values:
        if value in seen:
            raise RefusedError(f"`{value}` is written twice in this list", "remove one of the two")
        seen.add(value)
    return values


_UNIQUE = MoreSchema({"uniqueItems": True})
_ONCE_EACH = After(_once_each), _UNIQUE


def form_of(value: object) -> str:
    """The form that an author chose among two, so that errors are about that one only."""
    return FULL_FORM if isinstance(value, dict | list) else SHORT_FORM


def list_or_mapping(value: object) -> str:
    """The same where the short form is a list, and the full one a mapping."""
    return FULL_FORM if isinstance(value, dict) else SHORT_FORM


@dataclass(frozen=True, slots=True)
class Selects:
    """Marks a text that chooses hosts by their labels."""


@dataclass(frozen=True, slots=True)
class Written:
    """The written form of a domain's value, if that is not the value itself."""

    plain: Callable[[Any], object]


def plain_cost(cost_us: int) -> Decimal | int:
    """Return a cost in CPU seconds, or a time in seconds; an int if it is whole."""
    return _whole_if_it_is(seconds(cost_us))


def plain_quality(micro: int) -> Decimal | int:
    """Return a value of a quality attribute; an int if it is whole."""
    return _whole_if_it_is(units(micro))


def _whole_if_it_is(value: Decimal) -> Decimal | int:
    return int(value) if value == value.to_integral_value() else value


FileName = Annotated[str, Limits(pattern=NAME_PATTERN)]
"""A file's name, kept as written; all other names are normalised."""
FileList = Annotated[list[FileName], *_ONCE_EACH]
Name = Annotated[FileName, After(normal)]
Names = Annotated[list[Name], *_ONCE_EACH]
PortName = Annotated[str, Limits(pattern=PORT), After(normal)]
StreamName = Annotated[Name, Schema({"type": "string", "pattern": rf"^(?=.+/[^/]+$){NAME_PATTERN[1:]}"})]
"""UNIT/PORT; a missing slash has an error message of its own."""
StreamNames = Annotated[list[StreamName], _UNIQUE]
"""Streams that feed an input; a repeated stream has an error message of its own."""
TagText = Annotated[
    str, Limits(min_length=1), Described("a concept in description logic, or the paper's P(a)"), After(normal)
]
SelectorText = Annotated[
    str, Limits(min_length=1), Described("labels joined by and, or and not"), After(normal), Selects()
]
RequirementText = Annotated[
    str, Limits(min_length=1), Described("comparisons of facts joined by and, or and not"), After(normal)
]
TwoSelectors = Annotated[list[SelectorText], Limits(min_length=2, max_length=2)]
"""The two ends of a link."""
QosText = Annotated[str, Limits(pattern=QOS), Described("words of a quality of service in ROS 2")]
Whole = Annotated[int, Before(_whole)]
_SECONDS = {"type": "number", "minimum": 0, "maximum": LARGEST_COST_US / MICROSECONDS}
_QUALITY = {"type": "number", "minimum": 0, "maximum": LARGEST_QUALITY // MICRO}
_FACT = {"type": "number", "minimum": -LARGEST_FACT // MICRO, "maximum": LARGEST_FACT // MICRO}
_AMOUNT = {"minimum": 0, "maximum": LARGEST_AMOUNT}
Cost = Annotated[int, Instead(_cost), Schema(_SECONDS), Written(plain_cost)]
Seconds = Annotated[int, Instead(_seconds), Schema(_SECONDS), Written(plain_cost)]
HangTime = Annotated[
    int,
    Instead(_silence),
    Schema({"anyOf": [{"const": 0}, {**_SECONDS, "minimum": LEAST_HANG_S}]}),
    Written(plain_cost),
]
TimeSpan = Annotated[
    int,
    Instead(_span),
    Schema({"anyOf": [{**_SECONDS, "exclusiveMinimum": 0}, {"type": "string", "pattern": SPAN}]}),
    Written(plain_cost),
]
_HORIZON = {"type": "integer", "minimum": 0, "maximum": LONGEST_HORIZON_S}
Horizon = Annotated[
    int,
    Limits(ge=0, le=LONGEST_HORIZON_S),
    Before(_whole_span),
    Schema({"anyOf": [_HORIZON, {"type": "string", "pattern": SPAN}]}),
]
Rate = Annotated[
    float,
    Instead(_rate),
    Schema({"type": "number", "exclusiveMinimum": 0, "maximum": LARGEST_RATE_HZ}),
    Written(lambda rate_hz: Decimal(repr(rate_hz))),
]
Micro = Annotated[
    int,
    Instead(_micro),
    Schema({**_QUALITY, "minimum": -LARGEST_QUALITY // MICRO}),
    Written(plain_quality),
]
PositiveMicro = Annotated[int, Instead(_positive_micro), Schema(_QUALITY), Written(plain_quality)]
Fact = Annotated[
    bool | int | str,
    Instead(_fact_value),
    Schema(
        {
            "anyOf": [
                {"type": "boolean"},
                _FACT,
                {"type": "string", "pattern": r"\S"},
            ]
        }
    ),
    Written(_plain_fact),
]
"""The value of a fact."""
FactNumber = Annotated[int, Instead(_fact_number), Schema(_FACT), Written(plain_quality)]
Point = Annotated[
    list[FactNumber],
    Limits(min_length=2, max_length=2),
    MoreSchema({"allOf": [{"prefixItems": [{}, {**_QUALITY, "minimum": -LARGEST_QUALITY // MICRO}]}]}),
]
"""A value of a fact, and the quality there."""
StateName = Annotated[
    bool | str,
    Instead(_state),
    Schema({"anyOf": [{"type": "boolean"}, {"type": "string", "pattern": f"^{STATE_NAME}$"}]}),
]
"""Whether a state is kept, or its name."""
NoiseText = Annotated[
    Noise,
    Instead(_noise),
    Schema({"anyOf": [{**_FACT, "minimum": 0, "exclusiveMinimum": 0}, {"type": "string", "pattern": f"^{PERCENT}$"}]}),
    Written(lambda noise: str(noise) if noise.is_share else plain_quality(noise.amount)),
]
Speed = Annotated[
    int,
    Instead(_speed),
    Schema({"type": "number", "minimum": float(SPEEDS[0]), "maximum": SPEEDS[1]}),
    Written(plain_quality),
]
Count = Annotated[
    int,
    Instead(_count),
    Schema({"anyOf": [{"const": "all"}, {"type": "integer", "minimum": 1, "maximum": MOST_COUNTED}]}),
    Written(lambda count: "all" if count == ALL else count),
]
Resources = Annotated[
    dict[Name, Annotated[Decimal | int, Instead(_amount)]],
    After(_resources),
    Schema(
        {
            "type": "object",
            "patternProperties": {
                f"^{CPU}$": {"type": "number", **_AMOUNT},
                f"^(?!{CPU}$){NAME_PATTERN[1:]}": {"type": "integer", **_AMOUNT},
            },
        }
    ),
]
Survived = Annotated[Literal[0, 1, "units", "hosts"], Before(_whole), Before(_no_flag)]
Params = Annotated[dict[str, Any], Instead(_params), Schema({"type": ["object", "null"]})]
ObjectiveName = Annotated[Literal["rent", "cost", "units", "hosts", "rewired", "started"], _member(Objective)]
Objectives = Annotated[list[ObjectiveName], *_ONCE_EACH, Written(lambda named: [one.value for one in named])]
BetterName = Annotated[Literal["lower", "higher"], _member(Better), Written(str)]
RuleName = Annotated[Literal["add", "limit", "scale", "set"], _member(QualityRule), Written(str)]
InputKind = Annotated[
    Literal["stream", "service"],
    After(lambda kind: kind == "service"),
    Written(lambda is_service: "service" if is_service else "stream"),
]
WhenFull = Annotated[
    Literal["drop_oldest", "block"],
    After(lambda how: how == "block"),
    Written(lambda blocks: "block" if blocks else "drop_oldest"),
]
"""Whether a producer waits (True) or the oldest element is dropped."""
