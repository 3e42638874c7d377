"""The state of a run as text for people, from the record that the control socket gives."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

if TYPE_CHECKING:
    from cfgplan_runtime.operating.control_client import RunningSystem

_MOST_REVIEWS = 5


def state_text(system: RunningSystem, state: Mapping[str, Any]) -> RenderableType:
    """The whole state."""
    return Group(*_parts(system, state))


def _parts(system: RunningSystem, state: Mapping[str, Any]) -> Iterator[RenderableType]:
    left_s = state["horizon_left_s"]
    horizon = "" if left_s is None else f", horizon in {left_s:.0f} s"
    cost = f"{state['cost_us'] / 1e6:.3g} s of CPU per {state['horizon_s']} s"
    name = Path(system.environment).name
    yield Text(f"Run {system.run} of {name} (pid {system.pid}): {state['phase']}{horizon}, {cost}.", style="bold")
    for fault in state["faults"]:
        yield Text(f"The file can't be used, what it said before holds: {_fault(fault)}", style="red")
    yield _targets(state["targets"])
    yield Text()
    yield _units(state["units"])
    for waiting in state["backing_off"]:
        left = "until it changes" if waiting["left_s"] is None else f"for {waiting['left_s']:.0f} s"
        cause = " ".join(waiting["cause"].split())
        yield Text(f"{waiting['transformation']} is not started {left}: {cause}", style="yellow")
    if state["lost_hosts"]:
        yield Text(f"Hosts that are gone: {', '.join(state['lost_hosts'])}.", style="yellow")
    if state["declared"]:
        yield Text(f"Added: {', '.join(state['declared'])}.")
    if state["removed"]:
        yield Text(f"Removed: {', '.join(state['removed'])}.")
    if state["reviews"]:
        yield Text()
    for review in state["reviews"][-_MOST_REVIEWS:]:
        yield Text(review["says"])


def _targets(targets: list[Mapping[str, Any]]) -> RenderableType:
    if not targets:
        return Text("No targets.")
    table = Table("target", "topic", "rate", "latency", "from", box=None)
    for target in targets:
        rate, latency_ms = target.get("rate_hz"), target.get("latency_ms")
        table.add_row(
            Text(target["label"], style="green" if target["met"] else "red"),
            target["topic"],
            "" if rate is None else f"{rate:.1f} Hz",
            "" if latency_ms is None else f"{latency_ms:.1f} ms",
            _from(target),
        )
    return table


def _from(target: Mapping[str, Any]) -> Text:
    """What a target gets its elements from, or why it gets none."""
    if not target["met"]:
        return Text(target["reason"], style="red")
    if target.get("rate_hz") != 0:
        return Text(target["stream"])
    silent_s = target.get("silent_s")
    silent = "nothing came yet" if silent_s is None else f"silent for {silent_s:.0f} s"
    return Text().append(f"{target['stream']}  ").append(silent, style="yellow")


def _units(units: list[Mapping[str, Any]]) -> RenderableType:
    if not units:
        return Text("No units run.")
    table = Table("unit", "pid", "cpu", "memory", "steps/s", "dropped", "errors", "fed by", box=None)
    for unit in units:
        upkeep = unit.get("upkeep_us")
        memory = f"{unit['memory_bytes'] >> 20} MB" if "memory_bytes" in unit else ""
        counts = [str(unit.get(key, "")) for key in ("steps_per_s", "dropped", "errors")]
        feeds = ", ".join(f"{port} <- {stream}" for port, stream in unit["inputs"].items())
        pid = "" if unit.get("pid") is None else str(unit["pid"])
        table.add_row(unit["id"], pid, "" if upkeep is None else f"{upkeep / 1e4:.1f} %", memory, *counts, feeds)
    return table


def _fault(fault: Mapping[str, Any]) -> str:
    place = ":".join(str(fault[key]) for key in ("file", "line", "column") if fault[key] is not None)
    return f"{place}: {fault['message']}" if place else str(fault["message"])
