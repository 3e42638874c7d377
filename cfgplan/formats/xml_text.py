"""The paper's XML specifications (Listings 1 and 2) as plain data in the environment file's form.

Fields that the paper's XML lacks are attributes if they are a text, a number or a flag; the others are the elements
run, unit, ontology, prefer, include, and the root environment.
"""

from __future__ import annotations

from collections.abc import Iterator
from decimal import Decimal
from typing import Any

from cfgplan.canonical import normal
from cfgplan.errors import Fault, InputError, did_you_mean
from cfgplan.formats import fields
from cfgplan.formats.json_text import read_json
from cfgplan.formats.places import Path, Source, Spot
from cfgplan.formats.scalars import resolve
from cfgplan.formats.xml_elements import XmlElement, parse_xml

_PARTS: dict[str, type[fields.Part]] = {
    "transformation": fields.TransformationPart,
    "run": fields.RunPart,
    "target": fields.TargetPart,
    "unit": fields.UnitPart,
    "defaults": fields.DefaultsPart,
}
_PORT_PARTS: dict[str, type[fields.Part]] = {"in": fields.InputPart, "out": fields.OutputPart}
_ATTRIBUTES: dict[str, tuple[str, ...]] = {
    **{name: tuple(part.attributes()) for name, part in _PARTS.items()},
    "param": ("name", "type"),
    "port": ("type", *(name for part in _PORT_PARTS.values() for name in part.attributes())),
    "tag": ("port",),
    "input": ("port", "stream"),
    "topic": ("port",),
}
_CHILDREN = {
    "transformation": ("label", "source", "run", "params", "ports", "tags"),
    "target": ("label", "topic", "tag"),
    "unit": ("input", "topic"),
    "params": ("param",),
    "ports": ("port",),
    "tags": ("tag",),
}
_PARAM_TYPES = {"int": (int,), "double": (int, Decimal), "bool": (bool,), "null": (type(None),)}
_SEVERAL = ("param", "port", "tag", "input", "topic")
_ROOT_CHILDREN = ("ontology", "prefer", "include", "defaults", "transformation", "unit", "target")


def read_xml(content: bytes, file: str) -> Source:
    """Read a transformation, a target, or a root element with any number of them; raises InputError."""
    reading = _XmlReading(file)
    data = reading.environment(parse_xml(content, file))
    return Source(file, data, reading.locate, tuple(reading.faults))


