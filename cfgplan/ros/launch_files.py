"""The nodes of a launch file of ROS 1 (XML), including the files that it includes.

Reference: roslaunch/XML of wiki.ros.org. A launch file names nodes, how they are started, their parameters and
remappings. It does not name their ports.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import yaml

from cfgplan.errors import InputError
from cfgplan.file_content import content_of
from cfgplan.formats.xml_elements import XmlElement, parse_xml
from cfgplan.ros.graph import RosGraph, RosNode, resolved
from cfgplan.ros.launch_elements import (
    FALSE,
    TRUE,
    NodePlaces,
    declared,
    given,
    included,
    is_met,
    launch_fault,
    words,
)
from cfgplan.ros.substitutions import PackageMissingError, SubstitutionError, Substitutions, valued
from cfgplan.summary import some

_NODELETS = "nodelet"
_LOCAL = ("localhost", "127.0.0.1", "::1")
"""Addresses of the computer that roslaunch itself runs on."""
_DROPPED: Mapping[str, str] = {
    "respawn": "a run replaces every unit that dies",
    "required": "a run goes on when the node dies, and replaces it",
    "launch-prefix": "the node is started without it",
}
"""Attributes of nodes that are not carried over, and what happens instead."""
_TYPES: Mapping[str, Callable[[str], object]] = {
    "auto": valued,
    "str": str,
    "string": str,
    "int": int,
    "double": float,
    "bool": lambda text: text.strip().lower() in TRUE,
    "boolean": lambda text: text.strip().lower() in TRUE,
    "yaml": yaml.safe_load,
}


def launch_graph(path: Path, arguments: Mapping[str, str] | None = None) -> RosGraph:
    """Return the nodes that a launch file starts with these arguments, without ports.

    Raises InputError with file and line. Includes from packages that are not installed are left out; a note says so.
    """
    walk = _Walk()
    passed = dict(arguments or {})
    # roslaunch knows what was passed to the first file, whether or not the file declares it.
    walk.file(path, _Scope(path, given=passed, arguments=passed))
    return walk.graph(path)


@dataclass(frozen=True)
class _Scope:
    """The settings at a place of a launch file.

    Names are resolved below `namespace`; remappings and private parameters hold for all following nodes. `given` are
    the arguments passed to the file, `arguments` those declared.
    """

    file: Path
    namespace: str = ""
    given: Mapping[str, str] = field(default_factory=dict)
    arguments: Mapping[str, str] = field(default_factory=dict)
    remaps: tuple[tuple[str, str], ...] = ()
    private: Mapping[str, object] = field(default_factory=dict)
    depth: int = 0

    def below(self, namespace: str | None) -> _Scope:
        if not namespace:
            return self
        return replace(self, namespace=resolved(namespace, self.namespace, ""))


class _Walk:
    """One reading of a launch file and all that it includes."""

    def __init__(self) -> None:
        self._nodes: list[RosNode] = []
        self._places = NodePlaces()
        self._machines: dict[str, str] = {}
        self._parameters: dict[str, object] = {}
        self._notes: list[str] = []
        self._dropped: list[str] = []

    def graph(self, path: Path) -> RosGraph:
        nodes = [replace(node, parameters={**self._own(node), **node.parameters}) for node in self._nodes]
        left = sorted(self._parameters)
        if left:
            self._notes.append(f"who reads the parameters that {path} sets outside nodes: {some(left, 3)}")
        return RosGraph(
            tuple(nodes),
            (f"the launch file {path}",),
            tuple(dict.fromkeys(self._notes)),
            tuple(self._dropped),
            dict(self._parameters),
        )

    def _own(self, node: RosNode) -> dict[str, object]:
        """The parameters that were set from outside where a node has its private ones."""
        begin = f"{node.name}/"
        return {
            name[len(begin) :]: self._parameters.pop(name) for name in [*self._parameters] if name.startswith(begin)
        }

    def file(self, path: Path, scope: _Scope) -> None:
        try:
            root = parse_xml(content_of(path), str(path))
        except OSError as error:
            mend = "name a launch file"
            raise InputError.of(f"can't be read: {error.strerror}", file=str(path), mend=mend) from None
        if root.name != "launch":
            mend = "launch files of ROS 1 are XML with <launch>; import a live graph of others"
            raise launch_fault(path, root, f"this is not a launch file of ROS 1: it begins with <{root.name}>", mend)
        self._inside(root, replace(scope, file=path))

    def _inside(self, parent: XmlElement, scope: _Scope) -> _Scope:
        for element in parent.children:
            if self._holds(element, scope):
                scope = self._element(element, scope)
        return scope

    def _element(self, element: XmlElement, scope: _Scope) -> _Scope:
        """Read an element; returns the settings after it."""
        match element.name:
            case "arg":
                return self._argument(element, scope)
            case "remap":
                pair = (self._needed(element, "from", scope), self._needed(element, "to", scope))
                return replace(scope, remaps=(*scope.remaps, pair))
            case "group":
                self._inside(element, scope.below(self._value(element, "ns", scope)))
            case "include":
                self._include(element, scope)
            case "node":
                self._node(element, scope)
            case "machine":
                name = self._needed(element, "name", scope)
                self._machines[name] = self._needed(element, "address", scope)
            case "test":
                self._dropped.append(f"the test at {scope.file}:{element.line}")
            case "param" | "rosparam":
                values = self._values(element, scope)
                private = {name[1:].lstrip("/"): value for name, value in values.items() if name.startswith("~")}
                shared = {name: value for name, value in values.items() if not name.startswith("~")}
                self._parameters |= {resolved(name, scope.namespace, ""): value for name, value in shared.items()}
                return replace(scope, private={**scope.private, **private})
        return scope

    def _argument(self, element: XmlElement, scope: _Scope) -> _Scope:
        name = self._needed(element, "name", scope)
        fixed, default = self._value(element, "value", scope), self._value(element, "default", scope)
        value = fixed if fixed is not None else scope.given.get(name)
        value = declared(scope.file, element, name, default) if value is None else value
        return replace(scope, arguments={**scope.arguments, name: value})

    def _include(self, element: XmlElement, scope: _Scope) -> None:
        try:
            path = Path(self._needed(element, "file", scope, missing=True))
        except PackageMissingError as error:
            self._notes.append(f"what {scope.file}:{element.line} includes, since {error}: see ROS_PACKAGE_PATH")
            return
        included(scope.file, element, path, scope.depth)
        passed = dict(scope.arguments) if self._value(element, "pass_all_args", scope) in TRUE else {}
        inner = scope.below(self._value(element, "ns", scope))
        for each in element.children:
            if each.name == "arg" and self._holds(each, scope):
                name = self._needed(each, "name", scope)
                value = self._value(each, "value", scope)
                default = self._value(each, "default", scope)
                passed[name] = value if value is not None else default or ""
        self.file(path, replace(inner, given=passed, arguments={}, depth=scope.depth + 1))

    def _node(self, element: XmlElement, scope: _Scope) -> None:
        scope = scope.below(self._value(element, "ns", scope))
        package, kind = self._needed(element, "pkg", scope), self._needed(element, "type", scope)
        name = resolved(self._needed(element, "name", scope), scope.namespace, "")
        self._places.note(scope.file, element, name)
        parameters = dict(scope.private)
        remaps: list[tuple[str, str]] = []
        for each in element.children:
            if not self._holds(each, scope):
                continue
            if each.name == "remap":
                remaps.append((self._needed(each, "from", scope), self._needed(each, "to", scope)))
            elif each.name in ("param", "rosparam"):
                values = self._values(each, scope)
                parameters |= {key.lstrip("~"): value for key, value in values.items()}
        said = words(scope.file, element, "args", self._value(element, "args", scope))
        remaps += [(a, b) for a, b in (word.split(":=", 1) for word in said if ":=" in word) if not a.startswith("_")]
        arguments = tuple(word for word in said if ":=" not in word)
        full = {
            resolved(a, scope.namespace, name): resolved(b, scope.namespace, name) for a, b in (*scope.remaps, *remaps)
        }
        said_here = {resolved(a, scope.namespace, name) for a, _ in remaps}
        renamed = tuple((a, b) for a, b in full.items() if a != b)
        node = RosNode(
            name,
            (),
            package,
            kind,
            arguments=arguments,
            remappings=renamed,
            parameters=parameters,
            machine=self._machine(element, scope),
            shared=frozenset(own for own, _ in renamed if own not in said_here),
            file=scope.file,
        )
        if (package, kind) == (_NODELETS, _NODELETS):
            node = _nodelet(node, scope.namespace)
        self._nodes.append(node)
        self._tell_of_ways_to_start(element, scope, name)

    def _machine(self, element: XmlElement, scope: _Scope) -> str | None:
        """The machine on which a node runs; None if it runs where roslaunch does."""
        name = self._value(element, "machine", scope)
        if not name:
            return None
        if name not in self._machines:
            self._notes.append(f"where the machine `{name}` is, which {scope.file}:{element.line} names")
        return None if self._machines.get(name) in _LOCAL else name

    def _tell_of_ways_to_start(self, element: XmlElement, scope: _Scope, name: str) -> None:
        """Note each attribute of a node that an environment can't express."""
        for attribute, reason in _DROPPED.items():
            value = self._value(element, attribute, scope)
            if value and value.strip().lower() not in FALSE:
                self._dropped.append(f'{attribute}="{value}" of {name}: {reason}')

    def _values(self, element: XmlElement, scope: _Scope) -> dict[str, object]:
        """The parameters that an element sets, by their names."""
        if element.name == "rosparam":
            return self._of_rosparam(element, scope)
        name = self._needed(element, "name", scope)
        kind = element.attributes.get("type", "auto").strip().lower()
        read = _TYPES.get(kind)
        text = self._value(element, "value", scope)
        if text is None and "textfile" in element.attributes:
            text, read = self._text_of(element, "textfile", scope), str
        if text is None:
            how = "by a command" if "command" in element.attributes else "by a file"
            self._notes.append(f"the value of {name}, which {scope.file}:{element.line} makes {how}")
            return {}
        if read is None:
            raise launch_fault(
                scope.file, element, f"`{kind}` is not a type of parameters", f"one of {', '.join(_TYPES)}"
            )
        try:
            return dict(_leaves({name: read(text)}))
        except (ValueError, yaml.YAMLError):
            raise launch_fault(
                scope.file, element, f"`{text}` is not of type {kind}", "mend the value or its type"
            ) from None

    def _of_rosparam(self, element: XmlElement, scope: _Scope) -> dict[str, object]:
        if (self._value(element, "command", scope) or "load") != "load":
            return {}
        text: str | None = "".join(piece for piece, _, _ in element.pieces)
        if "file" in element.attributes:
            text = self._text_of(element, "file", scope)
        if text is None:
            return {}
        if self._value(element, "subst_value", scope) in TRUE:
            text = self._meant(element, text, scope)
        names = [self._value(element, key, scope) or "" for key in ("ns", "param")]
        name = "/".join(each.strip("/") if at else each.rstrip("/") for at, each in enumerate(names) if each)
        try:
            value: Any = yaml.safe_load(text)
        except yaml.YAMLError:
            raise launch_fault(scope.file, element, "the loaded text is not YAML", "mend what it loads") from None
        if value is None or not (name or isinstance(value, dict)):
            return {}
        return dict(_leaves({name: value} if name else value))

    def _text_of(self, element: XmlElement, attribute: str, scope: _Scope) -> str | None:
        """The text of a file that an attribute names; None, and a note, if it is not here."""
        try:
            text = content_of(Path(self._needed(element, attribute, scope, missing=True))).decode()
            return text.replace("\r\n", "\n").replace("\r", "\n")  # as roslaunch reads it
        except PackageMissingError as error:
            self._notes.append(f"what {scope.file}:{element.line} loads, since {error}: see ROS_PACKAGE_PATH")
        except (OSError, UnicodeDecodeError) as error:
            self._notes.append(f"what {scope.file}:{element.line} loads: {error}")
        return None

    def _holds(self, element: XmlElement, scope: _Scope) -> bool:
        """Whether the conditions of an element let it be."""
        conditions = ((key, self._value(element, key, scope)) for key in ("if", "unless"))
        return all(is_met(scope.file, element, key, value) for key, value in conditions)

    def _needed(self, element: XmlElement, attribute: str, scope: _Scope, *, missing: bool = False) -> str:
        return given(scope.file, element, attribute, self._value(element, attribute, scope, missing=missing))

    def _value(self, element: XmlElement, attribute: str, scope: _Scope, *, missing: bool = False) -> str | None:
        """The value of an attribute; None if it has none."""
        text = element.attributes.get(attribute)
        return None if text is None else self._meant(element, text, scope, missing=missing)

    def _meant(self, element: XmlElement, text: str, scope: _Scope, *, missing: bool = False) -> str:
        """Return a text with its substitutions; those of missing packages stay, unless `missing` asks to raise."""
        try:
            return Substitutions(scope.file, scope.arguments).text(text)
        except PackageMissingError as error:
            if missing:
                raise
            self._notes.append(f"what `{text}` at {scope.file}:{element.line} is, since {error}: see ROS_PACKAGE_PATH")
            return text
        except SubstitutionError as error:
            mend = "pass arguments as NAME:=VALUE behind the file, or mend it"
            raise launch_fault(scope.file, element, str(error), mend) from None


def _nodelet(node: RosNode, namespace: str) -> RosNode:
    """The plugin that a node of the package `nodelet` is: in the manager that it names, or in a process of its own."""
    match node.arguments:
        case ("load", plugin, manager, *rest):
            container: str | None = resolved(manager, namespace, node.name)
        case ("standalone", plugin, *rest):
            container = None
        case _:
            return node
    package = plugin.partition("/")[0]
    return replace(node, package=package, executable=None, plugin=plugin, container=container, arguments=tuple(rest))


def _leaves(values: Mapping[Any, object], above: str = "") -> Iterator[tuple[str, object]]:
    """Yield each value in nested mappings with its full name; mappings loaded twice are merged that way."""
    for key, value in values.items():
        name = f"{above}/{key}" if above else str(key)
        if isinstance(value, dict):
            yield from _leaves(value, name)
        else:
            yield name, value
