"""Spans of time as people write them."""

from __future__ import annotations

import argparse
import re

_SECONDS = {"ms": 0.001, "s": 1.0, "m": 60.0, "h": 3600.0}


def duration(text: str) -> float:
    """Seconds of `30s`, `1.5m`, `200ms`, `2h` or plain `30`."""
    found = re.fullmatch(r"(\d+(?:\.\d+)?)(ms|s|m|h)?", text)
    if found is None:
        raise argparse.ArgumentTypeError(f"{text!r} is no span of time: write 30s, 5m or 1h")
    return float(found[1]) * _SECONDS[found[2] or "s"]
