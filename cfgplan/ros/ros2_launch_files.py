"""The nodes of a launch file of ROS 2 in XML or YAML, with the files that it includes.

Reference: design.ros2.org, "ROS 2 Launch XML Format", and the frontends launch_xml and launch_yaml. Launch files in
Python are programs and are not read.
"""

from __future__ import annotations

import os
import re
import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeAlias

import yaml

from cfgplan.errors import InputError
from cfgplan.formats.files import read_bytes, read_source
from cfgplan.formats.places import Path as Keys
from cfgplan.formats.places import Source
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
from cfgplan.ros.sources import CONTAINER_EXECUTABLES, CONTAINER_PACKAGE
from cfgplan.ros.substitutions import (
    PackageMissingError,
    SubstitutionError,
    evaluated,
    package_folder,
    valued,
    variable,
)
from cfgplan.transformations import ContainerKind

XML_FILES, YAML_FILES = (".xml", ".launch"), (".yaml", ".yml")
_INNERMOST = re.compile(r"\$\(([^()$]*(?:'[^']*'|\"[^\"]*\")?[^()$]*)\)")
_WHOLE_EVAL = re.compile(r"\$\(\s*eval\s+(.*)\)\s*", re.DOTALL)
_CONTAINERS = ("node_container", "lifecycle_node_container")
_KINDS: Mapping[tuple[str, str], ContainerKind] = {
    (CONTAINER_PACKAGE, executable): kind for kind, executable in CONTAINER_EXECUTABLES.items()
}
"""The containers that a run starts itself, by package and executable."""
_NODES = ("node", "lifecycle_node", *_CONTAINERS)
_GROUPED = ("param", "remap", "arg", "let", "composable_node", "extra_arg", "env")
"""Keys of YAML under which a list of mappings stands for several elements of that name."""
_IGNORED = ("log", "log_info", "extra_arg", "env")
_NOT_TAKEN_OVER: Mapping[str, str] = {
    "respawn": "a run replaces every unit that dies",
    "launch-prefix": "the node is started without it",
    "machine": "the node runs where the plan puts it",
}
_OF_TYPES: Mapping[str, Callable[[str], object]] = {
    "str": str,
    "int": int,
    "float": float,
    "bool": lambda text: text.strip().lower() in TRUE,
}
Element: TypeAlias = XmlElement
"""An element of either form; those of YAML are made of its mappings, and know their lines too."""


def ros2_launch_graph(path: Path, arguments: Mapping[str, str] | None = None) -> RosGraph:
    """The nodes that a launch file starts with these arguments, without ports.

    Raises InputError with file and line. A note tells each file, package and command that could not be read here.
    """
    walk = _Launch()
    walk.file(path, _State(path, dict(arguments or {})))
    nodes = tuple(replace(node, container_kind=walk.containers.get(node.container or "")) for node in walk.nodes)
    return RosGraph(nodes, (f"the launch file {path}",), tuple(dict.fromkeys(walk.notes)), tuple(walk.dropped))


@dataclass
class _State:
    """The settings that actions of a launch file make for the following ones, up to the end of their group."""

    file: Path
    values: dict[str, str]
    namespace: str = ""
    remaps: list[tuple[str, str]] = field(default_factory=list)
    parameters: dict[str, object] = field(default_factory=dict)
    depth: int = 0

    def scope(self) -> _State:
        """A copy, whose changes end with a group."""
        return replace(self, values={**self.values}, remaps=[*self.remaps], parameters={**self.parameters})