class _XmlReading:
    """One walk over the elements of a file."""

    def __init__(self, file: str) -> None:
        self.file = file
        self.faults: list[Fault] = []
        self._spots: dict[Path, tuple[XmlElement, bool]] = {}

    def locate(self, path: Path, _at_key: bool) -> Spot:
        """The spot of a path or of the nearest one above it."""
        while path and path not in self._spots:
            path = path[:-1]
        if path not in self._spots:
            return Spot(1, 1)
        element, is_text = self._spots[path]
        return element.text_spot if is_text else element.spot

    def environment(self, root: XmlElement) -> dict[str, Any]:
        data: dict[str, Any] = {"format": fields.FORMAT}
        self._spots[()] = (root, False)
        if root.name in ("transformation", "target", "unit"):
            root = XmlElement("environment", {}, root.line, root.column, [root])
        self._check(root, tuple(fields.EnvironmentPart.attributes()), _ROOT_CHILDREN, several=_ROOT_CHILDREN)
        if not root.children and not root.attributes:
            self._note(root, f"<{root.name}> has no specification in it", "write a <transformation> or a <target>")
        data |= self._attributes(root, (), fields.EnvironmentPart)
        for child in root.children:
            if child.name in ("ontology", "prefer", "include"):
                entries = data.setdefault(child.name, [])
                entries.append(self._text(child, (child.name, len(entries))))
            elif child.name == "defaults":
                self._check(child, _ATTRIBUTES["defaults"], ())
                data["defaults"] = self._attributes(child, ("defaults",), fields.DefaultsPart)
            elif child.name in ("transformation", "unit", "target"):
                parts = data.setdefault(f"{child.name}s", [])
                path = (f"{child.name}s", len(parts))
                self._spots[path] = (child, False)
                self._check(child, _ATTRIBUTES[child.name], _CHILDREN[child.name])
                parts.append(getattr(self, f"_{child.name}")(child, path))
        return data

    def _transformation(self, element: XmlElement, path: Path) -> dict[str, Any]:
        part = self._texts(element, path, ("label", "source"))
        part |= self._attributes(element, path, fields.TransformationPart)
        for run in element.children:
            if run.name == "run":
                self._check(run, _ATTRIBUTES["run"], ())
                part["run"] = self._attributes(run, (*path, "run"), fields.RunPart)
        params = {}
        for param in self._inside(element, "params", "param"):
            name = self._required(param, "name")
            if name is not None:
                if name in params:
                    self._note(param, f"the param `{name}` occurs twice", "remove one of the two")
                params[name] = self._param(param)
                self._spots[*path, "params", name] = (param, True)
        if params:
            part["params"] = params
        return part | self._ports(element, path)

    def _ports(self, element: XmlElement, path: Path) -> dict[str, Any]:
        tags: dict[str | None, XmlElement] = {}
        for tag in self._inside(element, "tags", "tag"):
            tagged = self._required(tag, "port")
            if tagged in tags:
                self._note(tag, f"the port `{tagged}` has two tags", "remove one, or join them by `and`")
            tags[tagged] = tag
        ports: dict[str, dict[str, Any]] = {"inputs": {}, "outputs": {}}
        for port in self._inside(element, "ports", "port"):
            direction = port.attributes.get("type")
            if direction not in ("in", "out"):
                self._note(port, f"the port `{port.text}` has no direction", 'write type="in" or type="out"')
                continue
            key = f"{direction}puts"
            name = normal(port.text)
            if name in ports[key]:
                self._note(port, f"the port `{name}` occurs twice", "remove one of the two or rename it")
            written = self._port(port, (*path, key, name), tags.pop(name, None))
            if written is not None:
                ports[key][name] = written
        known = [normal(port.text) for port in self._inside(element, "ports", "port")]
        for tagged, tag in tags.items():
            if tagged is not None:
                mend = did_you_mean(tagged, known, "add it to <ports>")
                self._note(tag, f"the tag is for the port `{tagged}`, but there is no such port", mend)
        return {key: value for key, value in ports.items() if value}

    def _port(self, port: XmlElement, path: Path, tag: XmlElement | None) -> object:
        self._spots[path] = (port, False)
        direction = port.attributes["type"]
        for name in _PORT_PARTS["in" if direction == "out" else "out"].attributes():
            if name in port.attributes:
                self._note(port, f"an {direction}put has no `{name}`", f"remove the attribute {name}")
        more = self._attributes(port, path, _PORT_PARTS[direction])
        if tag is None:
            self._note(port, f"the port `{port.text}` has no tag", f'add <tag port="{port.text}"> to <tags>')
            return None
        if more:
            return {"tag": self._text(tag, (*path, "tag")), **more}
        return self._text(tag, path)

    def _param(self, param: XmlElement) -> object:
        kind = param.attributes.get("type", "string")
        text = param.text
        if kind == "string":
            return text
        if kind == "json":
            try:
                return read_json(text, self.file).data
            except InputError as error:
                self._note(param, error.faults[0].message, 'write JSON, or type="string"')
                return None
        value = resolve(text)
        if kind not in _PARAM_TYPES:
            known = [*_PARAM_TYPES, "string", "json"]
            mend = did_you_mean(kind, known, f"the types are {', '.join(known)}")
            self._note(param, f"unknown param type `{kind}`", mend)
        elif type(value) not in _PARAM_TYPES[kind]:
            self._note(param, f"{text!r} is not of type {kind}", 'mend the value, or write type="string"')
        return Decimal(value) if kind == "double" and type(value) is int else value

    def _unit(self, element: XmlElement, path: Path) -> dict[str, Any]:
        part: dict[str, Any] = self._attributes(element, path, fields.UnitPart)
        for child in element.children:
            port = self._required(child, "port")
            if port is None or child.name not in ("input", "topic"):
                continue
            if child.name == "input":
                self._unit_input(child, part.setdefault("inputs", {}), port, (*path, "inputs", port))
            else:
                topics = part.setdefault("topics", {}).setdefault(port, [])
                self._spots.setdefault((*path, "topics", port), (child, False))
                topics.append(self._text(child, (*path, "topics", port, len(topics))))
        return part

    def _unit_input(self, child: XmlElement, inputs: dict[str, Any], port: str, path: Path) -> None:
        """Another element of the same port is another stream of it."""
        said = child.attributes.get("stream")
        if port not in inputs:
            inputs[port] = said
            self._spots[path] = self._spots[*path, 0] = (child, False)
        else:
            before = inputs[port]
            inputs[port] = [*(before if isinstance(before, list) else [before]), said]
            self._spots[*path, len(inputs[port]) - 1] = (child, False)

    def _target(self, element: XmlElement, path: Path) -> dict[str, Any]:
        part = self._texts(element, path, ("label", "topic", "tag"))
        return part | self._attributes(element, path, fields.TargetPart)

    # --- what all elements have in common ---

    def _check(
        self,
        element: XmlElement,
        attributes: tuple[str, ...],
        children: tuple[str, ...],
        several: tuple[str, ...] = _SEVERAL,
    ) -> None:
        for name in element.attributes:
            if name not in attributes and name != "xml:space":
                hint = f"its attributes are {', '.join(attributes)}" if attributes else "remove it"
                mend = did_you_mean(name, attributes, hint)
                self._note(element, f"<{element.name}> has the unknown attribute `{name}`", mend)
        seen = set()
        for child in element.children:
            if child.name not in children:
                hint = f"in it may be {', '.join(f'<{name}>' for name in children)}" if children else "remove it"
                mend = did_you_mean(child.name, children, hint)
                self._note(child, f"unknown element <{child.name}> in <{element.name}>", mend)
            elif child.name in seen and child.name not in several:
                self._note(child, f"<{child.name}> occurs twice", "remove one of the two")
            elif child.name in several and element.name in _CHILDREN:
                self._check(child, _ATTRIBUTES[child.name], ())
            seen.add(child.name)
        if element.children and element.text:
            self._note(element, f"there is stray text in <{element.name}>: {element.text[:40]!r}", "remove it")

    def _inside(self, element: XmlElement, holder: str, name: str) -> Iterator[XmlElement]:
        for child in element.children:
            if child.name == holder:
                self._check(child, (), (name,))
                yield from (entry for entry in child.children if entry.name == name)

    def _attributes(self, element: XmlElement, path: Path, part: type[fields.Part]) -> dict[str, Any]:
        found: dict[str, Any] = {}
        for name, key in part.attributes().items():
            if name in element.attributes:
                text = element.attributes[name]
                found[key] = text if part.rows()[key].is_text else resolve(text)
                self._spots[*path, key] = (element, False)
        return found

    def _texts(self, element: XmlElement, path: Path, names: tuple[str, ...]) -> dict[str, Any]:
        return {child.name: self._text(child, (*path, child.name)) for child in element.children if child.name in names}

    def _text(self, element: XmlElement, path: Path) -> str:
        self._check(element, ("port",) if element.name in ("tag", "topic") else (), ())
        self._spots[path] = (element, True)
        return element.text

    def _required(self, element: XmlElement, name: str) -> str | None:
        if name not in element.attributes:
            self._note(element, f"<{element.name}> has no attribute `{name}`", f'add {name}="..."')
        return element.attributes.get(name)

    def _note(self, element: XmlElement, message: str, mend: str | None) -> None:
        self.faults.append(Fault(message, self.file, element.line, element.column, mend=mend))
