"""The known name that somebody who wrote an unknown one probably meant."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from difflib import get_close_matches

_MOST_NAMES_COMPARED = 500
_LETTERS = "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_-./:()@ "


def did_you_mean(name: str, known: Collection[str], otherwise: str) -> str:
    """A mend for an unknown name: the known one that is close to it, or else a hint.

    Among many names only those that differ by one letter are found: comparing with all of them takes seconds.
    """
    if len(known) <= _MOST_NAMES_COMPARED:
        close = get_close_matches(name, known, n=1)
    else:
        close = [edited for edited in _edits(name) if edited in known][:1]
    return f"did you mean `{close[0]}`?" if close else otherwise


def _edits(name: str) -> Iterator[str]:
    """Every text that differs from a name by one letter, or by the order of two."""
    for at in range(len(name) + 1):
        before, after = name[:at], name[at:]
        if after:
            yield before + after[1:]
        if len(after) > 1:
            yield before + after[1] + after[0] + after[2:]
        for letter in _LETTERS:
            yield before + letter + after
            if after:
                yield before + letter + after[1:]
