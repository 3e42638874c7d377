"""The arguments of public constructors and functions: checked against their annotations, and refused by name."""

from __future__ import annotations

import builtins
import inspect
import os
import sys
import types
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, fields
from enum import Enum
from functools import cache, partial, wraps
from itertools import starmap
from numbers import Real
from operator import index
from typing import Annotated, Any, Literal, TypeAlias, TypeVar, Union, cast, get_args, get_origin

from cfgplan.errors import InvalidValueError

T = TypeVar("T")
_LONGEST_SHOWN = 60
_ANNOTATED = "Annotated["


@dataclass(frozen=True)
class AtLeast:
    """The smallest number that an annotated argument may be."""

    least: int


Natural: TypeAlias = Annotated[int, AtLeast(0)]
"""A whole number of 0 or more."""
Seconds: TypeAlias = Annotated[float, AtLeast(0)]
"""A time in seconds, not negative."""


class _MisfitError(Exception):
    """A value, or a `is_part` of it, does not fit; `shown` says which one, in an error's words."""

    def __init__(self, shown: str, *, is_part: bool = False) -> None:
        self.shown = shown
        self.is_part = is_part


@dataclass(frozen=True, eq=False)
class _Kind:
    """The values that an annotation allows.

    `exact` are the types whose values fit as they are. `read` returns any other value as it is kept, and raises
    _MisfitError.
    """

    text: str
    exact: frozenset[type]
    read: Callable[[Any], object]
    least: int | None = None
    """The least int that fits too."""

    def unusual(self, exact: str) -> str:
        """A test for the values of `each` that have to be read, as Python writes it; `exact` is the types' name."""
        if self.least is not None:
            fits = f"type(each) is int and each >= {self.least}"
            return f"not ({fits}{' or each is None' if type(None) in self.exact else ''})"
        if not self.exact:
            return "each or type(each) not in (tuple, dict)"
        return f"type(each) {'is not' if len(self.exact) == 1 else 'not in'} {exact}"


def checked(target: T) -> T:
    """Decorate a function, or a dataclass below its `@dataclass`, so that wrong arguments raise InvalidValueError.

    Whole numbers of other types, such as NumPy's, become ints, and lists become tuples where the annotation says so.
    """
    return cast("T", _checked_class(target) if isinstance(target, type) else _checked_function(cast("Any", target)))


def _checked_class(cls: type[Any]) -> type[Any]:
    after: Callable[[Any], None] | None = vars(cls).get("__post_init__")
    tests: dict[type[Any], Callable[[Any], None]] = {}

    def __post_init__(self: Any) -> None:  # noqa: N807
        test = tests.get(type(self))
        if test is None:  # at the first value: names that annotations use may come later than the class
            test = tests[type(self)] = _test_of(type(self), cls.__module__)
        test(self)
        if after is not None:
            after(self)

    cls.__post_init__ = __post_init__
    cls.__noted__ = vars(cls).get("__annotations__", {})
    cls.__annotations__ = {name: _without_notes(text) for name, text in cls.__noted__.items()}
    return cls


def noted(cls: type[Any]) -> Mapping[str, Any]:
    """The annotations of a checked class by attribute, each with its metadata (such as AtLeast or Row)."""
    names = dict(vars(sys.modules[cls.__module__]))
    return {name: eval(text, names, _Later(names)) for name, text in cls.__noted__.items()}


def _without_notes(annotation: str) -> str:
    """An annotation's text without notes that do not limit the values, such as rows: signatures don't show them."""
    if not annotation.startswith(_ANNOTATED):
        return annotation
    depth = 0
    for at in range(len(_ANNOTATED), len(annotation)):
        depth += (annotation[at] in "[(") - (annotation[at] in "])")
        if annotation[at] == "," and not depth:
            is_limit = annotation.startswith(f"{AtLeast.__name__}(", at + 2)
            return annotation if is_limit else annotation[len(_ANNOTATED) : at]
    return annotation


def _test_of(cls: type[Any], module: str) -> Callable[[Any], None]:
    """A function that checks the fields of a new value, written out: planning makes millions of values."""
    lines, names = ["def test(value):"], dict[str, Any]()
    for number, field in enumerate(fields(cls)):
        kind = _kind_named(str(field.type), module)
        names |= {f"put{number}": partial(_put, field.name, kind), f"type{number}": _one(kind.exact)}
        lines += [f" each = value.{field.name}", f" if {kind.unusual(f'type{number}')}: put{number}(value, each)"]
    exec("\n".join(lines), names)
    return cast("Callable[[Any], None]", names["test"])


def _one(exact: frozenset[type]) -> object:
    """The type, if it is only one."""
    return next(iter(exact)) if len(exact) == 1 else exact


def _put(name: str, kind: _Kind, holder: Any, value: object) -> None:
    """Store a value that is not of the usual kind as it is kept."""
    try:
        read = kind.read(value)
    except _MisfitError as misfit:
        raise _refusal(_owner(holder), name, kind, misfit) from None
    if read is not value:
        object.__setattr__(holder, name, read)


