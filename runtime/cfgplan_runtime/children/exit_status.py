"""How processes end, in words."""

from __future__ import annotations

import signal


def end_of_process(status: int) -> str:
    """An exit status in words."""
    return f"killed by {signal.Signals(-status).name}" if status < 0 else f"ended with exit status {status}"


def clause_of(end: str) -> str:
    """An end, as `end_of_process` says it, as the verb of a sentence."""
    return end if end.startswith(("ended", "is ")) else f"was {end}"
