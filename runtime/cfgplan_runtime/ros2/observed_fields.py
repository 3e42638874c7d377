"""Fields of `observe` that a port's message type does not have."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from cfgplan.domain import Environment, Statement
from cfgplan.errors import InputError
from cfgplan.ros.types import MessageType
from cfgplan_runtime.nodes.message_layout import field_fault
from cfgplan_runtime.ros2.definitions import Definitions


@dataclass(frozen=True)
class FieldFault:
    """An output whose messages can't say a quality by the field that the file names, and why."""

    statement: Statement
    field: str
    cause: str


def field_faults(environment: Environment, folder: Path) -> Iterator[FieldFault]:
    """Yield the wrong fields of outputs whose message types are known. Definitions of one's own are found in `folder`.

    Raises InputError without the package that has the definitions of ROS.
    """
    stated = [
        statement
        for statement in environment.observable
        if _type_of(environment, statement) is not None and not _is_no_field(environment, statement)
    ]
    if not stated:
        return
    definitions = Definitions(folder=folder)
    for statement in stated:
        contribution, kind = environment.stated(statement), _type_of(environment, statement)
        assert contribution is not None and contribution.observe is not None and kind is not None
        if kind.kind != "msg":
            yield FieldFault(statement, contribution.observe, f"calls of {kind} are not observed")
            continue
        try:
            layout = definitions.layout(kind)
        except InputError:
            continue
        if cause := field_fault(layout, contribution.observe):
            yield FieldFault(statement, contribution.observe, cause)


def _is_no_field(environment: Environment, statement: Statement) -> bool:
    contribution = environment.stated(statement)
    return contribution is not None and (contribution.measured is not None or contribution.told is not None)


def _type_of(environment: Environment, statement: Statement) -> MessageType | None:
    """Return the message type of a statement's output; None if the file has none, or one that is wrong."""
    written = environment.transformation[statement.transformation].output[statement.output].type
    try:
        return None if written is None else MessageType.read(written)
    except InputError:
        return None
