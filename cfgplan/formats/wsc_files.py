"""Reading a set of the Web Service Challenge 2008: a taxonomy, services over its instances, and a problem."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

from cfgplan.errors import Fault, InputError
from cfgplan.formats.files import read_bytes
from cfgplan.formats.xml_elements import XmlElement, parse_xml


@dataclass(frozen=True)
class Service:
    """A service: the instances that it needs and the instances that it makes."""

    name: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]


@dataclass(frozen=True)
class TestSet:
    """A set of the challenge.

    `parent` maps each concept to the one above it (None at the top), `concept` each instance to its concept. An
    instance may be used where one of its concept, or of a concept above, is needed.
    """

    __test__ = False

    parent: Mapping[str, str | None]
    concept: Mapping[str, str]
    services: tuple[Service, ...]
    provided: tuple[str, ...]
    wanted: tuple[str, ...]

    def above(self, concept: str) -> tuple[str, ...]:
        """A concept and all above it, from the bottom up."""
        line = [concept]
        while (higher := self.parent[line[-1]]) is not None:
            line.append(higher)
        return tuple(line)


def read_test_set(folder: Path) -> TestSet:
    """The set in a folder with taxonomy.xml, services.xml and problem.xml; raises InputError."""
    parent, concept = _taxonomy(_SetFile(folder / "taxonomy.xml"))
    services, problem = _SetFile(folder / "services.xml", concept), _SetFile(folder / "problem.xml", concept)
    found = tuple(_services(services))
    provided, wanted = (_side(problem, name) for name in ("provided", "wanted"))
    if faults := [*services.faults, *problem.faults]:
        raise InputError(faults)
    return TestSet(parent, concept, found, provided, wanted)


def unread(folder: Path) -> tuple[str, ...]:
    """Return the unused parts of a set: attributes of services, such as their quality, and other files beside it."""
    services = _SetFile(folder / "services.xml").root.children
    attributes = {name for service in services for name in service.attributes} - {"name"}
    files = {path.name for path in folder.iterdir() if path.suffix.lower() in (".owl", ".wsla", ".wsdl", ".bpel")}
    return (*(f"the attribute {name} of services" for name in sorted(attributes)), *sorted(files))


class _SetFile:
    """One file of a set. `faults` are its instances that are not in `concept`, and missing elements."""

    def __init__(self, path: Path, concept: Collection[str] = ()) -> None:
        self.file = str(path)
        self.root = parse_xml(read_bytes(path), self.file)
        self.faults: list[Fault] = []
        self._concept = concept

    def stop(self, element: XmlElement, message: str, mend: str) -> NoReturn:
        raise InputError([self._fault(element, message, mend)])

    def name(self, element: XmlElement) -> str:
        """The name of an element. Raises InputError if it has no name."""
        return element.attributes.get("name") or self.stop(element, f"<{element.name}> has no name", 'add name="..."')

    def instances(self, element: XmlElement) -> tuple[str, ...]:
        """The instances in an element, each once."""
        found: dict[str, None] = {}
        for each in element:
            if each.name == "instance" and (name := self.name(each)) not in found:
                found[name] = None
                if name not in self._concept:
                    message = f"the instance {name} is not in the taxonomy"
                    self.faults.append(self._fault(each, message, "add it there"))
        return tuple(found)

    def _fault(self, element: XmlElement, message: str, mend: str) -> Fault:
        return Fault(message, self.file, element.line, element.column, mend=mend)


def _taxonomy(file: _SetFile) -> tuple[dict[str, str | None], dict[str, str]]:
    parent: dict[str, str | None] = {}
    concept: dict[str, str] = {}

    def add(element: XmlElement, above: str | None) -> None:
        if element.name == "concept":
            own = file.name(element)
            if own in parent:
                file.stop(element, f"the concept {own} stands at two places", "the taxonomy must be a tree")
            parent[own] = above
            above = own
        elif element.name == "instance":
            own = file.name(element)
            if above is None or own in concept:
                where = "no concept" if above is None else "two concepts"
                file.stop(element, f"the instance {own} is in {where}", "put it into one")
            concept[own] = above
        elif element.name != "taxonomy":
            file.stop(element, f"unknown element <{element.name}>", "a taxonomy has concepts and instances")
        for child in element.children:
            add(child, above)

    add(file.root, None)
    return parent, concept


_LEVELS = (("services",), ("service",), ("inputs", "outputs"), ("instance",))


def _services(file: _SetFile) -> Iterator[Service]:
    _check_levels(file, file.root, 0)
    names: set[str] = set()
    for service in file.root.children:
        name = file.name(service)
        if name in names:
            file.stop(service, f"the service {name} occurs twice", "give each service a name of its own")
        names.add(name)
        sides = {side.name: file.instances(side) for side in service.children}
        yield Service(name, sides.get("inputs", ()), sides.get("outputs", ()))


def _check_levels(file: _SetFile, element: XmlElement, level: int) -> None:
    if element.name not in _LEVELS[min(level, 3)]:
        message = f"unknown element <{element.name}> here"
        file.stop(element, message, "a service has inputs and outputs, and they have instances")
    for child in element.children:
        _check_levels(file, child, level + 1)


def _side(file: _SetFile, name: str) -> tuple[str, ...]:
    """The instances that a problem provides, or wants."""
    found = [element for element in file.root if element.name == name]
    if not found:
        file.faults.append(Fault(f"<{name}> is missing", file.file, mend="this is not the problem of a set"))
        return ()
    for second in found[1:]:
        file.stop(second, f"<{name}> occurs twice", "a set has one problem")
    return file.instances(found[0])
