"""The errors of carrying out a plan."""

from __future__ import annotations

from collections.abc import Iterable

from cfgplan.errors import CfgplanError

UNDONE = "the update was undone"


class RuntimeFaultError(CfgplanError):
    """Base class of the errors of carrying out plans."""


class UnsupportedPlatformError(RuntimeFaultError):
    """The runtime does not work on this operating system."""


class StaleChangeSetError(RuntimeFaultError):
    """A change set that does not fit the running configuration; nothing was changed."""


class NoSourceError(RuntimeFaultError):
    """A unit that can't be started because its transformation names no unit code; nothing was changed.

    `transformations` are the labels of the transformations at fault, `cause` is the fault of each.
    """

    def __init__(self, message: str, transformations: Iterable[str] = (), cause: str | None = None) -> None:
        super().__init__(message)
        self.transformations = tuple(transformations)
        self.cause = cause or message


class ApplyError(RuntimeFaultError):
    """A change set that failed half way; every step of it was undone, and the old configuration keeps running.

    `cause` says why; `units` are the new units that did not start.
    """

    def __init__(self, cause: str, units: Iterable[str] = ()) -> None:
        super().__init__(cause)
        self.cause = cause
        self.units = tuple(units)

    def __str__(self) -> str:
        return f"{UNDONE}: {self.cause}"


class AbandonedError(ApplyError):
    """A change set that was given up on request before its new units were ready; `units` are those that were not."""


class EncodingError(RuntimeFaultError):
    """A value that can't be sent between processes."""


class BadSourceError(RuntimeFaultError):
    """A `source:` that can't be found or is no unit code."""


class WrongPortsError(RuntimeFaultError):
    """Unit code returned something other than values for its output ports."""


class ProgramEndedError(RuntimeFaultError):
    """A unit's program can't be started, or has ended without being told to."""


class ProgramFaultError(RuntimeFaultError):
    """A program has broken its protocol, and continues; `what` is the kind of fault, `line` the line that it has
    written.
    """

    def __init__(self, what: str, told: str, line: str = "") -> None:
        super().__init__(f"{told}: {line}" if line else told)
        self.what = what


class NoSuchTopicError(RuntimeFaultError):
    """No running unit publishes the topic."""


class NoSuchRunError(RuntimeFaultError):
    """The name of a run fits no run, or more than one."""


class ControlError(RuntimeFaultError):
    """A run does not answer."""
