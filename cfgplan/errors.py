"""What can be wrong with input: faults that say where, what and how to mend it."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass


class CfgplanError(Exception):
    """Base of every error that cfgplan raises on purpose."""


class InvalidValueError(CfgplanError, ValueError):
    """A domain value that can't exist, such as an environment with two units of one id."""


@dataclass(frozen=True, slots=True)
class Fault:
    """One mistake in the user's input.

    `line` and `column` count from 1; `key` is the path of keys inside the document, such as
    `transformations[3].inputs.image.tag`; `mend` says what to do about it.
    """

    message: str
    file: str | None = None
    line: int | None = None
    column: int | None = None
    key: str | None = None
    mend: str | None = None

    def __str__(self) -> str:
        place = ":".join(str(part) for part in (self.file, self.line, self.column) if part is not None)
        parts = [place, self.key, self.message]
        text = ": ".join(part for part in parts if part)
        return f"{text} ({self.mend})" if self.mend else text


class InputError(CfgplanError):
    """Input that can't be used, with all the faults that were found in it."""

    def __init__(self, faults: Iterable[Fault]) -> None:
        self.faults = tuple(faults)
        super().__init__("\n".join(str(fault) for fault in self.faults))

    @classmethod
    def of(cls, message: str, *, file: str | None = None, mend: str | None = None) -> InputError:
        """An error with a single fault that concerns a whole file."""
        return cls([Fault(message, file=file, mend=mend)])


def known(name: str, names: Iterable[str], what: str) -> str:
    """A name, if it is one of these; raises InputError with the nearest one."""
    names = sorted(names)
    if name in names:
        return name
    raise InputError.of(f"there is no {what} {name!r}", mend=nearest(name, names))


def nearest(name: str, names: Collection[str]) -> str | None:
    """The name that somebody who wrote an unknown one probably meant, or some of them, as a mend."""
    from difflib import get_close_matches

    close = get_close_matches(name, names, n=1)
    if close:
        return f"did you mean {close[0]!r}?"
    return f"there are {len(names)}, such as {', '.join(sorted(names)[:3])}" if names else None
