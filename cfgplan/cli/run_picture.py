"""The state of a run, drawn from its record (`manual/control.md`): all of it, or as much as fits the terminal.

The live view fetches the state and redraws it a few times a second.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Self

from cfgplan_runtime.lifecycle.kinds import Level
from cfgplan_runtime.lifecycle.review_sentences import Waiting, in_display_order, reasons_by_target, short, waiting
from rich.console import Console, ConsoleOptions, Group, RenderableType, RenderResult
from rich.live import Live
from rich.rule import Rule
from rich.table import Table
from rich.text import Text

from cfgplan.amounts import clock_time, core_share, rate, short_core_share, span
from cfgplan.cli.plan_text import in_stream_order
from cfgplan.cli.run_output import RunOutput, fetched, show_files, show_ledger
from cfgplan.cli.screen import Screen, counted, printable
from cfgplan.summary import some

if TYPE_CHECKING:
    from cfgplan_runtime.lifecycle.reports import Snapshot, UnitView
    from cfgplan_runtime.operating.operation import Operation

    from cfgplan.unmet import SharedReason

_STYLES = {Level.WARNING: "yellow", Level.ERROR: "red"}
_DECISIONS = {"failed": "red", "undecided": "red", "kept": "dim", "deferred": "dim"}
_FEWEST_LOG_LINES = 4
_MOST_REVIEWS = 4
_MOST_REVIEWS_TOLD = 5
_NARROW = 80
"""Columns below which a terminal is too narrow for all figures and names."""
_OLD_S = 2.0
"""Seconds of silence after which a stream is shown as silent."""
_REFRESH_S = 0.25
_LARGEST_SHARE = 0.1
"""The largest share of time for drawing; a system of thousands of units is drawn less often."""
_MOST_LINES = 200
_LINES_AFTERWARDS = 8


@dataclass(frozen=True, slots=True)
class LogLine:
    """A line of the log; the time is in seconds since 1970."""

    at: float
    level: Level
    text: str
    is_review: bool = False

    def text_with_time(self) -> Text:
        """As it is shown."""
        shown = Text().append(f"{clock_time(self.at)}  ", style="dim")
        return shown.append(printable(self.text), style=_STYLES.get(self.level, ""))


def state_text(run: str, environment: str, pid: int, state: Mapping[str, Any]) -> RenderableType:
    """All of the state; `environment` is the file's name."""
    return Group(*_whole(run, environment, pid, state))


def observed_text(state: Mapping[str, Any]) -> RenderableType:
    """The facts of a run, and a row for each output whose quality was learned from streams."""
    if not (state["facts"] or state["qualities"]):
        return Text("No fact is declared, and no quality was observed yet (`observe:`).")
    parts: list[RenderableType] = [Text(f"Facts: {', '.join(_facts(state))}.")] if state["facts"] else []
    if state["qualities"]:
        where = ["host"] if any("host" in one for one in state["qualities"]) else []
        table = Table("output", *where, "quality", "declared", "planned", "observed", "error", "ago", box=None)
        for one in state["qualities"]:
            figures = (f"{one[key]:.4g}" for key in ("declared", "planned", "estimate", "error"))
            there = [one.get(key, "") for key in where]
            table.add_row(one["output"], *there, one["attribute"], *figures, span(one["ago_s"]))
        parts.append(table)
    return Group(*parts)


def _whole(run: str, environment: str, pid: int, state: Mapping[str, Any]) -> Iterator[RenderableType]:
    yield _headline(run, environment, [f"pid {pid}"], state)
    yield from map(_fault, state["faults"])
    yield _targets(state)
    yield Text()
    yield _units(state)
    if state["lost_hosts"]:
        yield Text(f"Hosts that are gone: {', '.join(state['lost_hosts'])}.", style="yellow")
    if state["units"] and (idle := _idle_hosts(state)):
        yield Text(f"No unit on {some(idle)}.")
    if state["facts"]:
        yield Text(f"Facts: {', '.join(_facts(state))}.")
    for what, value in state["qualities_now"].items():
        yield Text(f"For now: {what} {value}.")
    for label, why in state["left_out"].items():
        yield Text(f"Left out for now: {label}, {why}.", style="yellow")
    for label, hosts in state["barred"].items():
        for host, why in hosts.items():
            yield Text(f"{label} may not run on {host} for now: {why}.", style="yellow")
    if state["clocks_ahead_us"]:
        clocks = (
            f"{host} {'+' if ahead_us >= 0 else ''}{span(ahead_us / 1e6)}"
            for host, ahead_us in sorted(state["clocks_ahead_us"].items())
        )
        yield Text(f"Clocks of hosts against this one: {', '.join(clocks)} (corrected).")
    if state["crossings"]:
        yield Text("Streams between hosts:")
        yield _crossings(state["crossings"])
    if state["declared"]:
        yield Text(f"Added: {', '.join(state['declared'])}.")
    if state["removed"]:
        yield Text(f"Removed: {', '.join(state['removed'])}.")
    if state["reviews"]:
        yield Text()
    yield from (Text(review["says"]) for review in state["reviews"][-_MOST_REVIEWS_TOLD:])


