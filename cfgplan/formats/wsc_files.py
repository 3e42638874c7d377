"""Reading a set of the Web Service Challenge 2008: a taxonomy, services over its instances, and a problem."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from cfgplan.errors import Fault, InputError
from cfgplan.formats.files import read_bytes
from cfgplan.formats.xml_elements import SafeParser


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
    parent, concept = _taxonomy(folder / "taxonomy.xml")
    faults: list[Fault] = []
    services = _services(folder / "services.xml", concept, faults)
    provided, wanted = _problem(folder / "problem.xml", concept, faults)
    if faults:
        raise InputError(faults)
    return TestSet(parent, concept, services, provided, wanted)


def _taxonomy(path: Path) -> tuple[dict[str, str | None], dict[str, str]]:
    parent: dict[str, str | None] = {}
    concept: dict[str, str] = {}
    above: list[str] = []

    def start(name: str, attributes: dict[str, str]) -> None:
        if name == "concept":
            own = _name(parser, name, attributes)
            if own in parent:
                parser.stop(f"the concept {own} stands at two places", "the taxonomy must be a tree")
            parent[own] = above[-1] if above else None
            above.append(own)
        elif name == "instance":
            own = _name(parser, name, attributes)
            if not above or own in concept:
                where = "two concepts" if above else "no concept"
                parser.stop(f"the instance {own} is in {where}", "put it into one")
            concept[own] = above[-1]
        elif name != "taxonomy":
            parser.stop(f"unknown element <{name}>", "a taxonomy has concepts and instances")

    def end(name: str) -> None:
        if name == "concept":
            above.pop()

    parser = SafeParser(str(path), start, end)
    parser.parse(read_bytes(path))
    return parent, concept


def _services(path: Path, concept: Mapping[str, str], faults: list[Fault]) -> tuple[Service, ...]:
    services: list[Service] = []
    names: set[str] = set()
    ports: dict[str, dict[str, None]] = {}
    side = ""
    current = ""

    def start(name: str, attributes: dict[str, str]) -> None:
        nonlocal side, current
        if name == "instance" and side:
            _note_unknown(parser, str(path), attributes, concept, faults)
            ports[side][_name(parser, name, attributes)] = None
        elif name in ("inputs", "outputs") and current:
            side = name
        elif name == "service":
            current = _name(parser, name, attributes)
            ports.update(inputs={}, outputs={})
            if current in names:
                parser.stop(f"the service {current} is there twice", "give each service a name of its own")
            names.add(current)
        elif name != "services":
            parser.stop(f"unknown element <{name}> here", "a service has inputs and outputs, and they have instances")

    def end(name: str) -> None:
        nonlocal side, current
        if name in ("inputs", "outputs"):
            side = ""
        elif name == "service":
            services.append(Service(current, tuple(ports["inputs"]), tuple(ports["outputs"])))
            current = ""

    parser = SafeParser(str(path), start, end)
    parser.parse(read_bytes(path))
    return tuple(services)


def _problem(path: Path, concept: Mapping[str, str], faults: list[Fault]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    found: dict[str, dict[str, None]] = {}
    side = ""

    def start(name: str, attributes: dict[str, str]) -> None:
        nonlocal side
        if name in ("provided", "wanted"):
            if name in found:
                parser.stop(f"<{name}> is there twice", "a set has one problem")
            side = name
            found[side] = {}
        elif name == "instance" and side:
            _note_unknown(parser, str(path), attributes, concept, faults)
            found[side][_name(parser, name, attributes)] = None

    def end(name: str) -> None:
        nonlocal side
        if name == side:
            side = ""

    parser = SafeParser(str(path), start, end)
    parser.parse(read_bytes(path))
    faults.extend(
        Fault(f"<{missing}> is missing", str(path), mend="this is not the problem of a set")
        for missing in ("provided", "wanted")
        if missing not in found
    )
    return tuple(found.get("provided", ())), tuple(found.get("wanted", ()))


def _name(parser: SafeParser, element: str, attributes: Mapping[str, str]) -> str:
    name = attributes.get("name")
    if not name:
        parser.stop(f"<{element}> has no name", 'add name="..."')
    return name


def _note_unknown(
    parser: SafeParser, file: str, attributes: Mapping[str, str], concept: Mapping[str, str], faults: list[Fault]
) -> None:
    name = attributes.get("name", "")
    if name and name not in concept:
        line, column = parser.place
        faults.append(Fault(f"the instance {name} is not in the taxonomy", file, line, column, mend="add it there"))