class _Launch:
    """One reading of a launch file and all that it includes."""

    def __init__(self) -> None:
        self.nodes: list[RosNode] = []
        self.notes: list[str] = []
        self.dropped: list[str] = []
        self.containers: dict[str, ContainerKind] = {}
        """The kinds of containers by full name."""
        self._places = NodePlaces()

    def file(self, path: Path, state: _State) -> None:
        """Read a file; its settings outside of groups hold for the including file too."""
        outer = state.file
        state.file, state.depth = path, state.depth + 1
        self._actions(_root(path).children, state)
        state.file, state.depth = outer, state.depth - 1

    def _actions(self, elements: Sequence[Element], state: _State) -> None:
        for element in elements:
            if self._holds(element, state):
                self._action(element, state)

    def _action(self, element: Element, state: _State) -> None:
        name = element.name.replace("-", "_")
        match name:
            case "arg":
                self._argument(element, state)
            case "let":
                state.values[self._needed(element, "name", state)] = self._needed(element, "value", state)
            case "group":
                is_scoped = (self._value(element, "scoped", state) or "true").lower() in TRUE
                self._actions(element.children, state.scope() if is_scoped else state)
            case "timer":
                self._actions(element.children, state)
            case "push_ros_namespace":
                key = "namespace" if "namespace" in element.attributes else "ns"
                state.namespace = resolved(self._needed(element, key, state), state.namespace, "")
            case "set_remap":
                state.remaps.append((self._needed(element, "from", state), self._needed(element, "to", state)))
            case "set_parameter":
                state.parameters |= self._parameter(element, state)
            case "include":
                self._include(element, state)
            case "load_composable_node":
                target = resolved(self._needed(element, "target", state), state.namespace, "")
                self._components(element, state, target)
            case _ if name in _NODES:
                self._node(element, state)
            case _ if name not in _IGNORED:
                self.dropped.append(f"<{element.name}> at {state.file}:{element.line}")

    def _argument(self, element: Element, state: _State) -> None:
        name = self._needed(element, "name", state)
        default = self._value(element, "default", state)
        if name not in state.values:
            state.values[name] = declared(state.file, element, name, default)

    def _include(self, element: Element, state: _State) -> None:
        try:
            path = Path(self._needed(element, "file", state, missing=True))
        except PackageMissingError as error:
            self.notes.append(f"what {state.file}:{element.line} includes, since {error}: see AMENT_PREFIX_PATH")
            return
        for each in element.children:
            if each.name in ("arg", "let") and self._holds(each, state):
                state.values[self._needed(each, "name", state)] = self._needed(each, "value", state)
        if path.suffix == ".py":
            self.notes.append(f"what {path} starts, which {state.file}:{element.line} includes: it is a program")
        else:
            self.file(included(state.file, element, path, state.depth), state)

    def _node(self, element: Element, state: _State) -> None:
        package, executable = self._needed(element, "pkg", state), self._needed(element, "exec", state)
        said = self._words(element, "args", state)
        ros = self._words(element, "ros_args", state)
        own = self._value(element, "name", state)
        if own is None:
            own = Path(executable).stem
            self.notes.append(f"the name of the node at {state.file}:{element.line}, which is called {own} here")
        node = self._named(element, state, own, package)
        renamed = [word.split(":=", 1) for word in ros if ":=" in word and not word.startswith("_")]
        more = {resolved(a, state.namespace, node.name): resolved(b, state.namespace, node.name) for a, b in renamed}
        is_container = element.name.replace("-", "_") in _CONTAINERS
        kind = _KINDS.get((package, executable)) if is_container else None
        if kind is not None:
            self.containers[node.name] = kind
        else:
            self.nodes.append(
                replace(
                    node,
                    executable=executable,
                    arguments=tuple(said),
                    remappings=(*node.remappings, *((a, b) for a, b in more.items() if a != b)),
                )
            )
        for attribute, reason in _NOT_TAKEN_OVER.items():
            value = self._value(element, attribute, state) or self._value(element, attribute.replace("-", "_"), state)
            if value and value.strip().lower() not in FALSE:
                self.dropped.append(f'{attribute}="{value}" of {node.name}: {reason}')
        if is_container:
            self._components(element, state, node.name)

    def _components(self, element: Element, state: _State, container: str) -> None:
        for each in element.children:
            if each.name.replace("-", "_") == "composable_node" and self._holds(each, state):
                package, plugin = self._needed(each, "pkg", state), self._needed(each, "plugin", state)
                own = self._value(each, "name", state) or plugin.rpartition("::")[2]
                node = self._named(each, state, own, package)
                self.nodes.append(replace(node, plugin=plugin, container=container))

    def _named(self, element: Element, state: _State, own: str, package: str) -> RosNode:
        """A node with its name, parameters and remappings. Raises InputError if another one has its name."""
        namespace = self._value(element, "namespace", state)
        space = resolved(namespace, state.namespace, "") if namespace else state.namespace
        name = resolved(own, space, "")
        self._places.note(state.file, element, name)
        parameters, remaps = dict(state.parameters), list[tuple[str, str]]()
        for each in element.children:
            if not self._holds(each, state):
                continue
            if each.name == "remap":
                remaps.append((self._needed(each, "from", state), self._needed(each, "to", state)))
            elif each.name == "param":
                parameters |= self._parameter(each, state, name)
        full = {resolved(a, space, name): resolved(b, space, name) for a, b in (*state.remaps, *remaps)}
        renamed = tuple((a, b) for a, b in full.items() if a != b)
        said_here = {resolved(a, space, name) for a, _ in remaps}
        shared = frozenset(own for own, _ in renamed if own not in said_here)
        return RosNode(name, (), package, remappings=renamed, parameters=parameters, shared=shared, file=state.file)

    def _parameter(self, element: Element, state: _State, node: str = "") -> dict[str, object]:
        """The parameters that an element sets for a node, by their names; dots join the parts of nested names."""
        if "from" in element.attributes:
            return self._parameters_of_file(element, state, node)
        name = self._needed(element, "name", state)
        nested = [each for each in element.children if each.name == "param"]
        if nested:
            inner = [self._parameter(each, state, node) for each in nested if self._holds(each, state)]
            return {f"{name}.{key}": value for each in inner for key, value in each.items()}
        text = self._needed(element, "value", state)
        kind, separator = element.attributes.get("type"), element.attributes.get("value-sep")
        try:
            if separator:
                return {name: [_typed(part, kind) for part in text.split(separator)]}
            return {name: _typed(text, kind)}
        except (ValueError, yaml.YAMLError):
            raise launch_fault(
                state.file, element, f"`{text}` is not of type {kind}", "mend the value or its type"
            ) from None

    def _parameters_of_file(self, element: Element, state: _State, node: str) -> dict[str, object]:
        place = f"{state.file}:{element.line}"
        try:
            path = self._needed(element, "from", state, missing=True)
            loaded: Any = yaml.safe_load(read_bytes(Path(path)))
        except PackageMissingError as error:
            self.notes.append(f"the parameters that {place} loads, since {error}: see AMENT_PREFIX_PATH")
            return {}
        except InputError as error:
            self.notes.append(f"the parameters that {place} loads: {error.faults[0].message}")
            return {}
        except yaml.YAMLError:
            raise launch_fault(state.file, element, f"{path} is not YAML", "mend the file") from None
        found: dict[str, object] = {}
        for said in _for_node(loaded, node):
            found |= dict(_leaves(said))
        return found

    def _words(self, element: Element, attribute: str, state: _State) -> list[str]:
        return words(state.file, element, attribute, self._value(element, attribute, state))

    def _holds(self, element: Element, state: _State) -> bool:
        """Whether the conditions of an element let it be."""
        conditions = ((key, self._value(element, key, state)) for key in ("if", "unless"))
        return all(is_met(state.file, element, key, value) for key, value in conditions)

    def _needed(self, element: Element, attribute: str, state: _State, *, missing: bool = False) -> str:
        return given(state.file, element, attribute, self._value(element, attribute, state, missing=missing))

    def _value(self, element: Element, attribute: str, state: _State, *, missing: bool = False) -> str | None:
        """The value of an attribute; None if it has none."""
        text = element.attributes.get(attribute)
        if text is None:
            return None
        try:
            return _meant(text, state)
        except PackageMissingError as error:
            if missing:
                raise
            self.notes.append(f"what `{text}` at {state.file}:{element.line} is, since {error}: see AMENT_PREFIX_PATH")
            return text
        except SubstitutionError as error:
            mend = "pass arguments as NAME:=VALUE behind the file, or mend it"
            raise launch_fault(state.file, element, str(error), mend) from None