@dataclass(frozen=True)
class RunPicture:
    """The state with the log, fitted to the present size of the terminal; faults come first."""

    run: str
    environment: str
    elapsed_s: float
    state: Mapping[str, Any]
    lines: Sequence[LogLine] = ()
    recorded: int | None = None
    note: str = ""

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        height = options.height or console.height
        yield Group(*self._parts(max(8, height), is_narrow=options.max_width < _NARROW))

    def _parts(self, height: int, *, is_narrow: bool) -> Iterator[RenderableType]:
        state = self.state
        reviews = state["reviews"][-_MOST_REVIEWS:]
        rows = len(state["units"]) + len(waiting(state["backing_off"]))
        # Headline, footer, and a title for each of the four parts; tables have a row of headings.
        room = height - 2 - 4 - 2 - len(state["faults"][:1])
        log = min(max(_FEWEST_LOG_LINES, room // 4), max(1, room - 3))
        room -= log
        reviews = reviews[-max(1, room // 4) :]
        room -= max(1, len(reviews))
        targets = min(len(state["targets"]), max(1, room // 2, room - rows))
        units = max(1, room - max(1, targets))
        log += max(0, units - max(1, rows))
        facts = [time.strftime("%H:%M:%S", time.gmtime(self.elapsed_s))]
        if self.recorded is not None:
            facts.append(f"recorded {self.recorded}")
        if state["lost_hosts"]:
            facts.append(f"gone: {', '.join(state['lost_hosts'])}")
        yield _clipped(_headline(self.run, self.environment, facts, state))
        yield from (_clipped(_fault(fault)) for fault in state["faults"][:1])
        met = sum(target["met"] for target in state["targets"])
        yield _title(f"targets  {met} of {len(state['targets'])} met")
        yield _targets(state, targets)
        yield _title(f"units  {len(state['units'])}")
        yield _units(state, units, is_narrow=is_narrow)
        yield _title("reviews")
        yield from (_clipped(_review(review)) for review in reviews)
        if not reviews:
            yield Text("none yet", style="dim")
        yield _title("log")
        # Reviews have a part of their own.
        shown = [line for line in self.lines if not line.is_review][-log:]
        yield from (_clipped(line.text_with_time()) for line in shown)
        yield from (Text("") for _ in range(log - len(shown)))
        footer = self.note or "Ctrl-C stops  ·  edit the file, or use `cfgplan ctl`, to change what runs"
        yield _clipped(Text(footer, style="bold yellow" if self.note else "dim"))


def _idle_hosts(state: Mapping[str, Any]) -> list[str]:
    """Return the hosts that are not lost and have no unit."""
    taken = {unit["host"] for unit in state["units"]}
    return [host for host in state["hosts"] if host not in taken and host not in state["lost_hosts"]]


def _facts(state: Mapping[str, Any]) -> Iterator[str]:
    """Yield the present facts; for an observed one, with the time of its last element."""
    heard = state["facts_heard_s"]
    for name, value in state["facts"].items():
        ago = f" (observed {span(heard[name])} ago)" if name in heard else ""
        yield f"{name} is {value}{ago}"


def _headline(run: str, environment: str, facts: Iterable[str], state: Mapping[str, Any]) -> Text:
    parts = [*facts, state["phase"]]
    if state["horizon_left_s"] is not None:
        parts.append(f"horizon in {span(state['horizon_left_s'])}")
    parts.append(core_share(state["cost_us"] / max(1, state["horizon_s"])))
    if state["saving_us"]:
        parts.append(f"{span(state['saving_us'] / 1e6)} of CPU could be saved by replanning at the horizon")
    return Text(f"Run {run} of {environment}", style="bold").append("  " + "  ·  ".join(parts), style="dim")


def _fault(fault: Mapping[str, Any]) -> Text:
    place = ":".join(str(fault[key]) for key in ("file", "line", "column") if fault[key] is not None)
    said = f"{place}: {fault['message']}" if place else fault["message"]
    return Text(f"The file has an error; the run keeps the last valid version: {said}", style="bold red")


def _crossings(crossings: list[Mapping[str, Any]]) -> RenderableType:
    table = Table("stream", "from", "to", "elements", "dropped", "waiting", box=None)
    for one in crossings:
        counts = (str(one[key]) for key in ("elements", "dropped", "waiting"))
        table.add_row(one["stream"] or "of units that are gone", one["from"], one["to"], *counts)
    return table


def _targets(state: Mapping[str, Any], room: int | None = None) -> RenderableType:
    columns = (("target", 1), ("topic", 1), (">rate", 0), (">latency", 0), ("from", 2))
    ordered = in_display_order(state["targets"])
    # The cause must be on the line.
    reasons = reasons_by_target(ordered) if room is None else reasons_by_target(ordered, 1)
    rows = [list(_target(target, reasons.get(target["label"]))) for target in ordered]
    return _drawn(columns, rows, room, "target")


def _target(target: Mapping[str, Any], reason: SharedReason | None) -> Iterator[Text]:
    """Yield the cells of a target; `reason` says why it is not met."""
    has_stream = target["stream"] is not None
    rate_hz, latency_ms = (target.get(key) if has_stream else None for key in ("rate_hz", "latency_ms"))
    yield Text(target["label"], style="green" if target["met"] else "red")
    yield Text(target["topic"] or "")
    yield Text(rate(rate_hz) if rate_hz else "")
    yield Text("" if latency_ms is None else span(latency_ms / 1e3))
    silent_s = target.get("silent_s")
    if reason is not None:
        first = reason.labels[0]
        yield Text(reason.text if target["label"] == first else f"as {first}", style="red")
    elif not has_stream:
        yield Text(target["unit"])
    elif silent_s is None or silent_s > _OLD_S:
        silent = "nothing came yet" if silent_s is None else f"silent for {span(silent_s)}"
        yield Text().append(f"{target['stream']}  ").append(silent, style="yellow")
    else:
        yield Text(target["stream"])


def _units(state: Mapping[str, Any], room: int | None = None, *, is_narrow: bool = False) -> RenderableType:
    """Transformations that wait, then the units; odd ones first where there is not room for all. Process ids are shown
    where there is room for everything; on a narrow terminal names have room before memory and before counts of 0.
    """
    units, failing = list(state["units"]), waiting(state["backing_off"])
    if room is not None and len(units) + len(failing) > room:
        units.sort(key=lambda unit: not _is_odd(unit))
    keys = [key for key in ("host", "pid") if any(unit.get(key) for unit in units) and (key == "host" or room is None)]
    numbers = [(f">{name}", 0) for name in ("cpu", "memory", "steps/s", "dropped", "errors")]
    columns = (("unit", 1), *((key, 0) for key in keys), *numbers, ("state", 2))
    rows = [_waiting(each, len(columns)) for each in failing]
    rows += [_unit(unit, [Text(str(unit.get(key) or "")) for key in keys]) for unit in units]
    if is_narrow:
        left_out = {"memory", *(name for name in ("dropped", "errors") if not any(unit.get(name) for unit in units))}
        shown = [place for place, (name, _) in enumerate(columns) if name.lstrip(">") not in left_out]
        columns = tuple((columns[place][0], {"unit": 2, "state": 1}.get(columns[place][0], 0)) for place in shown)
        rows = [[row[place] for place in shown] for row in rows]
    return _drawn(columns, rows, room, "unit")


def _is_odd(unit: Mapping[str, Any]) -> bool:
    if "steps" not in unit:
        return not unit.get("standby")
    return bool(unit["errors"] or unit["dropped"] or unit.get("unfed"))


def _unit(unit: Mapping[str, Any], more: list[Text]) -> list[Text]:
    said = ((port, [streams] if isinstance(streams, str) else streams) for port, streams in unit["inputs"].items())
    state = Text(", ".join(f"{port} ← {stream}" for port, streams in said for stream in streams), style="dim")
    if unit.get("unfed"):
        has_some = not unit["inputs"].keys().isdisjoint(unit["unfed"])
        state = Text(f"{'too little' if has_some else 'nothing'} feeds {', '.join(unit['unfed'])}", style="red")
    elif unit.get("errors") and unit["last_error"]:
        state = Text(printable(short(unit["last_error"])), style="yellow")
    elif "steps" not in unit:
        spare = "a cold spare, prepared" if unit.get("prepared") else "a cold spare"
        state = Text(spare if unit.get("standby") else "new", style="cyan")
    if "steps" not in unit:
        return [Text(unit["id"]), *more, *[Text("")] * 5, state]
    return [
        Text(unit["id"]),
        *more,
        Text("" if unit["upkeep_us"] is None else short_core_share(unit["upkeep_us"])),
        Text(f"{unit['memory_bytes'] >> 20} MB"),
        Text(f"{unit['steps_per_s']:.1f}"),
        *(Text(str(unit[key]), style="yellow" if unit[key] else "dim") for key in ("dropped", "errors")),
        state,
    ]


def _waiting(failing: Waiting, columns: int) -> list[Text]:
    return [Text(some(failing.names), style="red"), *[Text("")] * (columns - 2), Text(failing.says, style="red")]


def _review(review: Mapping[str, Any]) -> Text:
    shown = Text(f"{span(max(0.0, time.time() - review['time_s']))} ago  ", style="dim")
    return shown.append(review["says"], style=_DECISIONS.get(review["decision"], ""))


def _drawn(
    columns: Sequence[tuple[str, int]], rows: Sequence[Sequence[Text]], room: int | None, noun: str
) -> RenderableType:
    """Return a table of as many rows as fit into `room` lines, one line per row; all rows if that is None.

    A column has its share of the remaining width; a `>` before its name aligns numbers.
    """
    fits = room is not None
    table = Table(box=None, expand=fits, padding=(0, 2, 0, 0), header_style="dim", pad_edge=False)
    for name, ratio in columns:
        table.add_column(
            name.lstrip(">"),
            justify="right" if name.startswith(">") else "left",
            ratio=(ratio or None) if fits else None,
            no_wrap=fits,
            overflow="ellipsis" if fits else "fold",
        )
    shown = rows if room is None or len(rows) <= room else rows[: max(0, room - 1)]
    for row in shown:
        table.add_row(*row)
    if not rows:
        return Group(table, Text("none", style="dim"))
    if len(shown) == len(rows):
        return table
    return Group(table, Text(f"... and {counted(len(rows) - len(shown), noun)} more", style="dim"))


def _title(text: str) -> RenderableType:
    return Rule(Text(text, style="bold"), align="left", style="dim")


def _clipped(text: Text) -> Text:
    return Text.assemble(text, no_wrap=True, overflow="ellipsis")


class LiveView(RunOutput):
    """Fills the terminal during a run; important lines are printed again when it is over."""

    def __init__(self, screen: Screen, operation: Operation) -> None:
        super().__init__(screen, operation)
        self._live = Live(
            console=Console(highlight=False, markup=False, emoji=False),
            screen=True,
            auto_refresh=False,
            redirect_stdout=False,
            redirect_stderr=False,
        )
        self._lines: deque[LogLine] = deque(maxlen=_MOST_LINES)
        self._since_s = time.monotonic()
        self._draw_at_s = 0.0
        self._note = ""
        self._reviews = 0

    def __enter__(self) -> Self:
        self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._live.stop()

    def update(self, wait_s: float) -> None:
        from cfgplan_runtime.lifecycle.kinds import level, sentence
        from cfgplan_runtime.lifecycle.reports import Reviewed

        for news in fetched(self._operation, wait_s):
            said = news if isinstance(news, str) else sentence(news)
            is_review = isinstance(news, Reviewed)
            self._reviews += is_review
            if said is not None:
                grade = Level.WARNING if isinstance(news, str) else level(news)
                self._lines += (LogLine(time.time(), grade, text, is_review) for text in said.splitlines())
        if time.monotonic() >= self._draw_at_s:
            self._draw()

    def note(self, text: str) -> None:
        self._note = text
        self._draw()

    def sum_up(self) -> None:
        self.update(0.0)
        took = time.strftime("%H:%M:%S", time.gmtime(time.monotonic() - self._since_s))
        operation, screen = self._operation, self._screen
        screen.note(
            f"Run {operation.id} of {operation.environment} ended after {took}; {counted(self._reviews, 'review')}."
        )
        for line in list(self._lines)[-_LINES_AFTERWARDS:]:
            screen.show(line.text_with_time())
        show_ledger(operation, screen)
        show_files(operation, screen)

    def _draw(self) -> None:
        from cfgplan_runtime.operating.records import snapshot_record

        began_s = time.monotonic()
        operation = self._operation
        snapshot = operation.manager.snapshot()
        picture = RunPicture(
            run=operation.id,
            environment=operation.environment,
            elapsed_s=time.monotonic() - self._since_s,
            state=snapshot_record(
                replace(snapshot, units=_in_stream_order(snapshot)),
                operation.rates.of_topics(operation.flows, snapshot.targets),
            ),
            lines=tuple(self._lines),
            recorded=operation.recorder.recording.written if operation.recorder else None,
            note=self._note,
        )
        if self._live.is_started:
            self._live.update(picture, refresh=True)
        now_s = time.monotonic()
        self._draw_at_s = now_s + max(_REFRESH_S, (now_s - began_s) / _LARGEST_SHARE)


def _in_stream_order(snapshot: Snapshot) -> tuple[UnitView, ...]:
    """The units from sources to targets."""
    views = {view.unit.id: view for view in snapshot.units}
    return tuple(views[unit.id] for unit in in_stream_order(snapshot.environment) if unit.id in views)
