"""Delays before a failed action is tried again."""

from __future__ import annotations


def doubling_s(failures: int, first_s: float, most_s: float) -> float:
    """The delay in seconds: none after the first failure in a row, `first_s` after the second, then doubled up to
    `most_s`.
    """
    return 0.0 if failures < 2 else min(most_s, first_s * 2.0 ** min(failures - 2, 60))