def _meant(text: str, state: _State) -> str:
    """A text with its substitutions, the innermost first. Raises SubstitutionError."""
    while (found := _INNERMOST.search(text)) is not None:
        text = text[: found.start()] + _substituted(found[1].strip(), state) + text[found.end() :]
        if (whole := _WHOLE_EVAL.fullmatch(text)) and "$(" not in whole[1]:
            return str(evaluated(_unquoted(whole[1]), {}))
    return text


def _unquoted(text: str) -> str:
    text = text.strip()
    return text[1:-1] if len(text) > 1 and text[0] == text[-1] and text[0] in "'\"" else text


def _substituted(inner: str, state: _State) -> str:
    """Return the value of a substitution that contains no other substitution."""
    word, _, rest = inner.partition(" ")
    if word == "eval":
        return str(evaluated(_unquoted(rest), {}))
    try:
        match word, shlex.split(rest):
            case "var", [name, *default]:
                if name in state.values or default:
                    return state.values.get(name, " ".join(default))
                raise SubstitutionError(f"the argument `{name}` has no value")
            case "env", [name, *default]:
                return os.environ.get(name, " ".join(default)) if default else variable(name)
            case ("find-pkg-share" | "find-pkg-prefix") as where, [package]:
                return str(_package(package, state.file, prefix=where == "find-pkg-prefix"))
            case "exec-in-pkg", [executable, package]:
                return str(_package(package, state.file, prefix=True) / "lib" / package / executable)
            case "dirname", []:
                return str(state.file.parent)
            case "filename", []:
                return str(state.file)
            case "anon", [name]:
                return name
            case "not", [one]:
                return _said(not _is_true(one))
            case (("and" | "all"), several):
                return _said(all(map(_is_true, several)))
            case (("or" | "any"), several):
                return _said(any(map(_is_true, several)))
            case "equals", [one, other]:
                return _said(valued(one) == valued(other))
            case "not-equals", [one, other]:
                return _said(valued(one) != valued(other))
            case "if", [condition, one, *other]:
                return one if _is_true(condition) else " ".join(other)
    except ValueError as error:
        raise SubstitutionError(f"`$({inner})`: {error}") from None
    raise SubstitutionError(f"`$({inner})` is not a substitution that cfgplan reads")


