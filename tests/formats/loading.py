"""What the tests of the formats share: a small vocabulary, and loading from a text."""

from __future__ import annotations

from pathlib import Path

from cfgplan.errors import Fault, InputError, TagError, UnknownNameError
from cfgplan.formats.assembly import build
from cfgplan.formats.document import read_document
from cfgplan.formats.environment_file import EnvironmentFile

CLASSES = {"NAO": ("piff", "puff"), "Room": ("r1", "r2", "r3"), "Nothing": (), "Café": ("x",)}


class SmallVocabulary:
    """Three classes; a tag is bad if it has the name Bad in it."""

    def instances(self, class_name: str) -> tuple[str, ...]:
        if class_name not in CLASSES:
            raise UnknownNameError(f"no class {class_name}", "did you mean `NAO`?")
        return CLASSES[class_name]

    def check_tag(self, text: str) -> None:
        if "Bad" in text:
            raise TagError("unknown name Bad", text.index("Bad") + 1, "did you mean `Bed`?")


def load(path: Path) -> EnvironmentFile:
    """The world in a file."""
    return build(read_document(path), SmallVocabulary())


def load_text(folder: Path, text: str, name: str = "env.yaml") -> EnvironmentFile:
    """The world in a text, written into a folder."""
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return load(path)


def faults_of(folder: Path, text: str, name: str = "env.yaml") -> tuple[Fault, ...]:
    """The faults of a text that must not load."""
    try:
        world = load_text(folder, text, name)
    except InputError as error:
        return error.faults
    raise AssertionError(f"this should not load, but gives {world}")


def only_fault(folder: Path, text: str, name: str = "env.yaml") -> Fault:
    """The one fault of a text that must have just one."""
    faults = faults_of(folder, text, name)
    assert len(faults) == 1, faults
    return faults[0]


def place_of(fault: Fault) -> tuple[int | None, int | None]:
    """The line and the column of a fault."""
    return fault.line, fault.column
