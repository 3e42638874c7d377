"""Watches the code of units: broken code is reported once, and its transformation left out until it changes."""

from __future__ import annotations

import threading
from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import TypeAlias

from cfgplan.domain import ComputationUnit
from cfgplan.errors import Fault
from cfgplan.onward import grouped
from cfgplan.transformations import Transformation
from cfgplan_runtime.children.source_faults import code_path
from cfgplan_runtime.children.unit_order import digest_of
from cfgplan_runtime.lifecycle.changes import FaultyCode, RestartUnits
from cfgplan_runtime.lifecycle.file_watch import FileWatch
from cfgplan_runtime.lifecycle.reports import Report, UnitEvent
from cfgplan_runtime.lifecycle.review_sentences import named
from cfgplan_runtime.supervision.events import HostLost, UnitDied, UnitReady, UnitStopped

SourceCheck: TypeAlias = Callable[[Transformation, Path], Fault | None]
"""What keeps units of a transformation from being started, by its source; files are relative to the folder."""


def faults_of(library: Iterable[Transformation], folder: Path, check: SourceCheck | None) -> dict[str, Fault]:
    """The faults of the code of transformations, by label; none without a check."""
    if check is None:
        return {}
    found = ((one.label, check(one, folder)) for one in library)
    return {label: fault for label, fault in found if fault is not None}


def left_out_text(labels: Sequence[str], fault: str) -> str:
    """Return the report of transformations whose code can't be started."""
    one, many = "is left out until its code changes", "are left out until their code changes"
    return f"{named(labels)} {one if len(labels) == 1 else many}: {fault}"


class Sources(FileWatch):
    """A watch of the files that sources name.

    `library` and `running` return the transformations and the running units. `check` finds the fault of a source; with
    None no code is checked, since other computers have it. `request` is called when the set of transformations that can
    be started changes, `tell` with each new fault. After an edit of a file, `tell_old` is called with the file and the
    units that run with the code from before, and again when one of these ends. Modules with dotted names are watched if
    they are found; imports of unit code are not. If it `reloads`, it requests a restart of units whose code has
    changed. The user has already seen the faults in `told`, by label. Let it `hear` the manager, to know with which
    code units have started, and which have ended.
    """

    def __init__(
        self,
        folder: Path,
        check: SourceCheck | None,
        *,
        library: Callable[[], Sequence[Transformation]],
        running: Callable[[], Iterable[ComputationUnit]],
        request: Callable[[FaultyCode | RestartUnits], object],
        tell: Callable[[str], object],
        tell_old: Callable[[str, tuple[str, ...]], object],
        reloads: bool = False,
        told: Mapping[str, str] = MappingProxyType({}),
    ) -> None:
        super().__init__(lambda: self._labels_of_files(library()), self._hear)
        self._folder, self._check = folder, check
        self._library, self._running, self._request, self._say = library, running, request, tell
        self._tell_old, self._reloads, self._shown = tell_old, reloads, told
        self._faults: dict[str, str] = {}
        self._lock = threading.Lock()
        self._seen: Sequence[Transformation] | None = None
        self._digests: Mapping[Path, str | None] = {}
        """The digest of each file at the last look."""
        self._started: dict[str, Mapping[Path, str | None]] = {}
        """By unit: these digests at its start."""
        self._old_lock = threading.RLock()
        self._old: dict[str, tuple[str, ...]] = {}
        """By file: the units that run with the code from before, if there are any."""

    def hear(self, report: Report) -> None:
        """Listen to a manager: note the code of a unit that has started, and which units have ended."""
        match report:
            case UnitEvent(UnitReady(unit)):
                self._started[unit] = self._digests
            case UnitEvent(UnitDied(unit) | UnitStopped(unit)):
                self._started.pop(unit, None)
                self._forget_old(lambda one: one == unit)
            case UnitEvent(HostLost()):  # its units get no `UnitDied` of their own
                running = {one.id for one in self._running()}
                self._forget_old(lambda one: one not in running)

    def look_at(self, library: Sequence[Transformation], changed: Collection[str] = ()) -> None:
        """Look at all sources of a library. `changed` are the labels whose files have changed."""
        with self._lock:
            self._seen = library
            self._digests = {path: digest_of(path) for path in self._labels_of_files(library)}
            self._note(self.faults_of(library), changed)

    def take_in_new_ones(self) -> None:
        self._follow()
        super().take_in_new_ones()

    def _follow(self) -> None:
        """Check faulty sources again, since a module may be installed by now; check all sources of a new library."""
        library = self._library()
        if library is not self._seen:
            self.look_at(library)
            return
        with self._lock:
            if self._faults:
                faulty = [one for one in library if one.label in self._faults]
                self._note(self.faults_of(faulty), ())

    def faults_of(self, library: Iterable[Transformation]) -> dict[str, str]:
        """Return the faults of the code of transformations, by label, and remember none."""
        return {label: str(fault) for label, fault in faults_of(library, self._folder, self._check).items()}

    def _note(self, faults: Mapping[str, str], changed: Collection[str]) -> None:
        before, self._faults = self._faults, dict(faults)
        new = [
            (fault, label)
            for label, fault in faults.items()
            if fault not in (before.get(label), self._shown.get(label))
        ]
        for fault, labels in grouped(new).items():
            self._say(left_out_text(labels, fault))
        self._shown = {}
        if faults != before or changed:
            self._request(FaultyCode(dict(faults), tuple(sorted(changed))))

    def _labels_of_files(self, library: Iterable[Transformation]) -> dict[Path, list[str]]:
        labels = defaultdict(list)
        for one in library:
            path = code_path(one.source, self._folder)
            if path is not None:
                labels[path].append(one.label)
        return labels

    def _hear(self, changed: frozenset[Path]) -> None:
        library = self._library()
        labels = {path: labels for path, labels in self._labels_of_files(library).items() if path in changed}
        if labels:
            self.look_at(library, [label for each in labels.values() for label in each])
        for path, of_file in sorted(labels.items()):
            now, name = digest_of(path), self._name(path)
            if self._faults.keys() >= {*of_file}:
                continue
            with self._old_lock:  # a unit that ends meanwhile is heard of after this
                known = [unit for unit in self._running() if unit.transformation in of_file and not unit.standby]
                # A fault is told by itself, and its code can't be started instead.
                told = {unit.id for unit in known if unit.transformation not in self._faults} | {
                    *self._old.get(name, ())
                }
                units = [
                    unit.id for unit in known if unit.id in told and self._started.get(unit.id, {}).get(path) != now
                ]
                if not (units and self._reloads):
                    self._note_old(name, tuple(units))
                    continue
            self._say(f"{path.name} has changed: {named(units)} {'is' if len(units) == 1 else 'are'} restarted")
            self._request(RestartUnits(tuple(units), path.name))

    def _name(self, path: Path) -> str:
        return str(path.relative_to(self._folder)) if path.is_relative_to(self._folder) else str(path)

    def _forget_old(self, has_ended: Callable[[str], bool]) -> None:
        """Report for which files fewer units run with the code from before."""
        with self._old_lock:
            for file, units in [*self._old.items()]:
                left = tuple(unit for unit in units if not has_ended(unit))
                if left != units:
                    self._note_old(file, left)

    def _note_old(self, file: str, units: tuple[str, ...]) -> None:
        """Report which units run with the code from before, if any do or did."""
        with self._old_lock:
            before = self._old.pop(file, ())
            if units:
                self._old[file] = units
            if units or before:
                self._tell_old(file, units)
