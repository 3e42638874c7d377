"""The JSON Schemas of recorded messages, derived from the types of reports: no field is written down twice.

A recorded message leaves out unknown values, so that each field has one type, as plotting programs need it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import cache
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import msgspec

from cfgplan.domain import ChangeSet, Stream
from cfgplan_runtime.lifecycle.perturbations import Perturbation
from cfgplan_runtime.lifecycle.reports import PHASES, Report, Review, UnitEvent
from cfgplan_runtime.operating.protocol import Record
from cfgplan_runtime.supervision.events import Event
from cfgplan_runtime.supervision.observation import Observation

_PLAIN: Mapping[Any, str] = {bool: "boolean", int: "integer", float: "number", str: "string", bytes: "integer"}
_TEXT: Record = {"type": "string"}


def _object(properties: Record) -> Record:
    return {"type": "object", "properties": properties}


def _list(items: Record) -> Record:
    return {"type": "array", "items": items}


_WIRED = _object(
    {
        "id": _TEXT,
        "transformation": _TEXT,
        "inputs": {"type": "object"},
        "topics": {"type": "object"},
        "host": _TEXT,
        "standby": {"type": "boolean"},
    }
)
_CHANGES = _object({"started": _list(_WIRED), "rewired": _list(_WIRED), "stopped": _list(_TEXT)})


@cache
def units_form() -> Record:
    """The schema of `/cfgplan/units`."""
    unit = _form(Observation)
    for side in ("inputs", "outputs"):
        counts = unit["properties"][side]["additionalProperties"]
        unit["properties"][side] = _list(_object({"port": _TEXT, **counts["properties"]}))
    return _object({"units": _list(unit)})


@cache
def reviews_form() -> Record:
    """The schema of `/cfgplan/reviews`."""
    form = _form(Review)
    seconds = _object({phase: {"type": "number"} for phase in PHASES})
    return _object({**form["properties"], "seconds": seconds, "says": _TEXT})


@cache
def events_form() -> Record:
    """The schema of `/cfgplan/events`: all fields of all kinds."""
    kinds = [kind for kind in Report.__subclasses__() if kind is not UnitEvent]
    return _merged([_form(kind) for kind in (*kinds, Event)])


def known(value: Any) -> Any:
    """A record without fields that are None, at any depth."""
    if isinstance(value, dict):
        return {key: known(item) for key, item in value.items() if item is not None}
    return [known(item) for item in value] if isinstance(value, list) else value


def unit_record(seen: Mapping[str, Any]) -> Record:
    """An observation's record with its ports as lists, since no schema can know the ports' names."""
    sides = {side: [{"port": port, **counts} for port, counts in seen[side].items()] for side in ("inputs", "outputs")}
    return {**seen, **sides}


def _form(hint: Any) -> Record:
    """The JSON Schema of what `records.plain` makes of a value of a type.

    A union has the fields of all its members; a class with kinds has those of all its kinds.
    """
    origin, arguments = get_origin(hint), get_args(hint)
    if hint in _PLAIN:
        return {"type": _PLAIN[hint]}
    if hint is ChangeSet:
        return _CHANGES
    if origin in (Union, UnionType):
        return _merged([_form(each) for each in arguments if each is not NoneType])
    if kinds := hint.__subclasses__() if hint in (Event, Perturbation) else ():
        return _merged([_form(kind) for kind in kinds])
    if origin is Literal or hint is Stream or (isinstance(hint, type) and issubclass(hint, Enum)):
        return _TEXT
    if origin is not None and issubclass(origin, Mapping):
        return {"type": "object", "additionalProperties": _form(arguments[1])}
    if origin in (tuple, list, frozenset):
        return _list(_form(arguments[0]))
    if is_dataclass(hint):
        names = [field.name for field in fields(hint)]
    elif isinstance(hint, type) and issubclass(hint, msgspec.Struct):
        names = list(hint.__struct_fields__)
    else:
        return _TEXT
    hints = get_type_hints(hint)
    return _object({"kind": _TEXT, **{name: _form(hints[name]) for name in names}})


def _merged(forms: list[Record]) -> Record:
    if len({form["type"] for form in forms}) > 1 or forms[0]["type"] != "object":
        return forms[0]
    properties: Record = {}
    for form in forms:
        for name, inner in form.get("properties", {}).items():
            properties.setdefault(name, inner)
    return _object(properties)
