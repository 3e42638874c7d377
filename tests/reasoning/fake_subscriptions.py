"""Subscriptions without processes: streams are lists."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from cfgplan.domain import Target


class Given(NamedTuple):
    time_ns: int
    value: Any


class Stream:
    """Gives what there is; then it is silent, as a stream is that goes on."""

    def __init__(self, given: Sequence[Given], wait: Callable[[], None]) -> None:
        self._left = list(given)
        self._wait = wait
        self.dropped = 0

    def __iter__(self) -> Iterator[Given]:
        while self._left:
            yield self._left.pop(0)
        self._wait()
        raise TimeoutError


@dataclass
class FakeSubscriptions:
    """`streams` by tag. `refusals` says how often a tag can't be met at first, and why."""

    streams: Mapping[str, Sequence[Given]]
    refusals: dict[str, list[str]] = field(default_factory=dict)
    targets: dict[str, Target] = field(default_factory=dict)
    log: list[str] = field(default_factory=list)
    tell: Callable[[str], None] | None = None

    def add(self, targets: Sequence[Target]) -> None:
        self.targets.update({target.label: target for target in targets})
        self.log.append(f"add {', '.join(sorted(target.tag for target in targets))}")

    def unmet(self, labels: Sequence[str]) -> Mapping[str, str]:
        wanted = {label: self.targets[label].tag for label in labels}
        return {label: self.refusals[tag].pop(0) for label, tag in wanted.items() if self.refusals.get(tag)}

    def remove(self, labels: Sequence[str]) -> None:
        self.log.append(f"remove {', '.join(sorted(self.targets.pop(label).tag for label in labels))}")

    @contextmanager
    def samples(self, topic: str, wait_s: float) -> Iterator[Stream]:
        import threading

        tag = next((target.tag for target in self.targets.values() if target.topic == topic), topic)
        quiet = threading.Event()
        yield Stream(self.streams[tag], lambda: quiet.wait(min(wait_s, 0.01)) and None)

    def listen(self, tell: Callable[[str], None]) -> None:
        self.tell = tell


def stream(*values: Any, every_ms: int = 100, begin_ms: int = 0) -> list[Given]:
    """Values at a regular pace, on a clock of their own."""
    return [Given((begin_ms + number * every_ms) * 1_000_000, value) for number, value in enumerate(values)]
