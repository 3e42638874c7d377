"""The stream reasoning engine of the paper's Figure 1: it answers a query over semantic subscriptions.

It adds the targets that the formula needs, synchronises their streams into states, and progresses the formula through
them. It reports the answer as soon as it is final, and removes its targets, so that units that no other target needs
are stopped.
"""

from __future__ import annotations

import os
import queue
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from typing import Any, NamedTuple

from cfgplan.domain import Target
from cfgplan.unmet import Reason
from cfgplan_runtime.errors import RuntimeFaultError
from cfgplan_runtime.reasoning import queries
from cfgplan_runtime.reasoning.conditions import Evaluator
from cfgplan_runtime.reasoning.features import Feature
from cfgplan_runtime.reasoning.monitor import Monitor
from cfgplan_runtime.reasoning.states import Synchroniser
from cfgplan_runtime.reasoning.truth import VERDICT_OF, Verdict

_ENGINE_LOOK_S = 0.1
_MOST_AT_ONCE = 10_000
_OWN_CLOCK_NS = 60 * 1_000_000_000
"""Streams whose times differ from the run's clock by more than this have a clock of their own."""
_TIME_OF_DAY_NS = time.time_ns() - time.monotonic_ns()


def _now_ns() -> int:
    """The time of day in nanoseconds, by a clock that is not affected when the computer's clock is set."""
    return time.monotonic_ns() + _TIME_OF_DAY_NS


class _Ended(NamedTuple):
    """The stream of a feature has ended."""

    feature: str


