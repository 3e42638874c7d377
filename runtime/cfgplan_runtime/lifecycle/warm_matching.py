"""Matching that continues from one world to the next: only new tags and axioms take time."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence

from cfgplan.api import World, refuse_circles
from cfgplan.domain import Similarity
from cfgplan.errors import InputError
from cfgplan.matching import Matcher, Matching, Ontology
from cfgplan.planning import Pair


class WarmMatching:
    """Matches the tags of one world after the other; reviews have it decide open pairs (`planning.Decider`).

    `similarity` is the same object as long as nothing changes, which keeps a planner's session warm. All questions that
    leave a pair open share the time limit, which is renewed when tags or the ontology change.
    """

    def __init__(self, reasoner: str, time_limit_s: float | None) -> None:
        self._reasoner = reasoner
        self._time_limit_s = self._left_s = time_limit_s
        self._matcher: Matcher | None = None
        self._offered: frozenset[str] = frozenset()
        self._demanded: frozenset[str] = frozenset()
        self._last: World | None = None
        self.similarity = Similarity({})
        self.warnings: tuple[str, ...] = ()
        self.counts: Mapping[str, int] = {}

    def take(self, world: World) -> None:
        """Match a world from now on, without asking the reasoner. Raises InputError, and then keeps the last world."""
        last = self._last
        self._take(world)
        try:
            refuse_circles(world, self.similarity)
        except InputError:
            if last is not None:
                self._take(last)
            raise

    def _take(self, world: World) -> None:
        environment = world.environment
        offered = frozenset(port.tag for t in environment.library for port in t.outputs)
        demanded = frozenset(port.tag for t in environment.library for port in t.inputs)
        demanded |= {target.tag for target in environment.stream_targets}
        is_known = (self._offered, self._demanded) == (offered, demanded)
        if is_known and self._last is not None and self._last.ontology == world.ontology:
            self._last = world
            return
        try:
            self._match(world.ontology, offered, demanded)
        except InputError:
            last, self._matcher = self._last, None
            self._offered = self._demanded = frozenset()
            if last is not None:
                self._take(last)
            raise
        self._last, self._left_s = world, self._time_limit_s

    def decide(self, pairs: Sequence[Pair]) -> int:
        """Ask about open pairs; returns how many were asked. Raises InputError for a contradictory ontology.

        If the reasoner can't be asked (no room on the disk), the pairs stay open and `warnings` says so.
        """
        if self._matcher is None or (self._left_s is not None and self._left_s <= 0):
            return 0
        start = time.monotonic()
        try:
            asked = self._matcher.decide(pairs, time_limit_s=self._left_s)
        except OSError as error:
            self.warnings = (f"the reasoner can't be asked: {error.strerror}",)
            return 0
        self._note(self._matcher.matching(time_limit_s=self._left_s, decide=False))
        if self._left_s is not None and any(self.similarity.is_open(*pair) for pair in pairs):
            self._left_s -= time.monotonic() - start
        return asked

    def _match(self, ontology: Ontology, offered: frozenset[str], demanded: frozenset[str]) -> None:
        if self._matcher is None:
            self._matcher = Matcher(ontology, reasoner=self._reasoner)
        matcher = self._matcher
        gone = {"offered": self._offered - offered, "demanded": self._demanded - demanded}
        new = {"offered": offered - self._offered, "demanded": demanded - self._demanded}
        matcher.remove(**gone)
        if matcher.ontology != ontology:
            matcher.change_ontology(ontology)
        matcher.add(**new)
        self._offered, self._demanded = offered, demanded
        self._note(matcher.matching(time_limit_s=self._time_limit_s, decide=False))

    def _note(self, found: Matching) -> None:
        self.warnings, self.counts = found.warnings, found.counts
        if found.similarity != self.similarity:
            self.similarity = found.similarity
