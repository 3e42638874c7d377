"""`source: program:COMMAND`: the executable that units of a transformation are, and its arguments."""

from __future__ import annotations

import os
import shlex
from dataclasses import dataclass
from pathlib import Path

from cfgplan.errors import InputError

_SCHEME = "program:"


@dataclass(frozen=True, slots=True)
class ProgramSource:
    """A program, by a name in the search path or, with a slash, by its file relative to the environment file."""

    name: str
    arguments: tuple[str, ...] = ()

    @classmethod
    def read(cls, source: str | None) -> ProgramSource | None:
        """The program that `source` names; None if it names something else, or nothing. Raises InputError."""
        if source is None or not names_program(source):
            return None
        try:
            words = shlex.split(source.removeprefix(_SCHEME))
        except ValueError as error:
            raise InputError.of(f"source `{source}`: {error}", mend="quote arguments as in a shell") from None
        if not words:
            raise InputError.of(f"source `{source}` names no program", mend="write program:./FILE or program:COMMAND")
        return cls(words[0], tuple(words[1:]))

    def file(self, folder: Path) -> Path:
        """The executable. Raises InputError if it can't be executed."""
        if "/" not in self.name:
            from shutil import which

            found = which(self.name)
            if found is None:
                mend = f"install it, or write program:./{self.name} for a file beside the environment file"
                raise InputError.of(f"there is no program {self.name} in the search path", mend=mend)
            return Path(found)
        path = Path(os.path.normpath(folder.resolve() / self.name))
        if not path.is_file():
            mend = "files are relative to the environment file"
            raise InputError.of(f"there is no file {self.name}", file=str(path), mend=mend)
        if not os.access(path, os.X_OK):
            raise InputError.of("this program is not executable", file=str(path), mend=f"chmod +x {path.name}")
        return path


def names_program(source: str) -> bool:
    """Whether a `source` names a program, be it right or wrong."""
    return source.startswith(_SCHEME)


def code_file(source: str, folder: Path) -> Path:
    """The file that unit code comes from, as far as its source tells."""
    try:
        program = ProgramSource.read(source)
        return Path(folder, source.rpartition(":")[0]) if program is None else program.file(folder)
    except InputError:  # the unit reports it
        return Path(folder, source)