def _is_true(text: str) -> bool:
    if text.strip().lower() not in (*TRUE, *FALSE):
        raise SubstitutionError(f"`{text}` is neither true nor false")
    return text.strip().lower() in TRUE


def _said(truth: bool) -> str:
    return "true" if truth else "false"


def _package(name: str, near: Path, *, prefix: bool) -> Path:
    """The share folder of a package, or the prefix that it is installed in. Raises PackageMissingError."""
    for root in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep):
        share = Path(root) / "share" / name
        if root and share.is_dir():
            return Path(root) if prefix else share
    found = package_folder(name, near)
    if found is None:
        raise PackageMissingError(f"the package `{name}` is not found")
    return found


def _typed(text: str, kind: str | None) -> object:
    """Return a parameter's value in its declared type, or else in the type that YAML reads. Raises ValueError and
    YAMLError.
    """
    if kind is None or kind == "auto":
        return yaml.safe_load(text)
    if kind.startswith("list_of_"):
        each = kind.removeprefix("list_of_").removesuffix("s")
        return [_typed(str(value), each) for value in yaml.safe_load(text)]
    if kind not in _OF_TYPES:
        raise ValueError
    return _OF_TYPES[kind](text)


def _for_node(loaded: object, node: str) -> Iterator[Mapping[str, object]]:
    """The parts of a parameter file that are about a node: for all (`/**`), by its name, and by its full name."""
    if not isinstance(loaded, dict):
        return
    if not any(isinstance(value, dict) and "ros__parameters" in value for value in _depths(loaded)):
        return
    patterns = ("/**", node.rpartition("/")[2], node, node.removeprefix("/"))
    for key in dict.fromkeys(patterns):
        inner = loaded.get(key)
        if isinstance(inner, dict) and isinstance(inner.get("ros__parameters"), dict):
            yield inner["ros__parameters"]
    for key, inner in loaded.items():
        space = f"/{str(key).strip('/')}/"
        if isinstance(inner, dict) and "ros__parameters" not in inner and node.startswith(space):
            yield from _for_node(inner, node.removeprefix(space.rstrip("/")))


