"""Units of outside protocols: how they print, wait and take their one input."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from cfgplan_runtime.errors import WrongPortsError

ORDERS_LOOK_S: Final = 0.05
"""A source that gets no messages looks for orders so often."""


def words_of(error: object) -> str:
    """Return the message of an error, without the number of a system error."""
    return getattr(error, "strerror", None) or str(error)


def say(text: str) -> None:
    """Report a line: the run shows each line that a unit prints."""
    print(text, flush=True)  # noqa: T201


def only_value(inputs: Mapping[str, object]) -> object:
    """The value at the one input of a publisher. Raises WrongPortsError if it has none or several."""
    if len(inputs) != 1:
        raise WrongPortsError(f"a publisher has one input, not {len(inputs)}")
    (value,) = inputs.values()
    return value
