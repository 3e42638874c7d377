"""Watches the files of unit code: units keep the code that they were started with, and a warning names them."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable
from pathlib import Path

from cfgplan.domain import ComputationUnit
from cfgplan.transformations import Transformation
from cfgplan_runtime.lifecycle.file_watch import FileWatch
from cfgplan_runtime.operating.sentences import named


def code_watch(
    folder: Path,
    library: Callable[[], Iterable[Transformation]],
    running: Callable[[], Iterable[ComputationUnit]],
    tell: Callable[[str], object],
) -> FileWatch:
    """A watch that calls `tell` with the units that were started before a file with their code changed.

    `library` and `running` give what can be started and what runs at present; `units.py` in `source: units.py:Class`
    is relative to `folder`. Modules that are named with dots are not watched, nor what code imports.
    """

    def labels_of_files() -> dict[Path, list[str]]:
        labels = defaultdict(list)
        for one in library():
            place, _, _ = (one.source or "").rpartition(":")
            if place.endswith(".py"):
                labels[folder / place].append(one.label)
        return labels

    def tell_of(changed: frozenset[Path]) -> None:
        for path, labels in sorted(labels_of_files().items()):
            known = [unit for unit in running() if unit.transformation in labels] if path in changed else []
            units = [unit.id for unit in known if not unit.standby]
            if units:
                tell(_sentence(path, units))

    return FileWatch(labels_of_files, tell_of)


def _sentence(path: Path, units: list[str]) -> str:
    again = f"`cfgplan ctl kill {units[0]}` has it started anew"
    return f"{path.name} has changed, and these units run with the code from before: {named(units)}; {again}"