def _depths(loaded: Mapping[str, object]) -> Iterator[object]:
    """The values of a mapping, and of the mappings in it."""
    for value in loaded.values():
        yield value
        if isinstance(value, dict):
            yield from _depths(value)


def _leaves(values: Mapping[Any, object], above: str = "") -> Iterator[tuple[str, object]]:
    """Parameters by their whole names, with dots, as ROS 2 declares them."""
    for key, value in values.items():
        name = f"{above}.{key}" if above else str(key)
        if isinstance(value, dict):
            yield from _leaves(value, name)
        else:
            yield name, value


def _root(path: Path) -> Element:
    """The element <launch> of a file in either form. Raises InputError."""
    if path.suffix in YAML_FILES:
        return _yaml_root(path)
    root = parse_xml(read_bytes(path), str(path))
    if root.name != "launch":
        mend = "a launch file in XML is one element <launch>"
        raise launch_fault(path, root, f"this is not a launch file: it begins with <{root.name}>", mend)
    return root


def _yaml_root(path: Path) -> Element:
    source = read_source(path)
    if source.faults:
        raise InputError(source.faults)
    data = source.data
    if not isinstance(data, dict) or not isinstance(data.get("launch"), list):
        mend = "a launch file in YAML is a list below `launch:`"
        raise InputError([source.fault((), "this is not a launch file", mend)])
    root = _element(source, ("launch",), "launch", {})
    root.children = list(_children(source, ("launch",), data["launch"]))
    return root


def _children(source: Source, keys: Keys, actions: Sequence[object]) -> Iterator[Element]:
    """The actions of a list, each a mapping of one key."""
    for at, action in enumerate(actions):
        inner = (*keys, at)
        if not isinstance(action, dict) or len(action) != 1:
            mend = "write `- node: {...}`, one key for each action"
            raise InputError([source.fault(inner, "this is not an action of a launch file", mend)])
        ((name, said),) = action.items()
        yield _of_yaml(source, (*inner, name), str(name), said)


def _of_yaml(source: Source, keys: Keys, name: str, said: object) -> Element:
    """An element of a mapping: its texts and numbers are attributes, its lists of mappings children."""
    if isinstance(said, list):
        element = _element(source, keys, name, {})
        element.children = list(_children(source, keys, said))
        return element
    if not isinstance(said, dict):
        raise InputError([source.fault(keys, f"`{name}` is not a mapping", f"write `{name}: {{...}}`")])
    attributes = {str(key): _text(value) for key, value in said.items() if not isinstance(value, dict | list)}
    element = _element(source, keys, name, attributes)
    for key, value in said.items():
        if isinstance(value, list) and (key in _GROUPED or name == "param"):
            for at, each in enumerate(value):
                if isinstance(each, dict):
                    element.children.append(
                        _of_yaml(source, (*keys, key, at), "param" if name == "param" else key, each)
                    )
                else:
                    element.attributes[key] = yaml.safe_dump(value, default_flow_style=True).strip()
                    break
        elif isinstance(value, list):
            element.children += _children(source, (*keys, key), value)
    return element


def _text(value: object) -> str:
    if isinstance(value, bool):
        return _said(value)
    return "" if value is None else str(value)


def _element(source: Source, keys: Keys, name: str, attributes: dict[str, str]) -> Element:
    spot = source.locate(keys, True)
    return XmlElement(name, attributes, spot.line, spot.column)