class Engine:
    """Answers one query. It calls `report` in the thread that calls `run`; `name` is part of its targets' labels."""

    def __init__(
        self,
        query: queries.Query,
        subscriptions: queries.Subscriptions,
        report: Callable[[queries.QueryReport], None],
        *,
        name: str | None = None,
    ) -> None:
        self.monitor = Monitor(query.program)
        self._query = query
        self._subscriptions = subscriptions
        self._report = report
        self._name = name or os.urandom(3).hex()
        self._inbox: queue.SimpleQueue[tuple[str, Any, int] | Exception | queries.Noted | _Ended] = queue.SimpleQueue()
        self._is_over = threading.Event()
        self._evaluator = Evaluator(query.program, query.declared.regions, partial(self._note, is_unknown=True))
        self._streams: Synchroniser | None = None
        self._ahead_ns = 0
        """The difference of the run's clock from `_now_ns`."""
        self._skew_ns = 0
        """The difference of the streams' own clock from the run's clock, once states have begun."""
        self._has_targets = False
        self._ended: set[str] = set()
        self._first_ns: int | None = None
        self._absent: tuple[str, ...] = ()
        self._dropped: dict[str, int] = {}

    def run(self, *, for_s: float | None = None, wait_s: float = 0.0, every_s: float = 1.0) -> queries.Answer:
        """Answer the query: until the answer is final, for at most `for_s` seconds, or until all its streams have
        ended.

        Reports progress every `every_s` seconds. Waits up to `wait_s` seconds for targets that can't be met yet, then
        raises UnmetTargetsError. Removes its targets in any case.
        """
        topics = {each.name: each.topic or f"/query/{self._name}/{each.name}" for each in self._query.features}
        added = [self._target(each, topics[each.name]) for each in self._query.features if each.topic is None]
        listeners: list[threading.Thread] = []
        self._subscriptions.listen(self._note)
        try:
            self._set_up(added, topics, wait_s)
            for name, topic in topics.items():
                thread = threading.Thread(target=self._listen, args=(name, topic), name=f"query-{name}", daemon=True)
                thread.start()
                listeners.append(thread)
            answer = self._follow(for_s, every_s)
        finally:
            self._is_over.set()
            for thread in listeners:
                thread.join()
            if self._has_targets:
                self._take_down([target.label for target in added])
        self._report_waiting()
        self._report(answer)
        return answer

    def stop(self) -> None:
        """End `run` soon, with the answer known by then. Thread-safe."""
        self._is_over.set()

    def _target(self, feature: Feature, topic: str) -> Target:
        return Target(self._label(feature), feature.tag, topic)

    def _label(self, feature: Feature) -> str:
        return f"query {self._name} {feature.name}"

    def _set_up(self, targets: Sequence[Target], topics: Mapping[str, str], wait_s: float) -> None:
        begin = time.monotonic()
        if targets:
            self._subscriptions.add(targets)
            self._has_targets = True
            names = {self._label(each): each.name for each in self._query.features}
            while reasons := self._subscriptions.unmet([target.label for target in targets]):
                if time.monotonic() >= begin + wait_s:
                    told = {
                        names[label]: Reason.of(why).about("feature", names[label]) for label, why in reasons.items()
                    }
                    raise queries.UnmetTargetsError(told)
                time.sleep(_ENGINE_LOOK_S)
        self._report(queries.SetUp(topics, time.monotonic() - begin))

    def _take_down(self, labels: Sequence[str]) -> None:
        try:
            self._subscriptions.remove(labels)
        except RuntimeFaultError as error:
            self._note(f"the targets could not be taken down: {error}")

    def _listen(self, name: str, topic: str) -> None:
        """Put the elements of a topic into the inbox (one thread for each feature)."""
        try:
            with self._subscriptions.samples(topic, self._query.timing.patience_ns / 1e9) as samples:
                self._ahead_ns = getattr(samples, "now_ns", _now_ns)() - _now_ns()
                while not self._is_over.is_set():
                    try:
                        for sample in samples:
                            self._inbox.put((name, sample.value, sample.time_ns))
                            self._dropped[name] = getattr(samples, "dropped", 0)
                            if self._is_over.is_set():
                                return
                        self._inbox.put(_Ended(name))
                        return
                    except TimeoutError:
                        continue
        except Exception as error:
            self._inbox.put(error)

    def _follow(self, for_s: float | None, every_s: float) -> queries.Answer:
        begin = time.monotonic()
        begin_ns = _now_ns()
        end = None if for_s is None else begin + for_s
        told = begin
        if not self._query.features:
            self._begin(begin_ns, begin_ns)
        with suppress(KeyboardInterrupt):
            while (end is None or time.monotonic() < end) and not self._is_over.is_set():
                now = time.monotonic()
                if now >= told + every_s:
                    told = now
                    self._tell_progress()
                left = _ENGINE_LOOK_S if end is None else max(0.0, end - now)
                self._take(min(_ENGINE_LOOK_S, self._pause_s(), left), begin_ns)
                if self._streams is not None and self._progress(self._streams) is not Verdict.OPEN:
                    break
                if self._query.features and len(self._ended) == len(self._query.features):
                    break
        return self._answer()

    def _pause_s(self) -> float:
        """The seconds until a state is due without another sample."""
        if self._streams is None:
            return _ENGINE_LOOK_S
        return max(0.0, (self._streams.due_ns() - self._streams_ns()) / 1e9)

    def _take(self, timeout_s: float, begin_ns: int) -> None:
        """Take the samples that have come, and wait up to `timeout_s` for the first."""
        try:
            found = self._inbox.get(timeout=timeout_s)
            for _ in range(_MOST_AT_ONCE):
                if isinstance(found, Exception):
                    raise found
                if isinstance(found, queries.Noted):
                    self._report(found)
                elif isinstance(found, _Ended):
                    self._ended.add(found.feature)
                    self._report(queries.Noted(f"the stream of {found.feature} has ended"))
                else:
                    name, value, time_ns = found
                    if self._streams is None:
                        self._begin(begin_ns, time_ns)
                    assert self._streams is not None
                    self._streams.push(name, time_ns, value)
                found = self._inbox.get_nowait()
        except queue.Empty:
            if self._streams is None and _now_ns() > begin_ns + self._query.timing.patience_ns:
                self._begin(begin_ns, _now_ns() + self._ahead_ns)

    def _begin(self, begin_ns: int, time_ns: int) -> None:
        """Begin to make states. The time of the first sample shows which clock the streams use."""
        apart = time_ns - _now_ns() - self._ahead_ns
        self._skew_ns = self._ahead_ns + (apart if abs(apart) > _OWN_CLOCK_NS else 0)
        holds = {each.name: each.hold_ns for each in self._query.features}
        self._streams = Synchroniser(holds, self._query.timing, begin_ns=begin_ns + self._skew_ns)

    def _streams_ns(self) -> int:
        """The present time on the streams' clock."""
        return _now_ns() + self._skew_ns

    def _progress(self, streams: Synchroniser) -> Verdict:
        for state in streams.ready(self._streams_ns()):
            if self._first_ns is None:
                self._first_ns = state.time_ns
            self._absent = tuple(name for name in streams.missing if name not in state.values)
            if self.monitor.step(state.time_ns, self._evaluator.truths(state.values)) is not Verdict.OPEN:
                break
        return self.monitor.verdict

    def _tell_progress(self) -> None:
        monitor = self.monitor
        if monitor.time_ns is not None:
            waiting = monitor.waiting()
            self._report(queries.Progressed(monitor.time_ns, monitor.states, waiting, monitor.possible, self._absent))

    def _answer(self) -> queries.Answer:
        monitor, streams = self.monitor, self._streams
        is_final = monitor.verdict is not Verdict.OPEN and monitor.time_ns is not None
        return queries.Answer(
            monitor.verdict,
            monitor.states,
            self._first_ns,
            monitor.time_ns,
            (self._streams_ns() - monitor.time_ns) / 1e9 if is_final and monitor.time_ns is not None else None,
            monitor.waiting(),
            monitor.possible,
            monitor.expired,
            {str(condition): VERDICT_OF[truth] for condition, truth in self._evaluator.last.items()},
            {} if streams is None else dict(streams.missing),
            0 if streams is None else streams.late,
            sum(self._dropped.values()),
        )

    def _report_waiting(self) -> None:
        with suppress(queue.Empty):
            while True:
                found = self._inbox.get_nowait()
                if isinstance(found, queries.Noted):
                    self._report(found)

    def _note(self, text: str, *, is_unknown: bool = False) -> None:
        self._inbox.put(queries.Noted(text, is_unknown))
