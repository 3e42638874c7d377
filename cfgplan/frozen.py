"""A `dataclass` for modules that every command imports: a frozen class is made in a fifth of the standard one's time.

The standard decorator compiles six to ten methods of each class, of which most commands call two. This one compiles
`__init__`, and the comparisons and the hash when they are first called; the others need no code of their own. Type
checkers see the standard decorator, and so do `dataclasses.fields`, `replace` and `is_dataclass`.
"""

from __future__ import annotations

import dataclasses
import inspect
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import MISSING, Field, FrozenInstanceError
from reprlib import recursive_repr
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

_COMPARISONS: Final = MappingProxyType({"__lt__": "<", "__le__": "<=", "__gt__": ">", "__ge__": ">="})
_KEPT_STATE: Final = ("__getstate__", "__setstate__")


class _Factory:
    """Stands for a default that a factory makes."""

    def __repr__(self) -> str:
        return "<factory>"


_FACTORY: Final = _Factory()

if TYPE_CHECKING:
    from dataclasses import dataclass as dataclass
else:

    def dataclass(cls: type | None = None, /, *, frozen: bool = False, **options: bool) -> Any:
        """Make a dataclass as `dataclasses.dataclass` does; takes `order`, `eq` and `slots` if it is frozen.

        The standard decorator makes a class that is not frozen, or inherits from a dataclass.
        """

        def made(cls: type) -> type:
            if frozen and not any(map(dataclasses.is_dataclass, cls.__bases__)):
                return _frozen(cls, **options)
            return dataclasses.dataclass(cls, frozen=frozen, **options)

        return made if cls is None else made(cls)


def _frozen(cls: type, *, order: bool = False, eq: bool = True, slots: bool = False) -> type:
    own = set(cls.__dict__) - ({"__hash__"} if cls.__dict__.get("__hash__") is None else set())
    if cls.__doc__ is None:  # the standard decorator would make one of the signature
        cls.__doc__ = f"{cls.__name__}({', '.join(inspect.get_annotations(cls))})"
    cls = dataclasses.dataclass(init=False, repr=False, eq=False, slots=slots)(cls)
    parameters: Any = cls.__dict__["__dataclass_params__"]  # an heir must be frozen too
    parameters.init = parameters.repr = parameters.frozen = True
    parameters.eq, parameters.order = eq, order
    fields = dataclasses.fields(cls)
    compared = [field.name for field in fields if field.compare]
    methods = {"__init__": _init(cls, fields, slots=slots), "__repr__": _repr(fields), **_guards(cls, fields)}
    if eq:
        hashed = [field.name for field in fields if (field.compare if field.hash is None else field.hash)]
        same = f"if other.__class__ is self.__class__: return {_values('self', compared)}"
        methods["__eq__"] = _later(cls, "__eq__", "other", f"{same} == {_values('other', compared)}")
        methods["__hash__"] = _later(cls, "__hash__", "", f"return hash({_values('self', hashed)})")
        for name, sign in _COMPARISONS.items() if order else ():
            methods[name] = _later(cls, name, "other", f"{same} {sign} {_values('other', compared)}")
    if slots:
        methods |= dict(zip(_KEPT_STATE, _state(fields), strict=True))
    for name in methods.keys() - own:
        methods[name].__qualname__ = f"{cls.__qualname__}.{name}"
        setattr(cls, name, methods[name])
    return cls


def _init(cls: type, fields: Iterable[Field[Any]], *, slots: bool) -> Callable[..., None]:
    """Return `__init__`, with the annotations of the fields."""
    given: dict[str, Any] = {"_set": object.__setattr__, "_factory": _FACTORY}
    in_order: list[str] = []
    by_keyword: list[str] = []
    body = []
    for field in fields:
        name, default, made = field.name, f"_default_{field.name}", f"_make_{field.name}"
        value, is_given = name, field.init
        parameter = name
        if field.default is not MISSING:
            given[default] = field.default
            parameter, value = f"{name}={default}", name if field.init else default
            is_given = field.init or slots
        elif field.default_factory is not MISSING:
            given[made] = field.default_factory
            parameter = f"{name}=_factory"
            value = f"{made}() if {name} is _factory else {name}" if field.init else f"{made}()"
            is_given = True
        if field.init:
            (by_keyword if field.kw_only else in_order).append(parameter)
        if is_given:
            body.append(f"_set(self, {name!r}, {value})")
    if hasattr(cls, "__post_init__"):
        body.append("self.__post_init__()")
    parameters = ["self", *in_order, *(["*", *by_keyword] if by_keyword else [])]
    init = _compiled(cls, "__init__", parameters, body or ["pass"], given)
    init.__annotations__ = {field.name: field.type for field in fields if field.init} | {"return": None}
    return init


def _repr(fields: Iterable[Field[Any]]) -> Callable[[Any], str]:
    shown = [field.name for field in fields if field.repr]

    @recursive_repr()
    def __repr__(self: Any) -> str:  # noqa: N807
        return f"{type(self).__qualname__}({', '.join(f'{name}={getattr(self, name)!r}' for name in shown)})"

    return __repr__


def _guards(cls: type[Any], fields: Iterable[Field[Any]]) -> dict[str, Callable[..., None]]:
    names = frozenset(field.name for field in fields)

    def __setattr__(self: Any, name: str, value: Any) -> None:  # noqa: N807
        if type(self) is cls or name in names:
            raise FrozenInstanceError(f"cannot assign to field {name!r}")
        super(cls, self).__setattr__(name, value)

    def __delattr__(self: Any, name: str) -> None:  # noqa: N807
        if type(self) is cls or name in names:
            raise FrozenInstanceError(f"cannot delete field {name!r}")
        super(cls, self).__delattr__(name)

    return {"__setattr__": __setattr__, "__delattr__": __delattr__}


def _state(fields: Sequence[Field[Any]]) -> tuple[Callable[..., Any], ...]:
    """Return how instances with slots are pickled and copied."""

    def __getstate__(self: Any) -> list[Any]:  # noqa: N807
        return [getattr(self, field.name) for field in fields]

    def __setstate__(self: Any, state: Sequence[Any]) -> None:  # noqa: N807
        for field, value in zip(fields, state, strict=True):
            object.__setattr__(self, field.name, value)

    return __getstate__, __setstate__


def _later(cls: type, name: str, parameter: str, line: str) -> Callable[..., Any]:
    """Return a method that compiles itself when it is first called."""

    def method(self: Any, *others: Any) -> Any:
        body = [line, "return NotImplemented"] if parameter else [line]
        compiled = _compiled(cls, name, ["self", parameter] if parameter else ["self"], body, {})
        setattr(cls, name, compiled)
        return compiled(self, *others)

    method.__name__ = name
    return method


def _values(owner: str, names: Iterable[str]) -> str:
    """Return the source of a tuple of attributes."""
    return f"({''.join(f'{owner}.{name}, ' for name in names)})"


def _compiled(
    cls: type, name: str, parameters: Iterable[str], body: Iterable[str], given: dict[str, Any]
) -> Callable[..., Any]:
    """Return a function of the class's module that reads `given` too."""
    lines = "\n  ".join(body)
    text = f"def make({', '.join(given)}):\n def {name}({', '.join(parameters)}):\n  {lines}\n return {name}"
    found: dict[str, Any] = {}
    exec(text, sys.modules[cls.__module__].__dict__, found)
    function: Callable[..., Any] = found["make"](**given)
    function.__qualname__ = f"{cls.__qualname__}.{name}"
    return function
