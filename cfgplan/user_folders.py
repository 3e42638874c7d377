"""The folders that a user has set for caches, states and sockets: the variables of the XDG specification."""

from __future__ import annotations

import os
from pathlib import Path


def user_folder(variable: str) -> Path | None:
    """Return the folder that a variable such as `XDG_CACHE_HOME` has; None without one.

    A relative path is ignored, as the specification demands: it would be another folder in each current directory.
    """
    path = Path(os.environ.get(variable, ""))
    return path if path.is_absolute() else None
