"""The README's first picture, an animated PNG: the page of a run while a unit is killed and replaced.

`python experiments/operating/film.py [--out FILE]` runs the case study of `models/nao` on this computer, films its page
in headless Chromium, kills the segmenter's process by SIGKILL, and ends when the target is met again. The film shows
each picture for as long as the page showed it, at most 2 s.
"""

from __future__ import annotations

import argparse
import io
import os
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import groupby
from pathlib import Path
from typing import Any, NamedTuple

from cfgplan_runtime.operating.control_client import connect
from cfgplan_runtime.operating.operation import Operation, Settings
from cfgplan_runtime.page.server import PageServer
from PIL import Image, ImageDraw, ImageFont

from cfgplan import api

sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))
sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "operating"))

from browsed import CHROMIUM, await_frames, await_so, browser

ROOT = Path(__file__).parents[2]
ENV = ROOT / "models" / "nao" / "1-piff-registered.yaml"
FILM = ROOT / "cfgplan" / "manual" / "pictures" / "healing.png"
KILLED = "segmenter(piff)"
WINDOW = {"width": 1160, "height": 1280}
FILMED: Any = {"x": 0, "y": 0, "width": 1160, "height": 900}
"""The upper part of the window, in pixels: health, picture and the first lines of the lists."""
BAR_PX, FONT_PX = 34, 17
BEFORE_S, AFTER_S = 2.0, 4.0
LONGEST_S = 2.0
"""The longest time that the film shows one picture: a busy computer takes longer for some of them."""
COLOURS = 256
LAST_MS = 2000


class Shot(NamedTuple):
    """A picture of the page (PNG), the seconds that it was shown, the health on it, and the line of the shell."""

    png: bytes
    seconds: float
    level: str
    typed: str


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=FILM)
    options = parser.parse_args()
    if not CHROMIUM.exists():
        sys.exit(f"Chromium is needed at {CHROMIUM}")
    shots = filmed()
    write(shots, options.out)
    states = " ".join(level for level, _ in groupby(shot.level for shot in shots))
    print(f"{options.out}: {states}; {len(shots)} pictures, {options.out.stat().st_size / 1000:.0f} kB")


def filmed() -> list[Shot]:
    """Film a run before, during and after the kill."""
    shots: list[Shot] = []
    with _page_of_a_run() as (operation, tab):
        await_so(tab, "document.getElementById('health').dataset.level === 'well'")
        await_so(tab, "document.querySelectorAll('#targets .row').length === 1")

        def film(until: Callable[[], bool], typed: str) -> None:
            while not until():
                begin = time.monotonic()
                level = tab.get_attribute("#health", "data-level")
                png = tab.screenshot(clip=FILMED)
                shots.append(Shot(png, time.monotonic() - begin, level, typed))

        film(_passed(BEFORE_S), "$")
        while True:
            before = len(shots)
            film(lambda: _running(operation) is not None, "$")
            found = _running(operation)
            assert found is not None
            unit, pid = found
            typed = f"$ kill -9 {pid}    # {unit}"
            film(_passed(1.0), typed)
            os.kill(pid, signal.SIGKILL)
            film(lambda known=found: shots[-1].level == "bad" or _running(operation) not in (None, known), typed)
            await_frames(tab, 1)
            film(lambda: shots[-1].level == "well", typed)
            if any(shot.level == "bad" for shot in shots[before:]):
                break
            del shots[before:]  # a busy computer has repaired it before the next picture: once more
        film(_passed(AFTER_S), typed)
    return shots


def _running(operation: Operation) -> tuple[str, int] | None:
    """The unit to kill and its process; None while it has none."""
    runtime = operation.runtime
    units = [unit.id for unit in runtime.environment.units if unit.transformation == KILLED]
    return next(((unit, pid) for unit in units if (pid := runtime.pid(unit)) is not None), None)


@contextmanager
def _page_of_a_run() -> Iterator[tuple[Operation, Any]]:
    with tempfile.TemporaryDirectory() as folder:
        os.environ["XDG_RUNTIME_DIR"] = folder
        with (
            Operation(api.load(ENV), ENV, Settings()) as operation,
            PageServer(lambda: connect(operation.id)) as page,
            browser(page, viewport=WINDOW, color_scheme="light") as (tab, _),
        ):
            operation.begun.wait()
            yield operation, tab


def _passed(seconds: float) -> Callable[[], bool]:
    end = time.monotonic() + seconds
    return lambda: time.monotonic() > end


def write(shots: list[Shot], path: Path) -> None:
    """Write the film; equal consecutive pictures are merged into one."""
    drawn = [_with_the_shell(shot) for shot in shots]
    palette = _palette([next(each for each, shot in zip(drawn, shots, strict=True) if shot.level == level)
                        for level in ("well", "bad")] + drawn[-1:])  # fmt: skip
    frames: list[Image.Image] = []
    durations_ms: list[int] = []
    for shot, picture in zip(shots, drawn, strict=True):
        frame = picture.quantize(palette=palette, dither=Image.Dither.NONE)
        duration_ms = round(1000 * min(shot.seconds, LONGEST_S))
        if frames and frame.tobytes() == frames[-1].tobytes():
            durations_ms[-1] += duration_ms
        else:
            frames.append(frame)
            durations_ms.append(duration_ms)
    durations_ms[-1] += LAST_MS
    frames[0].save(path, "PNG", save_all=True, append_images=frames[1:], duration=durations_ms, loop=0, optimize=True)


def _palette(pictures: list[Image.Image]) -> Image.Image:
    """Return one palette for several pictures of equal size."""
    column = Image.new("RGB", (pictures[0].width, pictures[0].height * len(pictures)))
    for number, each in enumerate(pictures):
        column.paste(each, (0, number * each.height))
    return column.quantize(COLOURS, method=Image.Quantize.MAXCOVERAGE)


def _with_the_shell(shot: Shot) -> Image.Image:
    """The page, and below it the line of the shell that kills."""
    page = Image.open(io.BytesIO(shot.png)).convert("RGB")
    frame = Image.new("RGB", (page.width, page.height + BAR_PX), "#1f2328")
    frame.paste(page)
    at = (16, page.height + (BAR_PX - FONT_PX) // 2 - 2)
    ImageDraw.Draw(frame).text(at, shot.typed, fill="#d0f0c0", font=ImageFont.load_default(FONT_PX))
    return frame


if __name__ == "__main__":
    main()
