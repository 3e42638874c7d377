"""Frozen classes of `cfgplan.frozen` behave as the standard decorator's do, and the usual commands make no others."""

import copy
import dataclasses
import inspect
import pickle
import subprocess
import sys
from collections.abc import Callable
from dataclasses import FrozenInstanceError, dataclass, field, fields, is_dataclass, replace
from itertools import product
from typing import Any, ClassVar

import pytest

from cfgplan import frozen

OPTIONS = [
    {"frozen": True, "slots": slots, "order": order, "eq": eq}
    for slots, order, eq in product((False, True), repeat=3)
    if eq or not order
]


def _made(decorator: Callable[..., Any], options: dict[str, bool]) -> Any:
    @decorator(**options)
    class Sample:
        """A value."""

        a: int
        b: str = "b"
        c: list[int] = field(default_factory=list, compare=False)
        d: int = field(default=4, repr=False, hash=False)
        e: int = field(default=5, init=False)
        f: int = field(default=6, kw_only=True)
        KIND: ClassVar[int] = 7

    return Sample


Slim: Any = _made(frozen.dataclass, {"frozen": True, "slots": True})
Slim.__qualname__ = "Slim"
Wide: Any = _made(frozen.dataclass, {"frozen": True})
Wide.__qualname__ = "Wide"


@pytest.mark.parametrize("options", OPTIONS, ids=str)
def test_a_frozen_class_behaves_as_the_standard_decorators(options: dict[str, bool]) -> None:
    ours, theirs = _made(frozen.dataclass, options), _made(dataclass, options)
    assert str(inspect.signature(ours)) == str(inspect.signature(theirs))
    assert ours.__match_args__ == theirs.__match_args__
    assert ours.__doc__ == theirs.__doc__
    assert hasattr(ours(1), "__dict__") is hasattr(theirs(1), "__dict__")
    assert is_dataclass(ours)
    assert [str(each) for each in fields(ours)] == [str(each) for each in fields(theirs)]
    given = [((1,), {}), ((1, "b", [3], 4), {"f": 6}), ((2,), {"d": 9}), ((1, "a"), {}), ((1,), {"f": 5})]
    mine = [ours(*args, **more) for args, more in given]
    other = [theirs(*args, **more) for args, more in given]
    assert [repr(each) for each in mine] == [repr(each) for each in other]
    for (left, right), (left_other, right_other) in zip(product(mine, mine), product(other, other), strict=True):
        assert (left == right) is (left_other == right_other)
        assert not options["order"] or (left < right, left >= right) == (
            left_other < right_other,
            left_other >= right_other,
        )
    if options["eq"]:
        assert [hash(each) for each in mine] == [hash(each) for each in other]
    assert mine[0] != 1
    assert replace(mine[0], a=3).a == 3
    assert dataclasses.asdict(mine[1]) == dataclasses.asdict(other[1])
    for name in ("a", "unknown"):
        with pytest.raises((FrozenInstanceError, AttributeError)):
            setattr(mine[0], name, 1)
        with pytest.raises((FrozenInstanceError, AttributeError)):
            delattr(mine[0], name)
    with pytest.raises(FrozenInstanceError):
        mine[0].a = 1
    with pytest.raises(TypeError):
        ours()
    with pytest.raises(TypeError):
        ours(1, "b", [], 4, 5)


@pytest.mark.parametrize("made", [Slim, Wide], ids=["slots", "no slots"])
def test_a_value_is_hashed_compared_copied_and_pickled_before_any_other_is_made(made: Any) -> None:
    value = made(1, c=[2])
    for twin in (pickle.loads(pickle.dumps(value)), copy.copy(value), copy.deepcopy(value)):
        assert twin == value
        assert hash(twin) == hash(value)
        assert twin.c == [2]


def test_a_class_keeps_its_own_methods() -> None:
    @frozen.dataclass(frozen=True)
    class Own:
        a: int
        b: int = 0

        def __eq__(self, other: object) -> bool:
            return isinstance(other, Own) and other.a == self.a

        def __hash__(self) -> int:
            return 3

        def __repr__(self) -> str:
            return "own"

        def __post_init__(self) -> None:
            if self.a < 0:
                raise ValueError("negative")

    assert Own(1, 2) == Own(1, 3)
    assert hash(Own(1)) == 3
    assert repr(Own(1)) == "own"
    with pytest.raises(ValueError, match="negative"):
        Own(-1)


def test_heirs_are_made_by_the_standard_decorator() -> None:
    @frozen.dataclass(frozen=True)
    class Base:
        a: int

    @frozen.dataclass(frozen=True)
    class Heir(Base):
        b: int = 2

    @dataclass(frozen=True)
    class Other(Base):
        b: int = 2

    assert repr(Heir(1)).endswith("Heir(a=1, b=2)")
    assert Heir(1) == Heir(1)
    assert Heir(1) != Other(1)
    with pytest.raises(FrozenInstanceError):
        Other(1).a = 2  # type: ignore[misc]


_STANDARD = """
import dataclasses, sys
from cfgplan.cli.main import main
main(["solve", "models/nao/2-segmenter-lost.yaml"])
for name in sorted(each for each in sys.modules if each.startswith("cfgplan.")):
    for each in list(vars(sys.modules[name]).values()):
        if not isinstance(each, type) or each.__module__ != name or not dataclasses.is_dataclass(each):
            continue
        is_ours = getattr(each.__setattr__, "__module__", "") == "cfgplan.frozen"
        is_heir = any(map(dataclasses.is_dataclass, each.__bases__))
        if each.__dataclass_params__.frozen and not is_ours and not is_heir:
            print("standard:", name, each.__name__)
"""


def test_solve_makes_its_frozen_classes_by_it() -> None:
    told = subprocess.run([sys.executable, "-c", _STANDARD], capture_output=True, text=True, check=True).stdout
    assert "Optimal" in told
    assert [line for line in told.splitlines() if line.startswith("standard:")] == []