def _checked_function(function: Callable[..., Any]) -> Callable[..., Any]:
    @cache
    def signature() -> inspect.Signature:
        return inspect.signature(function)

    @cache
    def kinds() -> Mapping[str, _Kind]:
        told = {name: each.annotation for name, each in signature().parameters.items()}
        return {name: _kind_named(text, function.__module__) for name, text in told.items() if text is not each_empty}

    each_empty = inspect.Parameter.empty

    @wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        __tracebackhide__ = True  # of pytest: the fault is the caller's
        try:
            bound = signature().bind(*args, **kwargs)
        except TypeError as error:
            raise TypeError(f"{function.__name__}(): {error}") from None
        for name, value in bound.arguments.items():
            kind = kinds().get(name)
            if kind is not None and type(value) not in kind.exact:
                try:
                    bound.arguments[name] = kind.read(value)
                except _MisfitError as misfit:
                    raise _refusal(f"{function.__name__}()", name, kind, misfit) from None
        return function(*bound.args, **bound.kwargs)

    return call


def _owner(value: Any) -> str:
    """A value in an error: its class and, if it has one, its name."""
    named = next((getattr(value, name) for name in ("label", "id", "name") if hasattr(value, name)), None)
    return f"{type(value).__name__} {named!r}" if isinstance(named, str) else type(value).__name__


def _refusal(owner: str, name: str, kind: _Kind, misfit: _MisfitError) -> InvalidValueError:
    return InvalidValueError(f"{owner}: {name} must be {kind.text}, but {misfit.shown}")


def unsuitable(owner: str, name: str, wanted: str, value: object) -> InvalidValueError:
    """Return the error for a wrong argument of `owner` that no annotation checks; `wanted` says what it takes."""
    return InvalidValueError(f"{owner}: {name} must be {wanted}, but is {_shown(value)}")


def _is(value: object) -> _MisfitError:
    return _MisfitError(f"is {_shown(value)}")


def _shown(value: object) -> str:
    """A value in an error: itself if it is short, else its type."""
    if value is None or isinstance(value, (str, bytes, Real, Enum, type)):
        text = repr(value)
        return text if len(text) <= _LONGEST_SHOWN else f"{text[:_LONGEST_SHOWN]}..."
    return _article(type(value).__name__)


def _article(noun: str) -> str:
    return f"{'an' if noun[:1] in 'AEIOUaeiou' else 'a'} {noun}"


class _Later(Mapping[str, Any]):
    """A module's imports for type checkers only; each lookup gives a class known by its name."""

    def __init__(self, module: Mapping[str, Any]) -> None:
        self._module = module

    def __getitem__(self, name: str) -> Any:
        if name.startswith("__") or name in self._module or hasattr(builtins, name):
            raise KeyError(name)
        return _Named(name)

    def __iter__(self) -> Any:
        return iter(())

    def __len__(self) -> int:
        return 0


class _Named:
    """A class known only by name; `|` makes a union of it."""

    def __init__(self, name: str) -> None:
        self.name = name

    def __or__(self, other: Any) -> Any:
        return Union[self, other]  # noqa: UP007

    def __ror__(self, other: Any) -> Any:
        return Union[other, self]  # noqa: UP007

    def __call__(self) -> None:
        """Makes `typing` take it for a type."""


def _kind_named(annotation: str, module: str) -> _Kind:
    """The kind of an annotation's text, with the names of the module where it stands."""
    names = vars(sys.modules[module])
    return kind_of(eval(annotation, dict(names), _Later(names)))


def kind_of(annotation: Any) -> _Kind:
    """The values that an annotation allows. Raises TypeError for one that is not known here."""
    origin, inner = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return _ranged(kind_of(inner[0]), next(each for each in inner[1:] if isinstance(each, AtLeast)))
    if origin in (Union, types.UnionType):
        return _any_of([kind_of(each) for each in inner])
    if origin is Literal:
        return _one_of(inner)
    if origin is tuple and inner[1:] != (...,):
        return _product([kind_of(each) for each in inner])
    if origin in (tuple, frozenset):
        return _collection(origin, kind_of(inner[0]))
    if isinstance(origin, type) and issubclass(origin, Mapping):
        return _mapping(*map(kind_of, inner))
    if isinstance(origin, type) and issubclass(origin, Iterable):
        return _collection(None, kind_of(inner[0]), origin)
    if isinstance(annotation, _Named):
        return _kind(_article(annotation.name), lambda value: annotation.name in _names(type(value)))
    return _of_class(origin or annotation)


def _names(cls: type) -> list[str]:
    return [each.__name__ for each in cls.__mro__]


def _kind(text: str, fits: Callable[[Any], bool], exact: Iterable[type] = ()) -> _Kind:
    def read(value: object) -> object:
        if not fits(value):
            namesake = f" of {type(value).__module__.partition('.')[0]}" if _shown(value) == text else ""
            raise _MisfitError(f"is {_shown(value)}{namesake}")
        return value

    return _Kind(text, frozenset(exact), read)


