"""Narrates a play on the terminal."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rich.console import Console
from rich.status import Status
from rich.text import Text

from cfgplan import __version__, api
from cfgplan.cli.interrupts import Interrupts
from cfgplan.cli.screen import Screen
from nao_demo import telling
from nao_demo.listening import Sample
from nao_demo.page import page
from nao_demo.played import Played
from nao_demo.playing import play
from nao_demo.story import SECTION_V, Step


def show(screen: Screen, step_s: float, out: Path, port: int | None = None) -> None:
    """Play the story, watch each step for `step_s` seconds, and write the HTML report to `out`.

    With a `port` (0: any free one), the page of the run is served there meanwhile.
    """
    with Interrupts(), Narrator(screen) as narrator:
        played = play(SECTION_V, step_s, narrator, port)
    with screen.phase("compare robots and draw the page"):
        api.write_file(out, page(played, __version__).encode())
    screen.note(f"Wrote {out}.")


class Narrator:
    """Prints the play on the screen: in words, or as a JSON line for each step."""

    def __init__(self, screen: Screen) -> None:
        self._screen = screen
        self._number = -1
        self._now = Status("", console=Console(stderr=True, highlight=False))

    def __enter__(self) -> Narrator:
        return self

    def __exit__(self, *_: object) -> None:
        self._now.stop()

    def is_served(self, url: str) -> None:
        self._screen.note(f"The page is at {url}")

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
        self._now.stop()
        if self._screen.json:
            self._screen.write_json(_record(self._number, played))
        else:
            self._screen.show(_said("/result", telling.seen(played) or "Nothing comes.", "cyan"))
        self._screen.flush()


def _headline(number: int, step: Step) -> Text:
    line = Text(f"\n{number}  {step.title}", style="bold green")
    line.append(f"   {step.section}\n", style="dim")
    return line.append(f"   {step.happens}", style="default")


def _answer(answered: Played) -> Text:
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
    return Text.assemble((f"   {what:8}", "dim"), (said, style))


def _record(number: int, played: Played) -> dict[str, Any]:
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
