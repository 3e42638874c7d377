"""No command writes over the files that it is given to read."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

from cfgplan.errors import InputError

_READ = ("env", "envs", "also", "path", "features")
_WRITTEN = ("out", "plot", "log", "record", "results")


def refuse_overwriting(options: argparse.Namespace) -> None:
    """Raises InputError if a file to write is one of those to read."""
    read = list(_files(options, _READ))
    for written in _files(options, _WRITTEN):
        if any(_is_same(written, each) for each in read):
            raise InputError.of("this is the file to read: it is not written over", file=written, mend="name another")


def _files(options: argparse.Namespace, names: tuple[str, ...]) -> Iterator[str]:
    for name in names:
        value = getattr(options, name, None)
        yield from [value] if isinstance(value, str) else value or ()


def _is_same(one: str, other: str) -> bool:
    try:
        return Path(one).is_file() and Path(one).samefile(other)
    except OSError:
        return False
