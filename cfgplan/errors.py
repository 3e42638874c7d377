"""Errors in input: faults that say where they are, why, and how to mend them."""

from __future__ import annotations

import errno
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

FULL_DISK = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)
"""The errors of a disk that takes no more data."""
_MOST_NAMES_COMPARED = 500
_MOST_BESIDE = 500
_LETTERS = "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_-./:()@ "


class CfgplanError(Exception):
    """Base of every error that cfgplan raises on purpose. It can be copied and pickled."""

    def __reduce__(self) -> tuple[Any, ...]:
        return _made_again, (type(self), self.args, vars(self))


def _made_again(kind: type[CfgplanError], args: tuple[object, ...], attributes: dict[str, object]) -> CfgplanError:
    """Return a copy of an error with its text and attributes, without calling the constructor of its class."""
    error = kind.__new__(kind, *args)
    vars(error).update(attributes)
    return error


class InvalidValueError(CfgplanError, ValueError):
    """A domain value that can't exist, such as an environment with two units of one id."""


class MatchingError(CfgplanError):
    """A tag or name that can't be matched or looked up: the reason, and how to mend it."""

    def __init__(self, message: str, mend: str | None = None) -> None:
        self.message = message
        self.mend = mend
        super().__init__(f"{message} ({mend})" if mend else message)


class TagError(MatchingError):
    """A tag that can't be read; `column` counts its characters from 1."""

    def __init__(self, message: str, column: int, mend: str | None = None) -> None:
        super().__init__(message, mend)
        self.column = column


class UnknownNameError(MatchingError):
    """A name that the ontology doesn't know, or knows as something else."""


@dataclass(frozen=True, slots=True)
class Fault:
    """One mistake in the user's input.

    `message` says what is wrong, in the `file` of this name. `line` and `column` count from 1; `key` is the path of
    keys inside the document, such as `transformations[3].inputs.image.tag`; `mend` says what to do about it.
    """

    message: str
    file: str | None = None
    line: int | None = None
    column: int | None = None
    key: str | None = None
    mend: str | None = None

    @property
    def place(self) -> str:
        """File, line and column, as far as they are known."""
        return ":".join(str(part) for part in (self.file, self.line, self.column) if part is not None)

    def __str__(self) -> str:
        text = ": ".join(part for part in (self.place, self.key, self.message) if part)
        return f"{text} ({self.mend})" if self.mend else text


class InputError(CfgplanError):
    """Input that can't be used, with all the `faults` that were found in it."""

    def __init__(self, faults: Iterable[Fault]) -> None:
        self.faults = tuple(faults)
        super().__init__("\n".join(str(fault) for fault in self.faults))

    @classmethod
    def of(cls, message: str, *, file: str | None = None, mend: str | None = None) -> InputError:
        """Return an error with a single fault: a `message`, the `file` that it concerns as a whole, and a `mend`."""
        return cls([Fault(message, file=file, mend=mend)])

    @classmethod
    def unwritable(cls, error: OSError, file: str) -> InputError:
        """Return the error for the `file` or folder that can't be written, with the mend of the system's `error`."""
        return cls.of(f"can't be written: {error.strerror}", file=file, mend=mend_of_write(error))


def mend_of_write(error: OSError) -> str | None:
    """Return what to do where writing fails; None for a system error whose cause lies elsewhere."""
    match error.errno:
        case errno.ENOSPC | errno.EDQUOT:
            return "free some space, or write to another disk"
        case errno.EACCES | errno.EPERM | errno.EROFS:
            return "allow writing there, or name another place"
        case errno.ENOENT:
            return "make the folder first"
        case errno.ENOTDIR:
            return "a part of this path is a file: name another place"
        case errno.EISDIR:
            return "it is a folder: name a file in it"
        case errno.ENAMETOOLONG:
            return "give it a shorter name"
    return None


def known(name: str, names: Iterable[str], what: str, hint: str | None = None) -> str:
    """Return `name` if it is one of `names`; else raise InputError with the closest of them, or with the hint."""
    names = sorted(names)
    if name in names:
        return name
    few = f"write {' or '.join(names)}" if names else None
    some = few if len(names) <= 3 else f"there are {len(names)}, such as {', '.join(names[:3])}"
    raise InputError.of(f"there is no {what} `{name}`", mend=did_you_mean(name, names, hint or some))


def did_you_mean(name: str, names: Collection[str], otherwise: str | None = None) -> str | None:
    """Return the mend of an unknown name: the closest known name, or `otherwise` if none is close.

    Among many names only those that differ by one letter are found: comparing with all of them takes seconds.
    """
    close = close_names(name, names)
    return f"did you mean `{close[0]}`?" if close else otherwise


def close_names(name: str, names: Collection[str], most: int = 1) -> list[str]:
    """The known names that are spelt much like this one, the closest first."""
    from difflib import get_close_matches

    there = {*names}
    if alike := sorted(each for each in there if each.casefold() == name.casefold()):
        return alike[:most]
    if len(there) <= _MOST_NAMES_COMPARED:
        close = get_close_matches(name, sorted(there), n=most)
    else:
        close = [edited for edited in _edits(name) if edited in there][:most]
    return close


def close_file(path: Path, endings: Collection[str] = ()) -> Path | None:
    """The file beside a missing one that is spelt much like it, or is named like it with another one of the `endings`.

    Only the first few hundred files of the folder are compared.
    """
    try:
        names = [each.name for each in islice(path.parent.iterdir(), _MOST_BESIDE)]
    except (OSError, ValueError):
        return None
    stems = {name.removesuffix(path.suffix) for name in names if name.endswith(path.suffix)}
    if close := close_names(path.stem, stems - {""}):
        return path.with_name(close[0] + path.suffix)
    others = [path.with_suffix(suffix) for suffix in endings if path.suffix in endings]
    return next((other for other in others if other.name in names), None)


def _edits(name: str) -> Iterator[str]:
    """Every text that differs from a name by one letter, or by the order of two."""
    for at in range(len(name) + 1):
        before, after = name[:at], name[at:]
        if after:
            yield before + after[1:]
        if len(after) > 1:
            yield before + after[1] + after[0] + after[2:]
        for letter in _LETTERS:
            yield before + letter + after
            if after:
                yield before + letter + after[1:]
