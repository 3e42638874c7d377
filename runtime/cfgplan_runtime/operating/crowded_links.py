"""Links between hosts that carry less than their streams need."""

from __future__ import annotations

from collections.abc import Iterator

from cfgplan.amounts import mbit
from cfgplan_runtime.lifecycle.link_rates import MEASURED_S, Crossings, uses


class CrowdedLinks:
    """Warns of each link that drops elements for lack of room, with the rates that its streams need and that it
    carries.

    A link is reported once, and again if it has dropped nothing for MEASURED_S seconds in between.
    """

    def __init__(self) -> None:
        self._before: tuple[float, Crossings] | None = None
        self._told: set[tuple[str, str]] = set()

    def warnings(self, crossings: Crossings, now_s: float) -> Iterator[str]:
        """Add counts. Yields a warning for each link that was not reported yet."""
        if self._before is None:
            self._before = now_s, crossings
        began_s, before = self._before
        if now_s - began_s < MEASURED_S:
            return
        self._before = now_s, crossings
        span_s = now_s - began_s
        for link, use in uses(before, crossings).items():
            if not use.dropped:
                self._told.discard(link)
            elif use.arrived and link not in self._told:
                self._told.add(link)
                listed = ", ".join(f"{lost} of {of} of {stream}" for stream, (lost, of) in sorted(use.dropped.items()))
                yield (
                    f"the link from {link[0]} to {link[1]} takes less than its streams need: they need "
                    f"{mbit(use.offered / span_s)}, it gives {mbit(use.arrived / span_s)}; in "
                    f"{span_s:.0f} s it had no room for {listed}"
                )
