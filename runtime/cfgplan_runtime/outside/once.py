"""Messages that are reported only once."""

from __future__ import annotations

from collections.abc import Callable


class Once:
    """Reports each message once."""

    def __init__(self, tell: Callable[[str], None]) -> None:
        self._tell = tell
        self._told: set[str] = set()

    def tell(self, what: str, text: str) -> None:
        """Report a text, unless it is empty or a text about the same subject `what` was reported before."""
        if text and what not in self._told:
            self._told.add(what)
            self._tell(text)
