"""Observed facts and qualities as JSON: `ctl observed --out` writes the file, and `--observed` of commands reads it.

Qualities are in units of their attributes, factors are plain numbers. Only `facts` and `planned` are read back.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import replace
from decimal import Decimal
from pathlib import Path as FilePath
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from cfgplan.domain import Environment, Statement
from cfgplan.errors import Fault, InputError, InvalidValueError, did_you_mean
from cfgplan.facts import FactValue, kind_of
from cfgplan.formats.files import read_text
from cfgplan.formats.json_text import read_json
from cfgplan.formats.places import Source
from cfgplan.formats.schema_faults import schema_faults
from cfgplan.qualities import LARGEST_QUALITY, micro_units

_ANEW = "write the file again with `cfgplan ctl observed --out FILE`, or remove this"


class _ObservedPart(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)


class QualityPart(_ObservedPart):
    """The learned quality of an output in one attribute."""

    output: str = Field(description="transformation/port")
    attribute: str
    host: str | None = Field(default=None, description="where it was learned; absent: no hosts, or all others")
    declared: Any = Field(default=None, description="what the environment file says")
    planned: Any = Field(description="what plans go by")
    estimate: Any = Field(default=None, description="the mean of what is known now")
    error: Any = Field(default=None, description="the standard error of the estimate")
    ago_s: Any = Field(default=None, description="seconds since it was observed last")


class ObservedPart(_ObservedPart):
    """Facts and qualities as a run knows them."""

    model_config = ConfigDict(extra="forbid", strict=True, title="cfgplan observed")

    format_version: Literal[1]
    facts: dict[str, Any] = Field(default={}, description="name to value")
    qualities: list[QualityPart] = []


def observed_text(facts: Mapping[str, str], qualities: list[dict[str, Any]]) -> str:
    """The JSON text of facts, and of qualities as the control method `state` gives them."""
    return (
        json.dumps({"format_version": 1, "facts": facts, "qualities": qualities}, indent=2, ensure_ascii=False) + "\n"
    )


def read_observed(path: str | os.PathLike[str], environment: Environment) -> Environment:
    """Return the environment with the facts and qualities of a file.

    Raises InputError, also for facts and qualities that the environment does not have.
    """
    source = read_json(read_text(FilePath(path)), str(path), "`cfgplan ctl observed --out`")
    if source.faults:
        raise InputError(source.faults)
    try:
        part = ObservedPart.model_validate(source.data)
    except ValidationError as error:
        raise InputError(schema_faults(source, (), error.errors(include_url=False), ObservedPart)) from None
    faults: list[Fault] = []
    facts = _facts(source, part, environment, faults)
    environment = environment.with_facts(facts)
    qualities = _qualities(source, part, environment, faults)
    if faults:
        raise InputError(faults)
    return environment.with_qualities(qualities)


def _facts(source: Source, part: ObservedPart, environment: Environment, faults: list[Fault]) -> dict[str, FactValue]:
    found: dict[str, FactValue] = {}
    for name, value in part.facts.items():
        place = ("facts", name)
        if name not in environment.variable:
            message = f"the environment has no fact `{name}`"
            faults.append(source.fault(place, message, did_you_mean(name, environment.variable, _ANEW)))
            continue
        if not isinstance(value, bool | int | Decimal | str):
            kind, written = kind_of(environment.variable[name].declared), json.dumps(value, default=float)
            faults.append(source.fault(place, f"fact {name!r} is {kind}, not {written}", _ANEW))
            continue
        try:
            written = str(value).lower() if isinstance(value, bool) else str(value)
            found[name] = environment.variable[name].read(written)
        except InvalidValueError as error:
            faults.append(source.fault(place, str(error), _ANEW))
    return found


def _qualities(
    source: Source, part: ObservedPart, environment: Environment, faults: list[Fault]
) -> dict[Statement, int]:
    """The deviations of outputs from their stated values, in micro-units."""
    found: dict[Statement, int] = {}
    for index, one in enumerate(part.qualities):
        place = ("qualities", index)
        label, _, port = one.output.rpartition("/")
        statement = Statement(label, port, one.attribute, one.host)
        stated = environment.stated(statement)
        if one.host is not None and one.host not in environment.host:
            mend = did_you_mean(one.host, environment.host, _ANEW)
            faults.append(source.fault((*place, "host"), f"the environment has no host `{one.host}`", mend))
            continue
        if stated is None:
            faults.append(source.fault((*place, "output"), f"the environment states no {statement}", _ANEW))
            continue
        if statement in found:
            faults.append(source.fault((*place, "output"), f"{statement} is there twice", _ANEW))
            continue
        try:
            planned = _micro_units(one.planned)
            replace(stated, value=planned, seen=0, seen_on=())  # raises if the rule does not allow the value
            found[statement] = planned - stated.stated
        except InvalidValueError as error:
            faults.append(source.fault((*place, "planned"), str(error), _ANEW))
    return found


def _micro_units(written: object) -> int:
    """A number of the file, rounded to a millionth. Raises InvalidValueError for what is none, or far too large."""
    if isinstance(written, bool) or not isinstance(written, int | float | Decimal):
        raise InvalidValueError(f"{written!r} is not a number")
    number = Decimal(written)
    is_near = number.is_finite() and -LARGEST_QUALITY <= number <= LARGEST_QUALITY
    return micro_units(round(number, 6) if is_near else number)
