"""Preloaded into a nursery: breaks one promise about the end of unit code, which the variable BROKEN names."""

from __future__ import annotations

import atexit
import os
from types import GeneratorType
from typing import Any

from cfgplan_runtime.children import messages, unit_child
from cfgplan_runtime.children.unit_code import UnitCode
from cfgplan_runtime.processes import nursery

BROKEN = "CFGPLAN_TEST_BROKEN"

broken = os.environ.get(BROKEN)
_close, _end, _obey = UnitCode.close, nursery._end_as_python_does, unit_child.UnitChild._obey


def _close_without_generator(code: UnitCode) -> None:
    is_generator = isinstance(code._produce, GeneratorType)
    if not is_generator:
        _close(code)


def _close_without(method: str) -> Any:
    def close(code: UnitCode) -> None:
        if not hasattr(code._object, method):
            _close(code)

    return close


def _end_without_atexit(*, waits: bool) -> None:
    atexit._clear()
    _end(waits=waits)


def _end_without_flush(*, waits: bool) -> None:  # noqa: ARG001
    atexit._run_exitfuncs()


def _obey_and_discard(child: Any, message: Any, sockets: Any) -> None:
    """Told to end, a unit forgets what waits."""
    _obey(child, message, sockets)
    if isinstance(message, messages.Finish):
        child._next_step = None
        child._steps.next = lambda: None


if broken == "closes no generator":
    UnitCode.close = _close_without_generator  # type: ignore[method-assign]
if broken == "calls no close()":
    UnitCode.close = _close_without("close")  # type: ignore[method-assign]
if broken == "calls no __exit__":
    UnitCode.close = _close_without("__exit__")  # type: ignore[method-assign]
if broken == "runs nothing of atexit":
    nursery._end_as_python_does = _end_without_atexit
if broken == "flushes no file":
    nursery._end_as_python_does = _end_without_flush
if broken == "discards what waits":
    unit_child.UnitChild._obey = _obey_and_discard  # type: ignore[method-assign]
