"""Links between hosts that carry less than their streams need."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping

from cfgplan_runtime.children.messages import CrossingCounts

CROWDED_S = 5.0
"""Seconds over which the streams of a link are measured."""
_BITS_PER_MBIT = 1_000_000

Crossings = Mapping[tuple[str, str, str], CrossingCounts]
"""Counts by stream, source host and target host."""


class CrowdedLinks:
    """Warns of each link that drops elements for lack of room, with the rates that its streams need and that it
    carries.

    A link is reported once, and again if it has dropped nothing for CROWDED_S seconds in between.
    """

    def __init__(self) -> None:
        self._before: tuple[float, Crossings] | None = None
        self._told: set[tuple[str, str]] = set()

    def told(self, crossings: Crossings, now_s: float) -> Iterator[str]:
        """Add counts. Yields a warning for each link that was not reported yet."""
        if self._before is None:
            self._before = now_s, crossings
        began_s, before = self._before
        if now_s - began_s < CROWDED_S:
            return
        self._before = now_s, crossings
        links: dict[tuple[str, str], list[tuple[str, CrossingCounts, CrossingCounts]]] = defaultdict(list)
        for key, counts in crossings.items():
            stream, source, target = key
            if stream:  # what is gone does not need the link any more
                links[source, target].append((stream, before.get(key, CrossingCounts()), counts))
        for link, streams in links.items():
            dropped = {
                stream: (now.crowded - then.crowded, now.elements - then.elements)
                for stream, then, now in streams
                if now.crowded > then.crowded
            }
            gives = sum(max(0, now.arrived_bytes - then.arrived_bytes) for _, then, now in streams)
            if not dropped:
                self._told.discard(link)
            elif gives and link not in self._told:
                self._told.add(link)
                needs = sum(max(0, now.offered_bytes - then.offered_bytes) for _, then, now in streams)
                listed = ", ".join(f"{lost} of {of} of {stream}" for stream, (lost, of) in sorted(dropped.items()))
                yield (
                    f"the link from {link[0]} to {link[1]} takes less than its streams need: they need "
                    f"{_rate(needs, now_s - began_s)}, it gives {_rate(gives, now_s - began_s)}; in "
                    f"{now_s - began_s:.0f} s it had no room for {listed}"
                )


def _rate(number: int, over_s: float) -> str:
    """Bytes as a rate that people read."""
    mbit = 8 * number / over_s / _BITS_PER_MBIT
    return f"{mbit:.0f} Mbit/s" if mbit >= 10 else f"{mbit:.2g} Mbit/s"
