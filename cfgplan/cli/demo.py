"""`cfgplan demo`: play the paper's case study on running processes, and write a page about it."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cfgplan.cli import options as shared
from cfgplan.cli.durations import duration
from cfgplan.cli.exits import Exit
from cfgplan.cli.interrupts import Interrupts
from cfgplan.cli.screen import FORMAT_VERSION, Screen

if TYPE_CHECKING:
    from cfgplan_runtime.demo.listening import Sample
    from cfgplan_runtime.demo.played import Played
    from cfgplan_runtime.demo.story import Step
    from rich.text import Text


def add_to(verbs: shared.Subparsers) -> None:
    parser = shared.add_verb(
        verbs,
        "demo",
        "play the paper's case study: two robots, one ball, a failure and a fusion",
        "  cfgplan demo nao\n  cfgplan demo nao --step 2s --report page.html",
    )
    parser.add_argument("world", metavar="WORLD", nargs="?", choices=("nao",), default="nao", help="nao (the only one)")
    parser.add_argument("--step", type=duration, default=6.0, metavar="TIME", help="watch each step so long (6s)")
    page = "the page to write (nao.html)"
    parser.add_argument("--report", type=shared.out_file, metavar="FILE", default="nao.html", help=page)
    shared.add_json(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace, screen: Screen) -> Exit:
    from cfgplan_runtime.demo.page import page
    from cfgplan_runtime.demo.playing import play
    from cfgplan_runtime.demo.stage import open_stage
    from cfgplan_runtime.demo.story import SECTION_V

    from cfgplan import __version__, api

    stage = open_stage(options.world)
    out = Path(options.report)
    with Interrupts(), _Narrator(screen) as narrator:
        played = play(stage, SECTION_V, options.step, narrator)
    with screen.phase("compare robots and draw the page"):
        api.write_file(out, page(stage, played, __version__).encode())
    screen.note(f"Wrote {out}.")
    return Exit.OK


class _Narrator:
    """Tells the play on the screen: in words, or as a JSON line for each step."""

    def __init__(self, screen: Screen) -> None:
        from rich.console import Console
        from rich.status import Status

        self._screen = screen
        self._number = -1
        self._now = Status("", console=Console(stderr=True, highlight=False))

    def __enter__(self) -> _Narrator:
        return self

    def __exit__(self, *_: object) -> None:
        self._now.stop()

    def begins(self, step: Step) -> None:
        self._number += 1
        if not self._screen.json:
            self._screen.show(_headline(self._number, step))
            self._screen.flush()

    def answers(self, answered: Played) -> None:
        if not self._screen.json:
            self._screen.show(_answer(answered))
            self._screen.flush()
            self._now.start()

    def watches(self, sample: Sample | None) -> None:
        where = "nothing comes"
        if sample is not None:
            where = f"ball at x {sample.x:+.2f} m, y {sample.y:+.2f} m, {100 * sample.error_m:.0f} cm off"
        self._now.update(where)

    def ends(self, played: Played) -> None:
        from cfgplan_runtime.demo import telling

        self._now.stop()
        if self._screen.json:
            record = {"format_version": FORMAT_VERSION, **_record(self._number, played)}
            self._screen.write(json.dumps(record) + "\n")
        else:
            self._screen.show(_said("/result", telling.seen(played) or "Nothing comes.", "cyan"))
        self._screen.flush()


def _headline(number: int, step: Step) -> Text:
    from rich.text import Text

    line = Text(f"\n{number}  {step.title}", style="bold green")
    line.append(f"   {step.section}\n", style="dim")
    return line.append(f"   {step.happens}", style="default")


def _answer(answered: Played) -> Text:
    from cfgplan_runtime.demo import telling
    from rich.text import Text

    lines = [
        _said("noticed", "; ".join(telling.noticed(answered))),
        _said("decided", telling.decided(answered), "bold"),
    ]
    cost = telling.cost(answered)
    if cost is not None:
        lines.append(_said("cost", cost))
    lines += [_said("instead", other, "dim") for other in telling.others(answered)]
    times = telling.times(answered)
    lines.append(_said("took", ", ".join(f"{word} {telling.span(took)}" for word, took in times)))
    return Text("\n").join(lines)


def _said(what: str, said: str, style: str = "") -> Text:
    from rich.text import Text

    return Text.assemble((f"   {what:8}", "dim"), (said, style))


def _record(number: int, played: Played) -> dict[str, Any]:
    from cfgplan_runtime.demo import telling

    review, error_m = played.review, played.rms_error_m
    changes = played.changes
    return {
        "step": number,
        "title": played.step.title,
        "noticed": telling.noticed(played),
        "decision": str(review.decision),
        "started": [unit.id for unit in changes.started],
        "rewired": [unit.id for unit in changes.rewired],
        "stopped": list(changes.stopped),
        "unmet": dict(review.unmet),
        "cost_us": review.cost_us,
        "others": [{"what": other.what, "cost_us": other.cost_us} for other in played.others],
        "seconds": dict(review.seconds),
        "positions": len(played.samples),
        "lost_frames": telling.lost_frames(played),
        "rms_error_m": None if error_m is None else round(error_m, 4),
        "source": played.source,
    }
