"""Explanations as mappings and lists, for JSON."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from fractions import Fraction
from typing import Any

from cfgplan.planning import Plan


def plain(value: object) -> Any:
    """An explanation as JSON values. A plan becomes its status, cost and bound; a fraction becomes text."""
    match value:
        case Enum():
            return value.value
        case Fraction():
            return value.numerator if value.denominator == 1 else str(value)
        case Plan():
            return {"status": value.status.value, "cost_us": value.cost_us, "bound_us": value.bound_us}
        case Mapping():
            return {name: plain(member) for name, member in value.items()}
        case frozenset():
            return sorted(map(plain, value))
        case tuple():
            return [plain(member) for member in value]
    if is_dataclass(value):
        return {field.name: plain(getattr(value, field.name)) for field in fields(value)}
    return value
