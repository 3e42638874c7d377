"""The cache folder, kept between runs: answers about tags, and archives of a reasoner's classes."""

from __future__ import annotations

import os
from pathlib import Path


def cache_folder() -> Path:
    """`$XDG_CACHE_HOME/cfgplan`, or `~/.cache/cfgplan`. Raises RuntimeError without a home."""
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "cfgplan"
