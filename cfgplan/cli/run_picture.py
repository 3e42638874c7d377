"""The picture of a run: targets, units, reviews and the log, as many lines of each as the terminal has room for."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from math import isinf
from typing import Literal, TypeVar

from cfgplan_runtime.children.messages import Flow
from cfgplan_runtime.lifecycle.reports import BackingOff, Decision, Review, Snapshot, TargetView, UnitView
from cfgplan_runtime.operating.sentences import ERROR, WARNING, because, decision, milliseconds, named, short
from rich.console import Console, ConsoleOptions, Group, RenderableType, RenderResult
from rich.rule import Rule
from rich.table import Table
from rich.text import Text

from cfgplan.cli.plan_text import with_the_stream
from cfgplan.cli.run_output import printable
from cfgplan.cli.screen import counted
from cfgplan.domain import ComputationUnit

T = TypeVar("T")

_STYLES = {WARNING: "yellow", ERROR: "red"}
_DECISIONS = {Decision.FAILED: "red", Decision.UNDECIDED: "red", Decision.KEPT: "dim", Decision.DEFERRED: "dim"}
_FEWEST_LOG_LINES = 4
_MOST_REVIEWS = 4
_OLD_S = 2.0
"""A stream that is silent for longer is shown as that."""


@dataclass(frozen=True, slots=True)
class LogLine:
    """A line of the log; the time is in seconds since 1970."""

    at: float
    level: int
    text: str
    is_review: bool = False

    def text_with_time(self) -> Text:
        """As it is shown."""
        shown = Text().append(time.strftime("%H:%M:%S  ", time.localtime(self.at)), style="dim")
        return shown.append(printable(self.text), style=_STYLES.get(self.level, ""))


@dataclass(frozen=True)
class RunPicture:
    """Everything that is shown; drawn for the size that the terminal has at that moment."""

    run: str
    environment: str
    elapsed_s: float
    snapshot: Snapshot
    flows: Mapping[str, Flow]
    lines: Sequence[LogLine] = ()
    recorded: int | None = None
    note: str = ""
    now_s: float = field(default_factory=time.time)

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        height = options.height or console.height
        yield Group(*self._parts(max(8, height)))

    def _parts(self, height: int) -> Iterator[RenderableType]:
        snapshot = self.snapshot
        waiting = len(snapshot.backing_off)
        reviews = min(_MOST_REVIEWS, max(1, len(snapshot.reviews)))
        # Headline, footer, and a title for each of the four parts; tables have a row of headings.
        room = height - 2 - 4 - 2 - len(snapshot.faults[:1])
        log = min(max(_FEWEST_LOG_LINES, room // 4), max(1, room - 3))
        room -= log
        reviews = min(reviews, max(1, room // 4))
        room -= reviews
        targets = min(len(snapshot.targets), max(1, room // 2, room - len(snapshot.units) - waiting))
        units = max(1, room - max(1, targets))
        spare = max(0, units - max(1, len(snapshot.units) + waiting))
        yield self._headline()
        for fault in snapshot.faults[:1]:
            yield _clipped(Text(f"The file can't be used, what it said before holds: {fault}", style="bold red"))
        met = sum(target.is_met for target in snapshot.targets)
        yield _title(f"targets  {met} of {len(snapshot.targets)} met")
        yield self._targets(targets)
        yield _title(f"units  {len(snapshot.units)}")
        yield self._units(units)
        yield _title("reviews")
        yield self._reviews(reviews)
        yield _title("log")
        # Reviews have a part of their own.
        shown = [line for line in self.lines if not line.is_review][-(log + spare) :]
        yield from (_clipped(line.text_with_time()) for line in shown)
        yield from (Text("") for _ in range(log + spare - len(shown)))
        yield self._footer()

    def _headline(self) -> Text:
        snapshot = self.snapshot
        line = Text("cfgplan run ", style="bold").append(self.environment, style="bold cyan")
        parts = [f"run {self.run}", time.strftime("%H:%M:%S", time.gmtime(self.elapsed_s)), snapshot.phase.value]
        if not isinf(snapshot.horizon_left_s):
            parts.append(f"horizon in {_span(snapshot.horizon_left_s)}")
        parts.append(f"{snapshot.cost_us / 1e6:.3g} s of CPU per {_span(snapshot.horizon_s)}")
        if snapshot.saving_us:
            parts.append(f"{snapshot.saving_us / 1e6:.3g} s to save at the horizon")
        if self.recorded is not None:
            parts.append(f"recorded {self.recorded}")
        return _clipped(line.append("  " + "  ·  ".join(parts), style="dim"))

    def _targets(self, room: int) -> RenderableType:
        table = _table(("target", 1), ("topic", 1), (">rate", 0), (">latency", 0), ("from", 2))
        ordered = sorted(self.snapshot.targets, key=lambda target: (target.is_met, -target.priority, target.label))
        for target in _first(ordered, room):
            table.add_row(*self._target(target))
        return _with_rest(table, len(ordered), room, "target")

    def _target(self, target: TargetView) -> Iterator[RenderableType]:
        flow = self.flows.get(target.topic, Flow()) if target.stream is not None else Flow()
        yield Text(target.label, style="green" if target.is_met else "red")
        yield Text(target.topic)
        yield Text(f"{flow.rate_hz:.1f} Hz" if flow.elements else "", style="" if flow.rate_hz else "yellow")
        yield Text("" if flow.latency_ms is None else milliseconds(flow.latency_ms / 1e3))
        if target.stream is None or target.is_silent:
            yield Text(target.reason, style="red")
        elif flow.silent_s is None or flow.silent_s > _OLD_S:
            silent = "nothing came yet" if flow.silent_s is None else f"silent for {_span(flow.silent_s)}"
            yield Text().append(f"{target.stream}  ").append(silent, style="yellow")
        else:
            yield Text(str(target.stream))

    def _units(self, room: int) -> RenderableType:
        snapshot = self.snapshot
        table = _table(
            ("unit", 1), (">cpu", 0), (">memory", 0), (">steps/s", 0), (">dropped", 0), (">errors", 0), ("state", 2)
        )
        views = {view.unit.id: view for view in snapshot.units}
        ordered = [views[unit.id] for unit in with_the_stream(snapshot.environment) if unit.id in views]
        if len(ordered) + len(snapshot.backing_off) > room:
            ordered.sort(key=lambda view: not self._is_odd(view))
        rows = [*map(self._waiting, snapshot.backing_off), *map(self._unit, ordered)]
        for row in _first(rows, room):
            table.add_row(*row)
        return _with_rest(table, len(rows), room, "unit")

    def _gaps(self, unit: ComputationUnit) -> list[str]:
        transformation = self.snapshot.environment.transformation.get(unit.transformation)
        return sorted(set(transformation.input) - set(unit.feeds)) if transformation and not unit.standby else []

    def _is_odd(self, view: UnitView) -> bool:
        seen = view.observation
        if seen is None:
            return not view.unit.standby
        return bool(seen.errors or seen.dropped or self._gaps(view.unit))

    def _unit(self, view: UnitView) -> list[Text]:
        unit, seen, gaps = view.unit, view.observation, self._gaps(view.unit)
        host = "" if view.host is None else f" on {view.host}"
        does = "running" if seen else "a cold spare" if unit.standby else "new"
        state = Text().append(f"{does}{host}", style="green" if seen else "cyan")
        if gaps:
            state = Text(f"nothing feeds {', '.join(gaps)}", style="red")
        elif seen and seen.errors and seen.last_error:
            state = Text(printable(short(seen.last_error)), style="yellow")
        elif unit.feeds:
            state.append(f"  {', '.join(f'{s.port} ← {s.stream}' for s in unit.subscriptions)}", style="dim")
        if seen is None:
            return [Text(unit.id), *[Text("")] * 5, state]
        upkeep = "" if seen.upkeep_us is None else f"{seen.upkeep_us / 1e4:.1f} %"
        return [
            Text(unit.id),
            Text(upkeep),
            Text(f"{seen.memory_bytes >> 20} MB"),
            Text(f"{seen.steps_per_s:.1f}"),
            Text(str(seen.dropped), style="yellow" if seen.dropped else "dim"),
            Text(str(seen.errors), style="yellow" if seen.errors else "dim"),
            state,
        ]

    def _waiting(self, waiting: BackingOff) -> list[Text]:
        again = "until it changes" if isinf(waiting.left_s) else f"for {_span(waiting.left_s)}"
        times = "once" if waiting.failures == 1 else f"{waiting.failures} times"
        state = Text(f"not started {again}, failed {times}: {short(waiting.cause)}", style="red")
        return [Text(waiting.transformation, style="red"), *[Text("")] * 5, state]

    def _reviews(self, room: int) -> RenderableType:
        table = Table(box=None, expand=True, padding=(0, 2, 0, 0), show_header=False, pad_edge=False)
        for name, ratio in (("number", 0), ("ago", 0), ("because", 2), ("decision", 3), ("took", 0)):
            justify: Literal["left", "right"] = "left" if ratio else "right"
            table.add_column(name, justify=justify, ratio=ratio or None, no_wrap=True, overflow="ellipsis")
        for review in self.snapshot.reviews[-room:]:
            table.add_row(*self._review(review))
        return table if table.row_count else Text("none yet", style="dim")

    def _review(self, review: Review) -> Iterator[Text]:
        yield Text(str(review.number), style="dim")
        yield Text(f"{_span(max(0.0, self.now_s - review.time_s))} ago", style="dim")
        yield Text(because(review), style="dim")
        unmet = f"; {named(sorted(review.unmet))} not met" if review.unmet else ""
        yield Text(decision(review) + unmet, style=_DECISIONS.get(review.decision, ""))
        yield Text(milliseconds(sum(review.seconds.values())), style="dim")

    def _footer(self) -> Text:
        text = self.note or "Ctrl-C stops  ·  edit the file, or use `cfgplan ctl`, to change what runs"
        return _clipped(Text(text, style="bold yellow" if self.note else "dim"))


def _table(*columns: tuple[str, int]) -> Table:
    """A table of one line per row; a column's share of what is left of the width, a `>` for numbers."""
    table = Table(box=None, expand=True, padding=(0, 2, 0, 0), header_style="dim", pad_edge=False)
    for name, ratio in columns:
        table.add_column(
            name.lstrip(">"),
            justify="right" if name.startswith(">") else "left",
            ratio=ratio or None,
            no_wrap=True,
            overflow="ellipsis",
        )
    return table


def _first(rows: Sequence[T], room: int) -> Sequence[T]:
    return rows if len(rows) <= room else rows[: max(0, room - 1)]


def _with_rest(table: Table, count: int, room: int, noun: str) -> RenderableType:
    if count == 0:
        return Group(table, Text("none", style="dim"))
    if count <= room:
        return table
    return Group(table, Text(f"... and {counted(count - max(0, room - 1), noun)} more", style="dim"))


def _title(text: str) -> RenderableType:
    return Rule(Text(text, style="bold"), align="left", style="dim")


def _clipped(text: Text) -> Text:
    return Text.assemble(text, no_wrap=True, overflow="ellipsis")


def _span(seconds: float) -> str:
    """A time as people say it: `4.2 s`, `3 min`, `2 h 5 min`."""
    if seconds < 10:
        return f"{seconds:.1f} s"
    if seconds < 120:
        return f"{seconds:.0f} s"
    if seconds < 7200:
        return f"{seconds / 60:.0f} min"
    minutes = f" {seconds % 3600 // 60:.0f} min" if seconds % 3600 >= 60 else ""
    return f"{seconds // 3600:.0f} h{minutes}"
