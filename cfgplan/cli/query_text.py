"""How `cfgplan query` shows what an engine reports, for people and for machines."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from cfgplan.cli.screen import FORMAT_VERSION, Screen, counted

if TYPE_CHECKING:
    from cfgplan_runtime.reasoning.answers import Answer, Progressed, Report
    from cfgplan_runtime.reasoning.monitor import Waiting


def as_json(screen: Screen) -> Callable[[Report], None]:
    def show(report: Report) -> None:
        line = {"format_version": FORMAT_VERSION, "event": type(report).__name__, **asdict(report)}
        screen.write(json.dumps(line, default=sorted, ensure_ascii=False) + "\n")
        screen.flush()

    return show


def as_text(screen: Screen, formula: str, *, verbose: bool) -> Callable[[Report], None]:
    from cfgplan_runtime.reasoning import answers

    last: list[object] = [None]

    def show(report: Report) -> None:
        match report:
            case answers.SetUp(topics, seconds):
                streams = ", ".join(f"{name} on {topic}" for name, topic in topics.items())
                screen.note(f"Set up in {seconds:.2f} s: {streams or 'no streams are needed'}.")
            case answers.Noted(text):
                screen.note(text, style="yellow" if verbose or "unknown" in text else "dim")
            case answers.Progressed():
                situation = (report.waiting, report.possible, report.missing)
                if situation != last[0]:
                    last[0] = situation
                    screen.show(f"{_clock(report.time_ns)}  open   {_open_text(report)}")
            case answers.Answer():
                screen.show(_answer_text(report, formula))
        screen.flush()

    return show


def _open_text(report: Progressed) -> str:
    parts = [f"waits for {_waiting_text(each)}" for each in report.waiting if each.until_ns is not None][:2]
    if len(report.possible) < 3:
        parts.append(f"can still become {' or '.join(sorted(report.possible))}")
    if report.missing:
        parts.append(f"no value of {', '.join(report.missing)}")
    return "; ".join(parts) or f"after {counted(report.states, 'state')}"


def _answer_text(answer: Answer, formula: str) -> str:
    lines = []
    at = "" if answer.time_ns is None else f"{_clock(answer.time_ns)}  "
    lines.append(f"{at}{answer.verdict.value}   {formula}")
    if answer.time_ns is None or answer.first_ns is None:
        lines.append("  no state came")
    else:
        span = f"{(answer.time_ns - answer.first_ns) / 1e9:.3f} s after the first"
        if answer.delay_s is None:
            lines.append(f"  after {counted(answer.states, 'state')}; the last is {span}")
        else:
            late = f"known {1000 * answer.delay_s:.0f} ms after its time"
            lines.append(f"  decided by state {answer.states}, {span}; {late}")
            lines += [
                f"  {each.text} of {_clock(each.since_ns)} had ended" for each in answer.expired[:3] if each.since_ns
            ]
            lines += [f"  in it {text} is {verdict.value}" for text, verdict in list(answer.last.items())[:6]]
    lines += [f"  waits for {_waiting_text(each)}" for each in answer.waiting[:3] if answer.delay_s is None]
    if answer.delay_s is None and len(answer.possible) < 3:
        lines.append(f"  it can still become {' or '.join(sorted(answer.possible))}")
    lines += _losses(answer.missing, answer)
    return "\n".join(lines)


def _losses(missing: Mapping[str, int], answer: Answer) -> Sequence[str]:
    found = [f"{name} had no value in {counted(count, 'state')}" for name, count in missing.items() if count]
    if answer.late:
        found.append(f"{counted(answer.late, 'sample')} came too late (--delay)")
    if answer.dropped:
        found.append(f"{counted(answer.dropped, 'sample')} dropped because the query was slow")
    return [f"  {text}" for text in found]


def _waiting_text(waiting: Waiting) -> str:
    since = "" if waiting.since_ns is None else f" of {_clock(waiting.since_ns)}"
    until = "" if waiting.until_ns is None else f", until {_clock(waiting.until_ns)}"
    return f"{waiting.text}{since}{until}"


def _clock(time_ns: Any) -> str:
    """A time on the clock; of a stream with a clock of its own, in seconds."""
    if time_ns < 1_000_000_000 * 86_400 * 365:
        return f"{time_ns / 1e9:.3f}s"
    at = time.strftime("%H:%M:%S", time.localtime(time_ns / 1e9))
    return f"{at}.{time_ns // 1_000_000 % 1000:03}"
