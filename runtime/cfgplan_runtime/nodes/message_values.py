"""Values of messages as rosbags reads them: mappings by field, and arrays of numbers."""

from __future__ import annotations

from collections.abc import Callable
from operator import attrgetter
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy

if TYPE_CHECKING:
    from rosbags.interfaces.typing import FieldDesc
    from rosbags.typesys.store import Typestore

Change: TypeAlias = Callable[[Any], Any]
FILLER = "structure_needs_at_least_one_member"
"""The field that a message without fields has on the wire."""


class MessageValues:
    """Makes values of messages, by type."""

    def __init__(self, store: Typestore) -> None:
        self._store = store
        self._made: dict[str, Change] = {}

    def change(self, name: str) -> Change:
        """How a message of a type becomes a value."""
        if name not in self._made:
            fields = self._store.fielddefs[name][1]
            attributes = [key for key, _ in self._store.get_msgdef(name).fields]
            rows = [
                (field, attrgetter(attribute), self._field(what))
                for (field, what), attribute in zip(fields, attributes, strict=True)
                if field != FILLER
            ]
            self._made[name] = lambda message: {field: change(get(message)) for field, get, change in rows}
        return self._made[name]

    def _field(self, what: FieldDesc) -> Change:
        from rosbags.interfaces import Nodetype

        if what[0] == Nodetype.NAME:
            return self.change(what[1])
        if what[0] == Nodetype.BASE:
            return (lambda value: value & 0xFF) if what[1][0] == "byte" else _as_it_is
        inner = what[1][0]
        if inner[0] == Nodetype.BASE:
            return (lambda array: array.view(numpy.uint8)) if inner[1][0] == "byte" else _as_it_is
        change = self._field(inner)
        return lambda messages: [change(message) for message in messages]


def _as_it_is(value: Any) -> Any:
    return value
