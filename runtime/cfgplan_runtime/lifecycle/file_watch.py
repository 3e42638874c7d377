"""A thread that watches files for changes, and one that changes a running system when its file is edited."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from cfgplan import api
from cfgplan.api import World
from cfgplan.errors import Fault, InputError
from cfgplan.formats.document import Document, read_document
from cfgplan_runtime.lifecycle.changes import ReplaceWorld
from cfgplan_runtime.lifecycle.manager import Manager

_STEP_MS = 100
"""The thread wakes this often to see whether the system has told of a change."""
QUIET_S = 0.05
"""A change is reported after this many seconds without another one."""
LOOK_MS = 1000
"""The files are looked at this often in any case, for file systems that don't tell of changes."""

SLOW_S = 10.0
"""The seconds after which a file that is still being read is reported."""
_CLOSE_S = 2.0
"""Seconds that the thread may take to end: one that waits for a file is left behind."""
LOG = logging.getLogger("cfgplan")

Stamps = dict[Path, tuple[int, int, int] | None]


class FileWatch:
    """A thread that reports changed, new and deleted files and folders.

    It calls `tell` in its thread: at its start with an empty set, then with the changed paths. It calls `paths` at
    every check; a file that joins is watched from then on. Folders are watched, since editors write a new file and
    rename it.
    """

    def __init__(self, paths: Callable[[], Iterable[Path]], tell: Callable[[frozenset[Path]], object]) -> None:
        self._paths = paths
        self._tell = tell
        self._stamps: Stamps = {}
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._work, name="cfgplan-watching", daemon=True)

    def start(self) -> None:
        """Begin to watch: changes from now on are reported."""
        self._stamps = _stamps(self._paths())
        self._thread.start()

    def close(self) -> None:
        """Stop watching, and wait for the thread's end, unless a file keeps it waiting."""
        self._stop.set()
        self._thread.join(_CLOSE_S)

    def _work(self) -> None:
        self._told(frozenset())
        while not self._stop.is_set():
            try:
                self._watch(_folders(self._stamps))
            except (OSError, RuntimeError):  # a folder has vanished, or the system watches no more of them
                self._stop.wait(LOOK_MS / 1000)
                self._look()

    def _told(self, changed: frozenset[Path]) -> None:
        self._guarded(lambda: self._tell(changed))
        self._guarded(self.take_in_new_ones)

    def _guarded(self, call: Callable[[], object]) -> None:
        """Call code of others: its exceptions are logged, and end no watch."""
        try:
            call()
        except Exception:
            LOG.exception("a change could not be applied; files are still watched")

    def _watch(self, folders: list[Path]) -> None:
        """Look at each change in `folders`, and every LOOK_MS, until the set of folders changes."""
        from watchfiles import watch

        for _ in watch(
            *folders,
            watch_filter=None,
            step=_STEP_MS,
            rust_timeout=LOOK_MS,
            yield_on_timeout=True,
            recursive=False,
            raise_interrupt=False,
            ignore_permission_denied=True,
            stop_event=self._stop,
        ):
            self._look()
            if _folders(self._stamps) != folders:
                return

    def _look(self) -> None:
        if self._stamps == _stamps(self._stamps):
            self._guarded(self.take_in_new_ones)
            return
        before, now = None, _stamps(self._stamps)
        while now != before and not self._stop.wait(QUIET_S):
            before, now = now, _stamps(self._stamps)
        changed = frozenset(path for path in now if now[path] != self._stamps[path])
        self._stamps = now  # as they were before `tell` reads them: what changes meanwhile is noticed
        self._told(changed)

    def take_in_new_ones(self) -> None:
        """Update the watched paths. A `tell` that finds new paths calls this before it uses the content that it has
        read.
        """
        paths = set(self._paths())
        self._stamps = {path: self._stamps[path] if path in self._stamps else _stamp(path) for path in paths}


def _folders(paths: Iterable[Path]) -> list[Path]:
    """The existing folders to watch: the folders among `paths`, and the parents of the files."""
    folders = {path if path.is_dir() else path.parent for path in paths}
    return sorted(folder for folder in folders if folder.is_dir()) or [Path()]


def _stamps(paths: Iterable[Path]) -> Stamps:
    return {path: _stamp(path) for path in paths}


def _stamp(path: Path) -> tuple[int, int, int] | None:
    """A value that changes when a file is written or replaced, or a folder's entries change; None if it is missing."""
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_mtime_ns, found.st_size, found.st_ino


@contextmanager
def watch_file(path: str | Path, manager: Manager, *, use_cache: bool = True) -> Iterator[None]:
    """Watch the environment file at `path`, its includes and its ontologies, and give `manager` each new world.

    If they have an error, the faults are reported and the last valid world holds. `use_cache` is that of
    `cfgplan.load`.
    """

    def give(world: World, by: str) -> None:
        manager.request(ReplaceWorld(world, by))

    watching = WorldWatch(Path(path), give, manager.refuse, use_cache=use_cache)
    watching.start()
    try:
        yield
    finally:
        watching.close()


class WorldWatch(FileWatch):
    """Reads an environment file at the start, and whenever one of its files has changed since.

    `give` gets each new world, `refuse` the faults of one that can't be used, both with the file's name. With
    `use_cache`, it is read as by `cfgplan.load`: ontologies that have not changed are not parsed again.
    """

    def __init__(
        self,
        path: Path,
        give: Callable[[World, str], object],
        refuse: Callable[[str, tuple[Fault, ...]], object],
        *,
        use_cache: bool = True,
    ) -> None:
        super().__init__(lambda: self._files, lambda _: self._read())
        self._path = path
        self._give = give
        self._refuse = refuse
        self._use_cache = use_cache
        self._files = frozenset({path})

    def _read(self) -> None:
        found = {self._path}
        late = threading.Timer(SLOW_S, self._tell_of_wait)
        late.daemon = True
        late.start()
        try:
            document = read_document(self._path)
            found |= _files_of(document)
            ontology = api.ontology_of(document, use_cache=self._use_cache)
            found |= set(ontology.files)
            world = api.world_of(document, ontology, use_cache=self._use_cache)
        except InputError as error:
            late.cancel()
            self._files |= found
            self.take_in_new_ones()
            self._refuse(str(self._path), error.faults)
        except Exception as error:
            late.cancel()
            self._refuse(str(self._path), (Fault(f"can't be read: {type(error).__name__}: {error}"),))
            raise
        else:
            late.cancel()
            self._files = frozenset(found)
            self.take_in_new_ones()
            self._give(world, str(self._path))

    def _tell_of_wait(self) -> None:
        what = f"it has not been read for {SLOW_S:g} s; the run keeps the last valid version"
        mend = "see whether one of its files is a pipe, or on a disk that does not answer"
        self._refuse(str(self._path), (Fault(what, str(self._path), mend=mend),))


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
