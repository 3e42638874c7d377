"""The reference tells each argument, field, unit and error of the public names of `cfgplan` and `cfgplan_runtime`."""

from __future__ import annotations

import ast
import builtins
import enum
import inspect
import re
import textwrap
from collections.abc import Callable, Iterator
from dataclasses import dataclass, is_dataclass
from functools import cache, cached_property, partial
from pathlib import Path
from typing import Any

import cfgplan_runtime
import msgspec
import pytest
from cfgplan_runtime.supervision.backend import Backend

import cfgplan

PAGE = (Path(cfgplan.__file__).parent / "manual" / "reference.md").read_text()
COMMON = dict(re.findall(r"^\| `(\w+)` \| (.+) \|$", PAGE, re.MULTILINE))
"""What the page says of arguments that many functions take."""


@dataclass(frozen=True)
class Described:
    """A public function, method or constructor: its name, its arguments and the text that describes them."""

    name: str
    arguments: tuple[inspect.Parameter, ...]
    written: Callable[[], str]
    code: object

    @cached_property
    def text(self) -> str:
        return self.written()

    def __str__(self) -> str:
        return self.name


def is_described(kind: type[Any]) -> bool:
    """Whether it has arguments: values of an enumeration are only named, and a protocol is a user's."""
    return not issubclass(kind, enum.Enum) and not getattr(kind, "_is_protocol", False)


def arguments_of(call: Callable[..., Any]) -> tuple[inspect.Parameter, ...]:
    named = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)
    try:
        known = inspect.signature(call).parameters.values()
    except ValueError:  # of an exception without an __init__ of its own
        return ()
    return tuple(one for one in known if one.kind in named and one.name not in ("self", "cls"))


@cache
def text_of_class(kind: type[Any]) -> str:
    """The docstring of a class, of its constructor, and those that stand below its fields."""
    texts = [inspect.getdoc(kind) or "", inspect.getdoc(vars(kind).get("__init__")) or ""]
    for base in kind.__mro__[:-1]:
        if base.__module__.startswith("cfgplan"):
            (tree,) = ast.parse(textwrap.dedent(inspect.getsource(base))).body
            assert isinstance(tree, ast.ClassDef)
            for field, below in zip(tree.body, tree.body[1:], strict=False):
                if isinstance(field, ast.AnnAssign) and isinstance(below, ast.Expr):
                    texts.append(f"`{ast.unparse(field.target)}`: {ast.unparse(below)}")
    return "\n".join(texts)


def text_of(call: Callable[..., Any], of: type[Any] | None = None) -> str:
    """The docstring of a function, or that of a method and all that its class says."""
    return "\n".join([inspect.getdoc(call) or "", *([] if of is None else [text_of_class(of)])])


def described() -> Iterator[Described]:
    for package in (cfgplan, cfgplan_runtime):
        for name in package.__all__:
            value = getattr(package, name)
            if inspect.isfunction(value):
                yield Described(name, arguments_of(value), partial(text_of, value), value)
            elif inspect.isclass(value) and is_described(value):
                fields = [one for one in arguments_of(value) if not one.name.startswith("_")]
                has_fields = is_dataclass(value) or issubclass(value, msgspec.Struct)
                yield Described(
                    name,
                    tuple(fields),
                    partial(text_of_class, value),
                    None if has_fields else vars(value).get("__init__"),
                )
                yield from methods_of(name, value)


def methods_of(name: str, kind: type[Any]) -> Iterator[Described]:
    for method, raw in vars(kind).items():
        call = raw.__func__ if isinstance(raw, classmethod | staticmethod) else raw
        if method.startswith("_") or not inspect.isfunction(call):
            continue
        if hasattr(Backend, method) and name == "SimulatedBackend":
            continue  # the protocol tells what they do
        yield Described(f"{name}.{method}", arguments_of(call), partial(text_of, call, kind), call)


ALL = list(described())


def is_said(argument: str, text: str) -> bool:
    return re.search(rf"`{re.escape(argument)}\b", text) is not None


def test_the_walk_reaches_all_kinds_of_names() -> None:
    assert {"solve", "Environment", "Environment.without_unit", "Runtime.tap", "Policy"} <= {one.name for one in ALL}
    assert len(ALL) > 120


@pytest.mark.parametrize("one", ALL, ids=str)
def test_each_argument_and_field_is_told(one: Described) -> None:
    assert len(one.text.strip().splitlines()[0]) > 15, "no sentence"
    if "." in one.name and len(one.arguments) == 1:
        return  # its sentence is about the one thing it is given
    told = {name for name in COMMON if name in {argument.name for argument in one.arguments}}
    missing = [each.name for each in one.arguments if each.name not in told and not is_said(each.name, one.text)]
    assert not missing, f"{one.name} does not tell {missing}"


UNITS = {
    "us": "microsecond",
    "ns": "nanosecond",
    "ms": "millisecond",
    "s": "second",
    "mb": "megabyte",
    "hz": "a second",
}
"""The words of units that end names."""


@pytest.mark.parametrize("one", ALL, ids=str)
def test_each_unit_of_a_number_is_told(one: Described) -> None:
    units = {each.name: UNITS.get(each.name.rpartition("_")[2]) for each in one.arguments if "_" in each.name}
    missing = [name for name, unit in units.items() if unit is not None and unit not in COMMON.get(name, one.text)]
    assert not missing, f"{one.name} does not tell the unit of {missing}"


def raised_by(code: object) -> set[str]:
    """The errors that a function raises itself, but for those that it catches."""
    if not inspect.isfunction(code):
        return set()
    tree = ast.parse(textwrap.dedent(inspect.getsource(code)))
    found = set[str]()
    for node in ast.walk(tree):
        if isinstance(node, ast.Raise) and node.exc is not None:
            called = node.exc.func if isinstance(node.exc, ast.Call) else node.exc
            while isinstance(called, ast.Attribute) and isinstance(called.value, ast.Name | ast.Attribute):
                called = called.value
            if isinstance(called, ast.Name) and called.id[0].isupper():
                found.add(called.id)
    return found


@pytest.mark.parametrize("one", [one for one in ALL if inspect.isfunction(one.code)], ids=str)
def test_each_error_that_is_raised_is_told(one: Described) -> None:
    missing = [name for name in sorted(raised_by(one.code)) if name not in one.text and not hasattr(builtins, name)]
    assert not missing, f"{one.name} does not tell that it raises {missing}"


def test_the_common_arguments_are_those_of_functions() -> None:
    known = {argument.name for one in ALL for argument in one.arguments}
    assert COMMON.keys() <= known
    for name in COMMON:
        assert sum(name in {argument.name for argument in one.arguments} for one in ALL) > 1, f"only one takes {name}"
