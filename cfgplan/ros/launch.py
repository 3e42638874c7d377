"""A configuration of ROS 2 nodes as a launch file in Python: nodes, containers of components, remappings and relays.

Reference: the constructors of launch and launch_ros. Values are written by `repr`.
"""

from __future__ import annotations

import re
import shlex
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from os.path import relpath
from pathlib import Path
from typing import Any, Literal, TypeAlias

import yaml

from cfgplan.domain import Environment
from cfgplan.errors import InputError
from cfgplan.ros.sources import CONTAINER_EXECUTABLES, CONTAINER_PACKAGE, container_faults
from cfgplan.ros.topic_names import NodeUnit, TopicNames, word

LaunchPart: TypeAlias = Literal["all", "nodes", "components"]
_CONTAINER = "cfgplan_container"
_INDENT = "    "


@dataclass(frozen=True)
class _Code:
    """An expression."""

    text: str


@dataclass(frozen=True)
class _Call:
    """A call with keyword arguments; those that are None or empty are left out. One named "" has no keyword."""

    name: str
    arguments: Mapping[str, object]


@dataclass(frozen=True)
class IncludedLaunch:
    """A launch file to include, relative to the folder of the including one, with its arguments."""

    file: str
    arguments: Mapping[str, str]

    @classmethod
    def read(cls, text: str, folder: str) -> IncludedLaunch:
        """Read `FILE NAME:=VALUE ...`; `folder` is that of the including file. Raises InputError."""
        try:
            file, *said = shlex.split(text)
        except ValueError:
            mend = "write FILE, or 'FILE NAME:=VALUE ...'"
            raise InputError.of(f"--include `{text}` names no launch file", mend=mend) from None
        arguments = dict(each.split(":=", 1) for each in said if ":=" in each)
        if wrong := next((each for each in said if ":=" not in each), None):
            raise InputError.of(f"--include: `{wrong}` is not an argument of a launch file", mend="write NAME:=VALUE")
        if not Path(file).is_file():
            raise InputError.of("there is no such launch file to include", file=file, mend="look at its spelling")
        return cls(relpath(file, folder), arguments)


def launch_text(
    environment: Environment,
    about: Sequence[str] = (),
    *,
    part: LaunchPart = "all",
    host: str | None = None,
    folder: str = ".",
    includes: Sequence[IncludedLaunch] = (),
) -> str:
    """Return a launch file of the running configuration; the lines `about` are a comment at its top.

    `part` selects nodes or components, `host` the units of one host. Relays are launched with the nodes of the first
    host. `folder` leads from the launch file's folder to the files of nodes that are files (`node:./FILE`). The
    launch files `includes` are included first. Raises InputError.
    """
    _check_host(environment, host)
    names = TopicNames(environment)
    units = [each for each in names.units if each.unit.host == host and not each.is_foreign]
    nodes = [] if part == "components" else [each for each in units if each.source.kind == "node"]
    if faults := [*container_faults(each.transformation for each in units)]:
        raise InputError(faults)
    components = [] if part == "nodes" else [each for each in units if each.source.kind == "component"]
    actions = [*_nodes(nodes, names, folder), *_containers(components, names)]
    if part != "components" and host in (None, environment.hosts[0].name if environment.hosts else None):
        actions += _relays(names)
    if not actions:
        which = "there is none" if part == "all" else f"there are no {part}"
        raise InputError.of(
            f"nothing to launch: {which} in the configuration", mend="look at what `cfgplan solve` says"
        )
    return _file(about, [*map(_included, includes), *actions])


def _included(one: IncludedLaunch) -> _Call:
    source = _Code(f"AnyLaunchDescriptionSource(str(Path(__file__).parent / {one.file!r}))")
    return _Call("IncludeLaunchDescription", {"": source, "launch_arguments": list(one.arguments.items())})


def _check_host(environment: Environment, host: str | None) -> None:
    there = [each.name for each in environment.hosts]
    if host is None and there:
        raise InputError.of("a launch file is for one host", mend=f"name one by --host: {', '.join(there)}")
    if host is not None and host not in there:
        raise InputError.of(f"there is no host `{host}`", mend=f"there is {', '.join(there) or 'none'}")


def _nodes(units: Sequence[NodeUnit], names: TopicNames, folder: str) -> Iterator[_Call]:
    for each in units:
        source = each.source
        program: dict[str, object] = {"package": source.package, "executable": source.name}
        if not source.package:
            program = {"executable": _Code(f"str(Path(__file__).parent / {str(Path(folder, source.name))!r})")}
        more = {"arguments": list(source.arguments), "output": "screen"}
        yield _Call("Node", {**program, **_described(each, names), **more})


