"""The transformations that can start among themselves, beginning with sources; updated while more are added.

Feedback inputs count as fed, and so does a distinct group with enough feeders: where there are such, some labels that
are reached can't really run.
"""

from __future__ import annotations

from collections.abc import Iterable

from cfgplan.planners.networks.network import Network


class Reach:
    """Present labels of a network, and the facts that hold then; the last addition can be undone."""

    def __init__(self, network: Network, labels: Iterable[int] = ()) -> None:
        self._network = network
        self._missing: dict[int, int] = {}
        self._waiting: dict[int, list[int]] = {}
        self._given: dict[int, int] = {}
        self._holding: set[int] = set()
        self._added: int | None = None
        self._fired: list[int] = []
        for label in labels:
            self.add(label)

    def meets(self, tag: str) -> bool:
        """Whether a stream for the tag is reached."""
        return self._network.fact_of_tag.get(tag) in self._holding

    def runs(self, label: int) -> bool:
        """Whether a label was added and its needs hold."""
        return self._missing.get(label) == 0

    def add(self, label: int) -> None:
        """Add a label, and the labels that it lets start."""
        self._added, self._fired = None, []
        if label in self._missing:
            return
        needs = self._network.core.needs.lists[label]
        self._added, self._missing[label] = label, 0
        for fact in needs:
            if fact not in self._holding:
                self._missing[label] += 1
            self._waiting.setdefault(fact, []).append(label)
        if not self._missing[label]:
            self._fire(label)

    def _fire(self, label: int) -> None:
        core = self._network.core
        self._fired.append(label)
        for one in self._fired:
            for fact in core.gives.lists[one]:
                given = self._given[fact] = self._given.get(fact, 0) + 1
                if given == core.crowd_takes.get(fact, 1):
                    self._holding.add(fact)
                    for consumer in self._waiting.get(fact, ()):
                        self._missing[consumer] -= 1
                        if not self._missing[consumer]:
                            self._fired.append(consumer)

    def take_back(self) -> None:
        """Undo the last `add`."""
        if self._added is None:
            return
        core = self._network.core
        for one in self._fired:
            for fact in core.gives.lists[one]:
                if self._given[fact] == core.crowd_takes.get(fact, 1):
                    self._holding.discard(fact)
                    for consumer in self._waiting.get(fact, ()):
                        self._missing[consumer] += 1
                self._given[fact] -= 1
        for fact in core.needs.lists[self._added]:
            self._waiting[fact].pop()
        del self._missing[self._added]
        self._added, self._fired = None, []
