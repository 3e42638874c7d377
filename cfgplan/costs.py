"""Labor, upkeep and horizon as one integer cost in microseconds of CPU time (Definition 8)."""

from __future__ import annotations

from decimal import Decimal

from cfgplan.domain import OutputPort, Transformation
from cfgplan.errors import InvalidValueError

MICROSECONDS = 1_000_000
MILLISECONDS = MICROSECONDS // 1000
LARGEST_COST_US = 2**53 - 1
"""Above this a sum of costs is no longer exact in every engine: about 285 years of CPU time."""


def microseconds(seconds: Decimal | int) -> int:
    """Convert CPU seconds exactly; raises InvalidValueError for a negative, non-finite or too fine value."""
    value = Decimal(seconds)
    if not value.is_finite():
        raise InvalidValueError(f"{seconds} is not a finite number of seconds")
    if value < 0:
        raise InvalidValueError(f"{seconds} is negative: a cost is at least 0")
    if value * MICROSECONDS > LARGEST_COST_US:
        raise InvalidValueError(f"{seconds} is too large: the limit is {LARGEST_COST_US // MICROSECONDS} seconds")
    if value != round(value, 6):
        raise InvalidValueError(f"{seconds} is finer than a microsecond: write at most six decimals")
    return int(value * MICROSECONDS)


def seconds(cost_us: int) -> Decimal:
    """The cost in CPU seconds, exactly."""
    return (Decimal(cost_us) / MICROSECONDS).normalize()


def keep_cost_us(transformation: Transformation, horizon_s: int) -> int:
    """What a unit that runs on costs over the horizon: its upkeep."""
    return transformation.upkeep_us * horizon_s


def start_cost_us(transformation: Transformation, horizon_s: int) -> int:
    """What a new unit costs over the horizon: its labor, then its upkeep."""
    return transformation.labor_us + keep_cost_us(transformation, horizon_s)


def standby_cost_us(transformation: Transformation, horizon_s: int) -> int:
    """What a cold spare costs over the horizon: being ready. Its labor is paid when it has to start."""
    return (transformation.standby_us or 0) * horizon_s


def transfer_cost_us(output: OutputPort, horizon_s: int, price_us: int) -> int:
    """What a stream costs over the horizon for each host it is carried to, at a price for a megabyte, rounded up."""
    return -(-output.bytes_per_s * horizon_s * price_us // 1_000_000)
