"""Parameters of connections: their names, and passwords that stand outside of environment files."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from pathlib import Path

from cfgplan.errors import InputError, did_you_mean
from cfgplan.file_content import content_of


def check_names(protocol: str, known: Iterable[str], given: Mapping[str, object]) -> None:
    """Raise InputError for an unknown parameter, a password in the environment file, or one without a `username`."""
    known = tuple(known)
    if "password" in given:
        mend = "write `password_env: VARIABLE` or `password_file: FILE`"
        raise InputError.of("an environment file can't hold a password", mend=mend)
    for name in given:
        if name not in known:
            there = did_you_mean(name, known, f"there are {', '.join(known)}")
            raise InputError.of(f"{protocol} has no parameter `{name}`", mend=there)
    if given.get("username") is None and {"password_env", "password_file"} & given.keys():
        raise InputError.of("there is a password without a name", mend="write `username` too")


def read_password(variable: str | None, file: str | None) -> str | None:
    """The password that a variable of the environment or a file holds; None without either. Raises InputError."""
    if variable is not None:
        if variable not in os.environ:
            raise InputError.of(f"the variable {variable} is not set", mend="export it before the run")
        return os.environ[variable]
    if file is None:
        return None
    try:
        return content_of(Path(file)).decode().strip()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError.of(f"the password can't be read: {error}", file=file) from None
