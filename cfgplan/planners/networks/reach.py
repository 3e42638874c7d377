"""The transformations that can start among themselves, beginning with sources; updated while more are added.

Feedback inputs count as fed, and so does a distinct group with enough feeders: where there are such, some labels that
are reached can't really run.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from cfgplan.onward import derivations
from cfgplan.planners.networks.core import Core
from cfgplan.reasons import Each


class Reach:
    """Present labels of a core, and the facts that hold then; the last addition can be undone.

    `order` has the labels whose needs hold, in an order in which they can be started.
    """

    def __init__(self, core: Core, labels: Iterable[int] = (), each: Each = iter) -> None:
        self._core = core
        self._missing: dict[int, int] = {}
        self._waiting: dict[int, list[int]] = {}
        self._given: dict[int, int] = {}
        self._added: int | None = None
        self._started = 0
        self._wait(dict.fromkeys(labels))
        self.order: list[int] = []
        self._start([label for label, number in self._missing.items() if not number], each)

    def holds(self, fact: int | None) -> bool:
        """Whether enough providers of a fact have started; False for None."""
        return fact in self._given and self._given[fact] >= self._core.multi_takes.get(fact, 1)

    def runs(self, label: int) -> bool:
        """Whether a label was added and its needs hold."""
        return self._missing.get(label) == 0

    def add(self, label: int) -> None:
        """Add a label, and the labels that it lets start."""
        self._added, before = None, len(self.order)
        if label not in self._missing:
            self._added = label
            self._wait([label])
            if not self._missing[label]:
                self._start([label])
        self._started = len(self.order) - before

    def take_back(self) -> None:
        """Undo the last `add`."""
        if self._added is None:
            return
        core, kept = self._core, len(self.order) - self._started
        for one in self.order[kept:]:
            for fact in core.gives.lists[one]:
                if self._given[fact] == core.multi_takes.get(fact, 1):
                    for consumer in self._waiting.get(fact, ()):
                        self._missing[consumer] += 1
                self._given[fact] -= 1
        for fact in core.needs.lists[self._added]:
            self._waiting[fact].pop()
        del self._missing[self._added]
        del self.order[kept:]
        self._added, self._started = None, 0

    def _wait(self, labels: Iterable[int]) -> None:
        needs_of, waiting, is_first = self._core.needs.lists, self._waiting, not self._given
        for label in labels:
            needs = needs_of[label]
            self._missing[label] = len(needs) if is_first else len(needs) - sum(map(self.holds, needs))
            for fact in needs:
                waiting.setdefault(fact, []).append(label)

    def _start(self, ahead: list[int], each: Each = iter) -> None:
        """Start labels whose needs hold, then the labels that can start after them."""
        self.order += ahead
        for label, _ in derivations(self._held(each(ahead)), self._waiting, self._missing):
            ahead.append(label)
            self.order.append(label)

    def _held(self, started: Iterable[int]) -> Iterator[int]:
        """Count the facts that labels give; yield each that others need as soon as it holds."""
        gives, takes, given, waiting = self._core.gives.lists, self._core.multi_takes, self._given, self._waiting
        for label in started:
            for fact in gives[label]:
                number = given[fact] = given.get(fact, 0) + 1
                if number == takes.get(fact, 1) and fact in waiting:
                    yield fact
