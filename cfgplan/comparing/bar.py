"""A progress bar for a comparison, with an estimate of what is left."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from cfgplan.comparing.runner import Standing

if TYPE_CHECKING:
    from rich.console import Console


@contextmanager
def progress_bar(console: Console) -> Iterator[Callable[[Standing], None]]:
    """A function to `watch` a run with; the bar is shown on a terminal only."""
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (
        BarColumn(bar_width=30),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("{task.fields[left]}"),
        TextColumn("{task.description}", style="dim"),
    )
    with Progress(*columns, console=console, disable=not console.is_terminal) as bar:
        task = bar.add_task("", total=None, left="")

        def watch(standing: Standing) -> None:
            left = ""
            if standing.left_s is not None and standing.done < standing.total:
                left = f"about {duration(standing.left_s)} left"
            bar.update(
                task, total=standing.total, completed=standing.done, left=left, description=standing.ahead, refresh=True
            )

        yield watch


def duration(seconds: float) -> str:
    """`2:05 min`, `1:10 h` or `12 s`."""
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60}:{whole % 60:02} min"
    return f"{whole // 3600}:{whole % 3600 // 60:02} h"
