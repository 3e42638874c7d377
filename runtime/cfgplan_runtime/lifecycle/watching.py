"""Changes a running system when its environment file is edited."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from cfgplan import api
from cfgplan.api import World
from cfgplan.errors import Fault, InputError
from cfgplan.formats.document import Document, read_document
from cfgplan_runtime.lifecycle.changes import ReplaceWorld
from cfgplan_runtime.lifecycle.file_watch import FileWatch
from cfgplan_runtime.lifecycle.manager import Manager


@contextmanager
def watch_file(path: str | Path, manager: Manager) -> Iterator[None]:
    """Watch an environment file, its includes and its ontologies, and give the manager each new world.

    If they can't be used, the faults are reported and the world before holds.
    """
    watching = Watching(Path(path), lambda world, by: manager.request(ReplaceWorld(world, by)), manager.refuse)
    watching.start()
    try:
        yield
    finally:
        watching.close()


class Watching(FileWatch):
    """Reads an environment file at the start, and whenever one of its files has changed since.

    `give` gets each new world, `refuse` the faults of one that can't be used, both with the file's name.
    """

    def __init__(
        self, path: Path, give: Callable[[World, str], object], refuse: Callable[[str, tuple[Fault, ...]], object]
    ) -> None:
        super().__init__(lambda: self._files, lambda _: self._read())
        self._path = path
        self._give = give
        self._refuse = refuse
        self._files = frozenset({path})

    def _read(self) -> None:
        found = {self._path}
        try:
            document = read_document(self._path)
            found |= _files_of(document)
            ontology = api.ontology_of(document)
            found |= set(ontology.files)
            world = api.world_of(document, ontology)
        except InputError as error:
            self._files |= found
            self.take_in_new_ones()
            self._refuse(str(self._path), error.faults)
        else:
            self._files = frozenset(found)
            self.take_in_new_ones()
            self._give(world, str(self._path))


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
