"""How long to wait before what has failed is tried again."""

from __future__ import annotations


def doubling_s(failures: int, first_s: float, most_s: float) -> float:
    """No time after the first failure in a row, `first_s` after the second, then twice as much each time."""
    return 0.0 if failures < 2 else min(most_s, first_s * 2.0 ** min(failures - 2, 60))
