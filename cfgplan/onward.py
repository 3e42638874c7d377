"""What leads on from what."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TypeVar

Item = TypeVar("Item")


def reached(starts: Iterable[Item], onward: Callable[[Item], Iterable[Item]]) -> list[Item]:
    """Some things and all that they lead to, directly or through others, each once and the nearest first."""
    found = dict.fromkeys(starts)
    ahead = list(found)
    for here in ahead:
        new = dict.fromkeys(one for one in onward(here) if one not in found)
        found |= new
        ahead += new
    return ahead
