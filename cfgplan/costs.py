"""Labor, upkeep and horizon as one integer cost in microseconds of CPU time (Definition 8)."""

from __future__ import annotations

import re
from collections.abc import Mapping
from decimal import Decimal
from types import MappingProxyType

from cfgplan.amounts import MICROSECONDS
from cfgplan.domain import CPU, Host, OutputPort, Transformation
from cfgplan.errors import InvalidValueError
from cfgplan.qualities import MICRO

LARGEST_COST_US = 2**53 - 1
"""Above this a sum of costs is no longer exact in every engine: about 285 years of CPU time."""

LONGEST_HORIZON_S = 1_000_000_000

SPAN = r"^(\d+(?:\.\d+)?)(ms|s|m|h)$"
"""A span of time as people write it."""
_SECONDS_OF = {"ms": Decimal("0.001"), "s": Decimal(1), "m": Decimal(60), "h": Decimal(3600)}


def span_s(text: str) -> Decimal | None:
    """The seconds of 30s, 1.5m, 200ms or 2h; None for any other text."""
    found = re.fullmatch(SPAN, text)
    return None if found is None else Decimal(found[1]) * _SECONDS_OF[found[2]]


_MEANT_SECONDS = {**_SECONDS_OF, "d": Decimal(86_400), "%": Decimal("0.01")}
_WORDS_OF_TIME = r"(ms|msecs?|milliseconds?|s|secs?|seconds?|m|mins?|minutes?|h|hrs?|hours?|d|days?|%)"


def guessed_s(text: str) -> Decimal | None:
    """Guess the seconds, or the share of a core, meant by a text like 0,2, 500 ms, 10 min, 20 % or 1d; else None.

    A comma before exactly three digits is ambiguous (it may separate thousands): None.
    """
    found = re.fullmatch(rf"(\d{{1,12}}(?:[.,]\d{{1,12}})?) ?{_WORDS_OF_TIME}?", text.strip(), re.IGNORECASE)
    if found is None or re.fullmatch(r"\d+,\d{3}", found[1]):
        return None
    unit = (found[2] or "s").lower()
    short = "ms" if unit.startswith(("ms", "mil")) else unit[0]
    return Decimal(found[1].replace(",", ".")) * _MEANT_SECONDS[short]


def is_negative(text: str) -> bool:
    """Whether a text means a number below 0, perhaps with a unit."""
    return re.match(r"\s*-\s*\.?\d", text) is not None


def horizon_s(text: str) -> int:
    """A horizon in whole seconds: 60, 60s, 10m or 1h; raises InvalidValueError for anything else."""
    seconds = Decimal(text) if text.isdecimal() else span_s(text)
    if is_negative(text):
        raise InvalidValueError(f"{text!r} is negative: write whole seconds of 0 or more, or 30s, 10m or 1h")
    if seconds is None or seconds != int(seconds):
        raise InvalidValueError(f"{text!r} is not a horizon: write whole seconds, or 30s, 10m or 1h")
    if seconds > LONGEST_HORIZON_S:
        raise InvalidValueError(f"{text!r} is too long: write at most {LONGEST_HORIZON_S} seconds")
    return int(seconds)


def microseconds(seconds: Decimal | int) -> int:
    """Convert CPU seconds exactly; raises InvalidValueError for a negative, non-finite or too fine value."""
    value = Decimal(seconds)
    if not value.is_finite():
        raise InvalidValueError(f"{seconds} is not a finite number of seconds")
    if value < 0:
        raise InvalidValueError(f"{seconds} is negative: write a number of 0 or more")
    if value > Decimal(LARGEST_COST_US) / MICROSECONDS:
        raise InvalidValueError(f"{seconds} is too large: the limit is {LARGEST_COST_US // MICROSECONDS} seconds")
    if value != round(value, 6):
        raise InvalidValueError(f"{seconds} is finer than a microsecond: write at most six decimals")
    return int(value * MICROSECONDS)


def seconds(cost_us: int) -> Decimal:
    """The cost in CPU seconds, exactly."""
    return (Decimal(cost_us) / MICROSECONDS).normalize()


def labor_us(transformation: Transformation, host: Host | None = None) -> int:
    """Return the CPU time of a start on a host."""
    return _on(host, transformation, 0, transformation.labor_us)


def upkeep_us(transformation: Transformation, host: Host | None = None) -> int:
    """Return the CPU time that a running unit takes on a host each second."""
    return _on(host, transformation, 1, transformation.upkeep_us)


def _on(host: Host | None, transformation: Transformation, which: int, usual_us: int) -> int:
    """Return a unit's cost on a host: the one observed there, else `usual_us` divided by the host's speed, rounded up.

    `which` is 0 for labor, 1 for upkeep.
    """
    if host is None:
        return usual_us
    seen_us = transformation.seen_us.get(host.name)
    return -(-usual_us * MICRO // host.speed) if seen_us is None else seen_us[which]


def keep_cost_us(transformation: Transformation, horizon_s: int, host: Host | None = None) -> int:
    """Return the cost of a kept unit over the horizon: its upkeep."""
    return upkeep_us(transformation, host) * horizon_s


def start_cost_us(transformation: Transformation, horizon_s: int, host: Host | None = None) -> int:
    """Return the cost of a new unit over the horizon: its labor and its upkeep."""
    if host is None:  # as the general case says, in a third of the time: planning asks this of whole libraries
        return transformation.labor_us + transformation.upkeep_us * horizon_s
    return labor_us(transformation, host) + keep_cost_us(transformation, horizon_s, host)


def standby_cost_us(transformation: Transformation, horizon_s: int, host: Host | None = None) -> int:
    """Return the cost of a cold spare over the horizon: its standby cost. Its labor is paid only when it has
    to start.
    """
    speed = MICRO if host is None else host.speed
    return -(-(transformation.standby_us or 0) * MICRO // speed) * horizon_s


def taken(transformation: Transformation, host: Host | None) -> Mapping[str, int]:
    """Return the resources that a unit takes on a host; see `Transformation.takes`."""
    if host is None or (host.speed == MICRO and host.name not in transformation.seen_us):
        return transformation.takes
    return MappingProxyType({**transformation.takes, CPU: upkeep_us(transformation, host)})


def transfer_cost_us(output: OutputPort, horizon_s: int, price_us: int) -> int:
    """Return the cost over the horizon of carrying a stream to one more host, rounded up.

    `price_us` is for a megabyte (10**6 bytes).
    """
    return -(-output.bytes_per_s * horizon_s * price_us // 1_000_000)
