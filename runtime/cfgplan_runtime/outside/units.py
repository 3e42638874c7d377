"""Units of outside protocols: how they print, wait and take their one input."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping
from typing import Any, Final

from cfgplan.errors import InputError
from cfgplan_runtime.errors import WrongPortsError
from cfgplan_runtime.outside.credentials import check_names
from cfgplan_runtime.outside.payload_forms import PayloadReader

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


def check_call(kind: Callable[..., Any], protocol: str, connection: Iterable[str], params: Mapping[str, Any]) -> None:
    """Raise InputError if params are unknown to a class of unit code, missing, or have a wrong value.

    Params of type `str` must be texts, `payload` a known form, and `field` a field of messages in it. `connection` has
    the names of the params that the class passes on to its connection.
    """
    own = [one for one in inspect.signature(kind).parameters.values() if one.kind is not one.VAR_KEYWORD]
    check_names(protocol, [*(one.name for one in own), *connection], params)
    lacking = [f"`{one.name}`" for one in own if one.default is one.empty and one.name not in params]
    if lacking:
        raise InputError.of(f"`params` has no {' and no '.join(lacking)}", mend="add it to `params`")
    for one in own:
        if one.annotation == "str" and not isinstance(text := params.get(one.name, ""), str):
            raise InputError.of(f"`{one.name}` must be a text, but is {text!r}", mend="put quotes around it")
    PayloadReader(str(params.get("payload", "json")), params.get("field"), say)
