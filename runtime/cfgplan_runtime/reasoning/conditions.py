"""What a formula can say of one state: comparisons, membership in a region, relations between regions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

RCC8 = ("dc", "ec", "po", "tpp", "ntpp", "tppi", "ntppi", "eq")
"""Disconnected, externally connected, partially overlapping, (non-)tangential proper part and its inverse, equal."""


@dataclass(frozen=True, slots=True)
class Field:
    """A feature's value, or what stands in it under these keys and list positions."""

    feature: str
    keys: tuple[str | int, ...] = ()

    def __str__(self) -> str:
        return self.feature + "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in self.keys)


@dataclass(frozen=True, slots=True)
class Literal:
    """A number, a text or a truth value."""

    value: float | str | bool

    def __str__(self) -> str:
        if isinstance(self.value, float):
            return f"{self.value:.15g}"
        return f'"{self.value}"' if isinstance(self.value, str) else str(self.value).lower()


@dataclass(frozen=True, slots=True)
class Arithmetic:
    """Two numbers joined by one of + - * /."""

    sign: str
    left: Value
    right: Value

    def __str__(self) -> str:
        return f"({self.left} {self.sign} {self.right})"


@dataclass(frozen=True, slots=True)
class Absolute:
    """A number without its sign."""

    part: Value

    def __str__(self) -> str:
        return f"abs({self.part})"


@dataclass(frozen=True, slots=True)
class Distance:
    """How far two points are apart."""

    left: Field
    right: Field

    def __str__(self) -> str:
        return f"distance({self.left}, {self.right})"


Value: TypeAlias = Field | Literal | Arithmetic | Absolute | Distance


@dataclass(frozen=True, slots=True)
class Comparison:
    """Two numbers, or two texts, compared by `<=`, `>=`, `==`, `!=`, `<` or `>`."""

    sign: str
    left: Value
    right: Value

    def __str__(self) -> str:
        return f"{self.left} {self.sign} {self.right}"


@dataclass(frozen=True, slots=True)
class Flag:
    """A field that is true or false."""

    field: Field

    def __str__(self) -> str:
        return str(self.field)


@dataclass(frozen=True, slots=True)
class RegionName:
    """A region that the features file or the command line names."""

    name: str

    def __str__(self) -> str:
        return self.name


@dataclass(frozen=True, slots=True)
class Membership:
    """A point in a region or on its edge."""

    point: Field
    region: RegionName | Field

    def __str__(self) -> str:
        return f"in({self.point}, {self.region})"


@dataclass(frozen=True, slots=True)
class Relation:
    """One of the RCC8 relations between two regions."""

    name: str
    left: RegionName | Field
    right: RegionName | Field

    def __str__(self) -> str:
        return f"{self.name}({self.left}, {self.right})"


Condition: TypeAlias = Comparison | Flag | Membership | Relation
