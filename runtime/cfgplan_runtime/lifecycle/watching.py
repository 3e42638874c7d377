"""The environment file as the way to change a running system: whoever edits it, a manager is told."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from cfgplan import api
from cfgplan.api import World
from cfgplan.errors import Fault, InputError
from cfgplan.formats import Document, read_document
from cfgplan_runtime.lifecycle.changes import ReplaceWorld
from cfgplan_runtime.lifecycle.manager import Manager

QUIET_S = 0.05
"""So long must nothing change before the files are read."""
LOOK_MS = 1000
"""So often the files are looked at in any case, for file systems that don't tell of changes."""

Stamps = dict[Path, tuple[int, int, int] | None]


@contextmanager
def watch_file(path: str | Path, manager: Manager) -> Iterator[None]:
    """Watch an environment file, what it includes and its ontologies, and have the manager take in what they say.

    A state that can't be used is reported with its faults, and what was before holds.
    """
    watching = Watching(Path(path), lambda world, by: manager.request(ReplaceWorld(world, by)), manager.refuse)
    watching.start()
    try:
        yield
    finally:
        watching.close()


class Watching:
    """A thread that reads an environment file at its start, and whenever one of its files has changed since.

    Folders are watched, since editors write a new file and rename it. `give` gets each new world, `refuse` the
    faults of one that can't be used, both with the file's name.
    """

    def __init__(
        self, path: Path, give: Callable[[World, str], object], refuse: Callable[[str, tuple[Fault, ...]], object]
    ) -> None:
        self._path = path
        self._give = give
        self._refuse = refuse
        self._paths: frozenset[Path] = frozenset({path})
        self._stamps: Stamps = {}
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._work, name="cfgplan-watching", daemon=True)

    def start(self) -> None:
        """Begin to watch."""
        self._thread.start()

    def close(self) -> None:
        """End."""
        self._stop.set()
        self._thread.join()

    def _work(self) -> None:
        self._read()
        while not self._stop.is_set():
            try:
                self._watch(_folders(self._paths))
            except (OSError, RuntimeError):  # a folder has vanished, or the system watches no more of them
                self._stop.wait(LOOK_MS / 1000)
                self._look()

    def _watch(self, folders: list[Path]) -> None:
        """Look whenever something changes in these folders, and from time to time, as long as they are the ones."""
        from watchfiles import watch

        for _ in watch(
            *folders,
            watch_filter=None,
            step=20,
            rust_timeout=LOOK_MS,
            yield_on_timeout=True,
            recursive=False,
            raise_interrupt=False,
            ignore_permission_denied=True,
            stop_event=self._stop,
        ):
            self._look()
            if _folders(self._paths) != folders:
                return

    def _look(self) -> None:
        if self._stamps != _stamps(self._paths):
            self._await_quiet()
            self._read()

    def _await_quiet(self) -> None:
        before, now = None, _stamps(self._paths)
        while now != before and not self._stop.wait(QUIET_S):
            before, now = now, _stamps(self._paths)

    def _read(self) -> None:
        self._stamps = _stamps(self._paths)
        found = {self._path}
        try:
            document = read_document(self._path)
            found |= _files_of(document)
            ontology = api.ontology_of(document)
            found |= set(ontology.files)
            world = api.world_of(document, ontology)
        except InputError as error:
            self._know(self._paths | found)
            self._refuse(str(self._path), error.faults)
        else:
            self._know(frozenset(found))
            self._give(world, str(self._path))

    def _know(self, paths: frozenset[Path]) -> None:
        """Files that are new to us are as they were when they were read, or a little later: then once more."""
        self._stamps = {**_stamps(paths), **{path: self._stamps[path] for path in paths & self._stamps.keys()}}
        self._paths = paths


def _files_of(document: Document) -> set[Path]:
    """Every file and folder that a document was read from, and its ontologies."""
    main = document.path
    found = {main, *document.ontology_paths}
    for file in document.files:
        data = file.source.data
        names = data.get("include") if isinstance(data, dict) else None
        if isinstance(names, list):
            found |= {main.parent / name for name in names if isinstance(name, str)}
    return found.union(*map(_files_in, found))


def _files_in(path: Path) -> set[Path]:
    try:
        return {member for member in path.iterdir() if member.is_file()}
    except OSError:  # a file, or gone
        return set()


def _folders(paths: Iterable[Path]) -> list[Path]:
    """The folders of files, and the folders among them; those that are there."""
    folders = {path if path.is_dir() else path.parent for path in paths}
    return sorted(folder for folder in folders if folder.is_dir()) or [Path()]


def _stamps(paths: Iterable[Path]) -> Stamps:
    return {path: _stamp(path) for path in paths}


def _stamp(path: Path) -> tuple[int, int, int] | None:
    """What changes when a file is written or replaced, or an entry of a folder comes or goes; None if it is missing."""
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_mtime_ns, found.st_size, found.st_ino
