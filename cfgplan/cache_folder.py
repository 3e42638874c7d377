"""The cache folder, kept between runs: answers about tags, ontologies as they were read, archives of a reasoner's
classes.

Files are written whole or not at all; a damaged or foreign file is ignored and overwritten. If the folder can't be
written, nothing is kept.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from cfgplan.user_folders import user_folder

MOST_FILES: Final = 1000
"""The number of files that are kept in each part of the folder; the oldest are dropped first."""
MOST_BYTES: Final = 256_000_000
"""The bytes that are kept in each part of the folder."""


def cache_folder() -> Path | None:
    """`$XDG_CACHE_HOME/cfgplan`, or `~/.cache/cfgplan`; None for a user without a home."""
    try:
        return (user_folder("XDG_CACHE_HOME") or Path.home() / ".cache") / "cfgplan"
    except RuntimeError:
        return None


@dataclass(frozen=True)
class CachePart:
    """A part of a cache folder. Raise the number in its `form` whenever files of the present form would be wrong."""

    part: str
    form: str

    def find(self, folder: Path, key: str) -> dict[str, Any] | None:
        """Return the content that is kept under a key; None if it is missing or has another form."""
        try:
            content = json.loads((folder / self.part / f"{key}.json").read_bytes())
            return content if (content["format"], content["key"]) == (self.form, key) else None
        except (OSError, ValueError, LookupError, TypeError, RecursionError):
            return None

    def keep(self, folder: Path, key: str, content: Mapping[str, object]) -> None:
        """Keep a content under a key, unless it alone is larger than the part may be."""
        own = folder / self.part
        temporary = own / f"{key}.{os.getpid()}.tmp"
        text = json.dumps({"format": self.form, "key": key, **content})
        if len(text) > MOST_BYTES:
            return
        with suppress(OSError):
            try:
                own.mkdir(parents=True, exist_ok=True)
                temporary.write_text(text)
                temporary.replace(own / f"{key}.json")
                _drop_the_oldest(own)
            finally:  # also if the user interrupts it
                temporary.unlink(missing_ok=True)


def _drop_the_oldest(part: Path) -> None:
    files = [(path.stat(), path) for path in part.iterdir()]  # also those that killed processes left half written
    taken = 0
    for number, (about, path) in enumerate(sorted(files, key=lambda file: file[0].st_mtime_ns, reverse=True), start=1):
        taken += about.st_size
        if number > MOST_FILES or taken > MOST_BYTES:
            path.unlink(missing_ok=True)
