"""The user's class or function, and the rules for calling it.

A class is constructed with the transformation's params as keyword arguments, then called with the values of one step,
each under the name of its input port. It returns the value of its output port; with several output ports, a mapping
from port to value. None means no value. A generator yields one result after the other. A unit without inputs is a
source: a generator function, an iterable, or a callable that is called at the transformation's rate.
"""

from __future__ import annotations

import importlib
import importlib.util
import inspect
import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from functools import partial
from importlib.machinery import SourceFileLoader
from pathlib import Path
from types import GeneratorType, ModuleType
from typing import Any

from cfgplan_runtime.errors import BadSourceError, WrongPortsError

UNIT_VARIABLE = "CFGPLAN_UNIT"
"""The variable of a unit's environment that holds its run and its id, with a slash between."""


@dataclass(frozen=True, slots=True)
class At:
    """A `value` with its time, for sources that know it better than the clock.

    `time_ns` is in nanoseconds since the epoch and must rise along a stream, also across restarts.
    """

    time_ns: int
    value: object


@dataclass(frozen=True, slots=True)
class WithQuality:
    """A `value` that says how good it is: `quality` has by attribute a number in the attribute's unit.

    It may be the value of an `At`. Only what the output states in the environment is taken in.
    """

    value: object
    quality: Mapping[str, float] = field(hash=False)


@dataclass(frozen=True, slots=True)
class Given:
    """One value for one output port. Without `time_ns` it has its step's moment."""

    port: str
    value: object
    time_ns: int | None = None
    quality: Mapping[str, float] = field(default_factory=dict)


class UnitCode:
    """Unit code that was found and constructed. Raises BadSourceError, or what the constructor raises."""

    def __init__(
        self, source: str, params: Mapping[str, object], outputs: Sequence[str], *, folder: str, is_source: bool
    ) -> None:
        self._outputs = tuple(outputs)
        found = find_source(source, folder)
        made: Any = found(**params) if inspect.isclass(found) else partial(found, **params)
        self._object = made
        self._produce: Iterator[Any] | None = None
        if is_source:
            self._produce = _source_iterator(made, source)
        elif not callable(made):
            raise BadSourceError(f"{source} makes an object that can't be called: give it a __call__ method")
        self.has_state = hasattr(made, "get_state") and hasattr(made, "set_state")

    def step(self, values: Mapping[str, object]) -> Iterator[Given]:
        """The results of one step, computed lazily. Raises whatever the unit code raises."""
        result = self._object(**values)
        if isinstance(result, GeneratorType):
            for one in result:
                yield from self._given(one)
        else:
            yield from self._given(result)

    def produce(self) -> Iterator[Given]:
        """A source's next results. Raises StopIteration when it has no more, or what the unit code raises."""
        assert self._produce is not None
        return self._given(next(self._produce))

    @property
    def can_not_go_on(self) -> bool:
        """Whether a source is a generator that has ended, as it does when it raises."""
        return isinstance(self._produce, GeneratorType) and self._produce.gi_frame is None

    def close(self) -> None:
        """Let unit code end: close its generator, then call its `close()`, or else its `__exit__`.

        Raises the first of what these raise, once all are done.
        """
        with ExitStack() as stack:
            if (close := getattr(self._object, "close", None)) is not None:
                stack.callback(close)
            elif hasattr(self._object, "__exit__"):
                stack.push(self._object.__exit__)
            if isinstance(self._produce, GeneratorType):
                stack.callback(self._produce.close)

    def get_state(self) -> object:
        return self._object.get_state()

    def set_state(self, state: object) -> None:
        self._object.set_state(state)

    def _given(self, result: object) -> Iterator[Given]:
        if result is None:
            return
        if len(self._outputs) == 1:
            yield _timed(self._outputs[0], result)
            return
        if not self._outputs:
            raise WrongPortsError("the unit has no output port, but its code returned a value")
        if not isinstance(result, Mapping):
            raise WrongPortsError(
                f"the unit has several output ports, so its code returns a mapping from port to value, "
                f"not {type(result).__name__}"
            )
        for port in result:
            if port not in self._outputs:
                raise WrongPortsError(f"there is no output port {port!r}, only {', '.join(self._outputs)}")
        for port, value in result.items():
            if value is not None:
                yield _timed(port, value)


def find_source(source: str, folder: str) -> Callable[..., Any]:
    """The class or function that `package.module:Name` or `folder`'s `units.py:Name` names. Raises BadSourceError."""
    place, colon, name = source.rpartition(":")
    if not (colon and place and name):
        raise BadSourceError(f"{source!r} names no unit code: write package.module:Class or units.py:Class")
    module = _module_of_file(place, folder) if place.endswith(".py") else _module_by_name(place, folder)
    found: Any = module
    for part in name.split("."):
        found = getattr(found, part, None)
        if found is None:
            raise BadSourceError(f"{place} has no {name}")
    if not callable(found):
        raise BadSourceError(f"{source} is neither a class nor a function")
    return found  # type: ignore[no-any-return]


def imported_files(folder: Path) -> dict[str, int]:
    """The files in a folder that this process has imported, packages apart, and when each was changed (nanoseconds)."""
    found = dict[str, int]()
    for module in list(sys.modules.values()):
        file = Path(getattr(module, "__file__", None) or "/")
        if file.is_relative_to(folder) and "site-packages" not in file.parts:
            with suppress(OSError):
                found[str(file)] = file.stat().st_mtime_ns
    return found


def _module_of_file(place: str, folder: str) -> ModuleType:
    """Import a file of a folder, without `pathlib`, whose code would take memory in each unit (see `rehearsal`)."""
    path = os.path.join(folder, place.removeprefix("./"))  # noqa: PTH118
    if not os.path.isfile(path):  # noqa: PTH113
        raise BadSourceError(f"there is no file {path}")
    parent, _, file = path.rpartition(os.sep)
    stem = file.removesuffix(".py")
    # Processes that unit code spawns import it by this name, from the folder in sys.path.
    name = stem if stem not in sys.modules else f"cfgplan_units_{stem}"
    loader = SourceFileLoader(name, path)
    spec = importlib.util.spec_from_file_location(name, path, loader=loader)
    assert spec is not None
    if parent not in sys.path:
        sys.path.insert(0, parent)
    module = sys.modules[name] = importlib.util.module_from_spec(spec)
    loader.exec_module(module)
    return module


def _module_by_name(name: str, folder: str) -> ModuleType:
    if folder not in sys.path:
        sys.path.insert(0, folder)
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name is not None and (name == error.name or name.startswith(f"{error.name}.")):
            raise BadSourceError(f"there is no module {error.name}") from None
        raise


def _source_iterator(made: Any, source: str) -> Iterator[Any]:
    if hasattr(made, "__iter__"):
        return iter(made)
    if not callable(made):
        raise BadSourceError(f"{source} has no inputs, so it must be a generator function, iterable or callable")
    function = made.func if isinstance(made, partial) else type(made).__call__
    if inspect.isgeneratorfunction(function):
        return iter(made())
    return iter(made, _NEVER)


_NEVER = object()


def _timed(port: str, value: object) -> Given:
    time_ns = value.time_ns if isinstance(value, At) else None
    found = value.value if isinstance(value, At) else value
    if isinstance(found, WithQuality):
        return Given(port, found.value, time_ns, found.quality)
    return Given(port, found, time_ns)
