"""The answer to a question which tags match, by itself: an answer that was kept needs no reasoner, nor its import."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field

from cfgplan.domain import Similarity
from cfgplan.frozen import dataclass


def impossible(tag: str) -> str:
    """The warning about an offered tag that nothing can have."""
    return f"nothing can have the offered tag {tag!r}: it contradicts the ontology and never matches"


@dataclass(frozen=True)
class Matching:
    """The similarity of tags, warnings, and how many pairs of distinct tags each reasoner decided.

    `asked` is the number of pairs that the reference was asked about by now, whether it answered or not.
    """

    similarity: Similarity
    warnings: tuple[str, ...] = ()
    answered_by: Mapping[str, int] = field(default_factory=dict, hash=False)
    asked: int = 0
    impossible: frozenset[str] = frozenset()
    """The offered tags that nothing can have, each with a warning."""

    @property
    def other_warnings(self) -> tuple[str, ...]:
        """The warnings but those of impossible tags."""
        return tuple(told for told in self.warnings if not any(told == impossible(tag) for tag in self.impossible))

    @property
    def counts(self) -> dict[str, int]:
        """The figures of a plan that was made by it (`planning.Decider`)."""
        decided = {f"pairs decided by {name}": pairs for name, pairs in self.answered_by.items()}
        return {**decided, "pairs asked": self.asked} if self.asked else decided