def _of_class(cls: Any) -> _Kind:
    if cls in (Any, object):
        return _Kind("anything", frozenset(), lambda value: value)
    if cls is Callable or (getattr(cls, "_is_protocol", False) and "__call__" in vars(cls)):
        return _kind("a function", callable)
    if getattr(cls, "_is_protocol", False):
        wanted = [name for name in vars(cls) if not name.startswith("_")]
        return _kind(_article(cls.__name__), lambda value: all(hasattr(value, name) for name in wanted))
    if cls in _SIMPLE:
        return _SIMPLE[cls]
    text = " or ".join(map(str, _members(cls))) if issubclass(cls, Enum) else _article(cls.__name__)
    return _kind(text, lambda value: isinstance(value, cls), [cls])


def _members(cls: type[Enum]) -> list[str]:
    return [f"{cls.__name__}.{each.name}" for each in cls]


def _whole(value: Any) -> int:
    if isinstance(value, bool):
        raise _is(value)
    try:
        return index(value)
    except TypeError:
        raise _is(value) from None


_SIMPLE: Mapping[Any, _Kind] = {
    int: _Kind("a whole number", frozenset({int}), _whole),
    float: _kind(
        "a number", lambda value: isinstance(value, Real) and not isinstance(value, bool) and value == value, [int]
    ),
    str: _kind("a text", lambda value: isinstance(value, str), [str]),
    bool: _kind("True or False", lambda value: isinstance(value, bool), [bool]),
    type(None): _kind("None", lambda value: value is None, [type(None)]),
    os.PathLike: _kind("a path", lambda value: isinstance(value, os.PathLike)),
}


def _ranged(kind: _Kind, at: AtLeast) -> _Kind:
    def read(value: object) -> object:
        number = kind.read(value)
        if cast("float", number) < at.least:
            raise _is(value)
        return number

    return _Kind(f"{kind.text} of {at.least} or more", frozenset(), read, at.least if int in kind.exact else None)


def _one_of(values: tuple[object, ...]) -> _Kind:
    return _kind(
        " or ".join(map(repr, values)), lambda value: any(type(value) is type(o) and value == o for o in values)
    )


def _any_of(kinds: list[_Kind]) -> _Kind:
    def read(value: object) -> object:
        misfits = []
        for kind in kinds:
            if type(value) in kind.exact:
                return value
            try:
                return kind.read(value)
            except _MisfitError as misfit:
                misfits.append(misfit)
        raise next((each for each in misfits if each.is_part), misfits[0])

    exact = frozenset[type]().union(*(kind.exact for kind in kinds))
    least = next((kind.least for kind in kinds if kind.least is not None), None)
    return _Kind(" or ".join(kind.text for kind in kinds), exact, read, least)


def _items(values: Iterable[Any], item: _Kind) -> list[Any] | None:
    """The items as they are kept; None if they are already."""
    if {*map(type, values)} <= item.exact:
        return None
    read = []
    for value in values:
        try:
            read.append(value if type(value) in item.exact else item.read(value))
        except _MisfitError:
            raise _MisfitError(f"has {_shown(value)} in it", is_part=True) from None
    return None if all(one is other for one, other in zip(read, values, strict=True)) else read


def _collection(
    kept: type[tuple[Any, ...]] | type[frozenset[Any]] | None, item: _Kind, origin: type = Iterable
) -> _Kind:
    """A collection that is kept as a tuple or frozenset, or as it comes if `kept` is None."""

    def read(values: Any) -> object:
        if type(values) is kept and {*map(type, values)} <= item.exact:
            return values
        if isinstance(values, (str, bytes, Mapping)) or not isinstance(values, origin):
            raise _is(values)
        whole: Any = values if isinstance(values, Collection) else tuple(cast("Iterable[Any]", values))
        new = _items(whole, item)
        if kept is None:
            return whole if new is None else new
        return cast("Callable[[Any], object]", kept)(new or whole)

    return _Kind(f"a {'list' if kept is None else kept.__name__}, each item {item.text}", frozenset(), read)


def _product(kinds: list[_Kind]) -> _Kind:
    def read(values: Any) -> object:
        if not isinstance(values, (tuple, list)) or len(values) != len(kinds):
            raise _is(values)
        return tuple(starmap(lambda kind, value: kind.read(value), zip(kinds, values, strict=True)))

    return _Kind(f"a tuple of {' and '.join(kind.text for kind in kinds)}", frozenset(), read)


def _mapping(key: _Kind, value: _Kind) -> _Kind:
    def read(values: Any) -> object:
        if not isinstance(values, Mapping):
            raise _is(values)
        _items(values, key)
        new = _items([*values.values()], value)
        return values if new is None else dict(zip(values, new, strict=True))

    return _Kind(f"a mapping from {key.text} to {value.text}", frozenset(), read)
