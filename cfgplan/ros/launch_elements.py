"""Elements common to launch files of ROS 1 and ROS 2: conditions, words, faults with places."""

from __future__ import annotations

import shlex
from pathlib import Path

from cfgplan.errors import Fault, InputError
from cfgplan.formats.xml_elements import XmlElement

TRUE, FALSE = ("true", "1"), ("false", "0")
MOST_INCLUDES = 50
"""Files that include each other deeper are refused: they form a circle."""


def launch_fault(file: Path, element: XmlElement, message: str, mend: str) -> InputError:
    """A fault at the place of an element."""
    return InputError([Fault(message, str(file), element.line, element.column, mend=mend)])


def is_met(file: Path, element: XmlElement, condition: str, value: str | None) -> bool:
    """Whether an element counts, by the value of its `if` or `unless`; None: it has neither. Raises InputError."""
    if value is None:
        return True
    said = value.strip().lower()
    if said not in (*TRUE, *FALSE):
        raise launch_fault(file, element, f"`{condition}` is `{value}`", "make it true or false")
    return said in (TRUE if condition == "if" else FALSE)


def given(file: Path, element: XmlElement, attribute: str, value: str | None) -> str:
    """The value of an attribute that an element must have. Raises InputError if it is None."""
    if value is None:
        raise launch_fault(file, element, f"<{element.name}> has no `{attribute}`", "add it")
    return value


def words(file: Path, element: XmlElement, attribute: str, value: str | None) -> list[str]:
    """The words of an attribute's value, split as a shell does. Raises InputError."""
    try:
        return shlex.split(value or "")
    except ValueError as error:
        raise launch_fault(file, element, f"{attribute}: {error}", "close what is quoted") from None


def declared(file: Path, element: XmlElement, name: str, default: str | None) -> str:
    """Return the default of an argument that was not passed. Raises InputError if it has none."""
    if default is None:
        mend = f"pass it: write {name}:=VALUE behind the file"
        raise launch_fault(file, element, f"the argument `{name}` has no value", mend)
    return default


def included(file: Path, element: XmlElement, path: Path, depth: int) -> Path:
    """The file that an element includes. Raises InputError if it is not there, or if the includes go in a circle."""
    if depth >= MOST_INCLUDES:
        message = f"files are included more than {MOST_INCLUDES} deep"
        raise launch_fault(file, element, message, "break the circle of includes")
    if not path.is_file():
        raise launch_fault(file, element, f"the file {path} is not there", "mend its name")
    return path


class NodePlaces:
    """Where each node of a launch file stands: a name stands for one node."""

    def __init__(self) -> None:
        self._places: dict[str, str] = {}

    def note(self, file: Path, element: XmlElement, name: str) -> None:
        """Note that an element starts the node of this full name. Raises InputError if another element does."""
        if name in self._places:
            mend = "give one of them another name, or a namespace: two nodes of one name can't run together"
            raise launch_fault(file, element, f"{self._places[name]} starts a node {name} too", mend)
        self._places[name] = f"{file}:{element.line}"