def _containers(units: Sequence[NodeUnit], names: TopicNames) -> Iterator[_Call]:
    groups = defaultdict[str, list[NodeUnit]](list)
    for each in units:
        kind = each.transformation.run.container
        groups[each.source.group or (_CONTAINER if kind == "plain" else f"{_CONTAINER}_{kind}")].append(each)
    for name, members in sorted(groups.items()):
        inside = [
            _Call(
                "ComposableNode",
                {"package": each.source.package, "plugin": each.source.name, **_described(each, names)},
            )
            for each in members
        ]
        arguments = {
            "package": CONTAINER_PACKAGE,
            "executable": CONTAINER_EXECUTABLES[members[0].transformation.run.container],
            "name": word(name),
            "namespace": _Code("''"),
            "composable_node_descriptions": inside,
            "output": "screen",
        }
        yield _Call("ComposableNodeContainer", arguments)


def _relays(names: TopicNames) -> Iterator[_Call]:
    for number, relay in enumerate(names.relays, 1):
        arguments = {
            "package": "topic_tools",
            "executable": "relay",
            "name": f"cfgplan_relay_{number}",
            "arguments": [relay.source, relay.target],
            "output": "screen",
        }
        yield _Call("Node", arguments)


def _described(each: NodeUnit, names: TopicNames) -> dict[str, object]:
    params = {name.lstrip("~/"): _parameter(each, name, value) for name, value in each.transformation.params.items()}
    return {
        "name": each.name.removeprefix("/"),
        "parameters": [params] if params else [],
        "remappings": names.remappings(each),
    }


def _parameter(each: NodeUnit, name: str, value: Any) -> object:
    """A parameter as launch_ros takes it: a text that YAML would take for something else is said to be one."""
    match value:
        case bool() | int() | float():
            return value
        case str():
            return value if _is_plain(value) else _Code(f"ParameterValue({value!r}, value_type=str)")
        case Mapping():
            return {key: _parameter(each, f"{name}.{key}", inner) for key, inner in value.items()}
        case [_, *_]:
            kinds = {type(one) for one in value}
            if kinds <= {int, float}:
                return list(value) if len(kinds) == 1 else [float(one) for one in value]
            if kinds == {bool}:
                return list(value)
            if kinds == {str}:
                return _Code(f"ParameterValue({list(value)!r}, value_type=List[str])")
    mend = "it is a truth value, a number, a text, a mapping of such, or a list of one kind with something in it"
    raise InputError.of(f"{each.transformation.label}: param {name} can't be one of a ROS 2 node: {value!r}", mend=mend)


def _is_plain(text: str) -> bool:
    """Whether YAML, by which launch_ros reads texts, takes one for the same text; it leaves an empty one as it is."""
    try:
        return not text or yaml.safe_load(text) == text
    except yaml.YAMLError:
        return False


_MODULES = {
    "List": "typing",
    "Path": "pathlib",
    "LaunchDescription": "launch",
    "IncludeLaunchDescription": "launch.actions",
    "AnyLaunchDescriptionSource": "launch.launch_description_sources",
    "ComposableNodeContainer": "launch_ros.actions",
    "Node": "launch_ros.actions",
    "ComposableNode": "launch_ros.descriptions",
    "ParameterValue": "launch_ros.parameter_descriptions",
}


def _file(about: Sequence[str], actions: Sequence[_Call]) -> str:
    inside = "".join(f"{_INDENT * 2}{_shown(action, 2)},\n" for action in actions)
    returned = f"LaunchDescription([\n{inside}{_INDENT}])"
    names = defaultdict[str, list[str]](list)
    for name in sorted(_MODULES):
        if re.search(rf"\b{name}[(\[]", returned):
            names[_MODULES[name]].append(name)
    imports = {module: f"from {module} import {', '.join(names[module])}" for module in sorted(names)}
    own, others = (
        [line for module, line in imports.items() if module.startswith("launch") is is_launch]
        for is_launch in (False, True)
    )
    head = [*(f"# {line}".rstrip() for line in about), "", *own, *([""] if own else []), *others]
    return "\n".join([*head, "", "", "def generate_launch_description():", f"{_INDENT}return {returned}", ""])


def _shown(value: object, depth: int) -> str:
    """An expression, broken into lines where it has parts."""
    ahead, back = _INDENT * (depth + 1), _INDENT * depth

    def lines(parts: Iterator[str]) -> str:
        return "".join(f"\n{ahead}{part}," for part in parts) + f"\n{back}"

    match value:
        case _Code(text):
            return text
        case _Call(name, arguments):
            said = ((key and f"{key}=", each) for key, each in arguments.items() if each not in (None, "", []))
            return f"{name}({lines(f'{keyword}{_shown(each, depth + 1)}' for keyword, each in said)})"
        case Mapping() if value:
            return f"{{{lines(f'{key!r}: {_shown(each, depth + 1)}' for key, each in value.items())}}}"
        case [_, *_] if not all(isinstance(each, str | int | float) for each in value):
            return f"[{lines(_shown(each, depth + 1) for each in value)}]"
        case _:
            return repr(value)
