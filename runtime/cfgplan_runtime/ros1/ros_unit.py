"""A unit as a ROS 1 node: its name, its topics, and the command that starts it."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from cfgplan.errors import InputError
from cfgplan.ros.graph import resolved
from cfgplan.ros.sources import NodeSource
from cfgplan.ros.topic_names import word
from cfgplan.ros.types import MessageType
from cfgplan.transformations import InputPort, OutputPort, Transformation
from cfgplan_runtime.nodes.unit_checks import check_names, node_file

_SYSTEM_PREFIXES = ("/usr/local", "/usr")


@dataclass(frozen=True)
class RosUnit:
    """A unit's node, by its full `name`."""

    name: str
    source: NodeSource
    transformation: Transformation

    @property
    def is_foreign(self) -> bool:
        """Whether the node is foreign: the run neither starts nor stops it."""
        return self.source.kind == "external"

    def listens_at(self, port: str) -> str:
        """The topic that an input listens to."""
        return self._name_of(self.transformation.input[port], "in")

    def publishes_at(self, port: str) -> str:
        """The topic that an output publishes on."""
        return self._name_of(self.transformation.output[port], "out")

    @property
    def remappings(self) -> Mapping[str, str]:
        """Each port's topic, by the name that the node's code uses."""
        transformation = self.transformation
        led = {port.remap or port.name: self.listens_at(port.name) for port in transformation.inputs}
        return {**led, **{port.remap or port.name: self.publishes_at(port.name) for port in transformation.outputs}}

    @property
    def parameters(self) -> Mapping[str, object]:
        """The node's parameters by their full names."""
        params = self.transformation.params
        return {name if name.startswith("/") else f"{self.name}/{name.lstrip('~')}": params[name] for name in params}

    def command(self, folder: Path) -> list[str]:
        """The command that starts a node; files are relative to `folder`. Raises InputError if it can't be found."""
        source = self.source
        remaps = [f"{own}:={topic}" for own, topic in self.remappings.items()]
        return [str(_program(source, folder)), *source.arguments, f"__name:={self.name.removeprefix('/')}", *remaps]

    def _name_of(self, port: InputPort | OutputPort, direction: str) -> str:
        if self.is_foreign:
            return resolved(port.remap or port.name, self.name.rpartition("/")[0], self.name)
        return f"{self.name}/{direction}/{word(port.name)}"


def node_source(transformation: Transformation) -> NodeSource:
    """The ROS 1 node of a transformation's units. Raises InputError if the source is no ROS 1 node."""
    label = transformation.label
    source = NodeSource.read(transformation.source)
    if source is None or source.kind == "component":
        mend = "write node:PACKAGE/EXECUTABLE, node:./FILE, nodelet:PACKAGE/CLASS or external:/NAME"
        raise InputError.of(f"{label}: `{transformation.source}` is not a node of ROS 1", mend=mend)
    ports: tuple[InputPort | OutputPort, ...] = (*transformation.inputs, *transformation.outputs)
    if source.kind != "external":
        check_names(transformation, lambda port: port.remap or port.name)
    for port in ports:
        if port.type is not None:
            MessageType.read(port.type)
    return source


def check_start(transformation: Transformation, folder: Path) -> None:
    """Raise InputError if the program of a node can't be found; files are relative to `folder`."""
    source = node_source(transformation)
    if source.kind != "external":
        _program(source, folder)


def _program(source: NodeSource, folder: Path) -> Path:
    """The file that starts a node, or a nodelet's manager. Raises InputError if it can't be found."""
    if source.kind == "nodelet":
        return executable("nodelet", "nodelet")
    return node_file(folder, source.name) if not source.package else executable(source.package, source.name)


def executable(package: str, name: str) -> Path:
    """An executable of a package, as `rosrun` finds it. Raises InputError."""
    found = next((path for path in _candidates(package, name) if os.access(path, os.X_OK) and path.is_file()), None)
    if found is None:
        mend = "look at its spelling, and source the setup file of its workspace before `cfgplan run`"
        raise InputError.of(f"there is no executable {name!r} of a package {package!r}", mend=mend)
    return found


def _candidates(package: str, name: str) -> Iterator[Path]:
    for prefix in (*_paths("CMAKE_PREFIX_PATH"), *map(Path, _SYSTEM_PREFIXES)):
        yield prefix / "lib" / package / name
    for root in _paths("ROS_PACKAGE_PATH"):
        for manifest in root.rglob("package.xml"):
            if manifest.parent.name == package:
                yield from manifest.parent.rglob(name)


def _paths(variable: str) -> list[Path]:
    return [Path(path) for path in os.environ.get(variable, "").split(os.pathsep) if path]
