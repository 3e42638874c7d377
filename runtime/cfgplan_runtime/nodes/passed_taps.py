"""The taps of a relay: which messages it passes on to the run, whose observers look at them.

The helper in the user's ROS Python imports this module, which needs nothing but the standard library.
"""

from __future__ import annotations

from dataclasses import dataclass

PASS_S = 0.1
"""Seconds from one message of a tap to the next, at least: observers need no more, and images are large."""


@dataclass
class _PassedTap:
    """A tap: its source topic, when the next message is due, and how many messages came since the last one."""

    source: str
    due_s: float = 0.0
    skipped: int = 0


class PassedTaps:
    """The open taps of a relay, by their topics."""

    def __init__(self) -> None:
        self._taps: dict[str, _PassedTap] = {}

    def __contains__(self, source: object) -> bool:
        return any(tap.source == source for tap in self._taps.values())

    def open(self, topic: str, source: str) -> None:
        """Pass on messages of a source topic from now on."""
        self._taps[topic] = _PassedTap(source)

    def close(self, topic: str) -> str | None:
        """Pass on messages for a tap no more. Returns its source topic; None for an unknown tap."""
        tap = self._taps.pop(topic, None)
        return None if tap is None else tap.source

    def due(self, source: str, now_s: float) -> list[tuple[str, int]]:
        """Return the taps to which a message that has come now is passed on, and how many each has skipped before."""
        found = []
        for topic, tap in self._taps.items():
            if tap.source != source:
                continue
            if now_s < tap.due_s:
                tap.skipped += 1
                continue
            found.append((topic, tap.skipped))
            tap.due_s, tap.skipped = now_s + PASS_S, 0
        return found
