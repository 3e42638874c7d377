"""Telling each thing once."""

from __future__ import annotations

from collections.abc import Callable


class Once:
    """Tells each thing once."""

    def __init__(self, tell: Callable[[str], None]) -> None:
        self._tell = tell
        self._told: set[str] = set()

    def tell(self, what: str, text: str) -> None:
        """Tell a text, unless it is empty or one was told about the same thing (`what`)."""
        if text and what not in self._told:
            self._told.add(what)
            self._tell(text)
