"""A unit as a ROS 2 node: its name, its topics, its parameters, and the command that starts it."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from cfgplan.errors import InputError
from cfgplan.ros.graph import resolved
from cfgplan.ros.sources import CONTAINER_EXECUTABLES, CONTAINER_PACKAGE, REMAPS, NodeSource
from cfgplan.ros.topic_names import remapped, word
from cfgplan.ros.types import MessageType
from cfgplan.transformations import InputPort, OutputPort, Transformation
from cfgplan_runtime.nodes.unit_checks import check_names, node_file
from cfgplan_runtime.ros2.host_messages import PortTopic

_PLAIN = (bool, int, float, str)
_INTEGERS = range(-(2**63), 2**63)
"""The integers that a parameter can have; rcl reads others as floats."""
_CONTAINER_NAME = re.compile(r"/?[A-Za-z]\w*(/[A-Za-z]\w*)*", re.ASCII)
SIM_TIME = "use_sim_time"
"""The parameter by which every node of ROS 2 goes by the time of /clock."""


@dataclass(frozen=True)
class Ros2Unit:
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
    def heard(self) -> list[PortTopic]:
        """The topics that its inputs listen to; services are only called."""
        ports = [port for port in self.transformation.inputs if not port.service]
        return [PortTopic(self.listens_at(port.name), self._key(port.name), message_of(port)) for port in ports]

    @property
    def published(self) -> list[PortTopic]:
        """The topics and services of its outputs."""
        ports = self.transformation.outputs
        return [
            PortTopic(self.publishes_at(port.name), self._key(port.name), message_of(port), port.topic)
            for port in ports
        ]

    @property
    def remappings(self) -> Mapping[str, str]:
        """Each port's topic by the name that the node's code has for it."""
        found: dict[str, str] = {}
        for taken in self.transformation.inputs:
            found |= remapped(_own_name(taken), self.listens_at(taken.name), taken.type)
        for given in self.transformation.outputs:
            found |= remapped(_own_name(given), self.publishes_at(given.name), given.type)
        return found

    @property
    def parameters(self) -> dict[str, Any]:
        """Its parameters by the names that the node's code has for them."""
        return {name.removeprefix("~").lstrip("/"): value for name, value in self.transformation.params.items()}

    def command(self, folder: Path, parameters: Path) -> list[str]:
        """The command that starts the node; files are relative to `folder`. Raises InputError if it can't be found.

        Parameters are written to the file `parameters`, if the node has any.
        """
        return [self.program(folder), *self.source.arguments, *self.arguments(parameters)]

    def program(self, folder: Path) -> str:
        """The file that the command runs; a component's container. Raises InputError if it can't be found."""
        source = self.source
        if source.kind == "component":
            return str(executable(CONTAINER_PACKAGE, CONTAINER_EXECUTABLES[self.transformation.run.container]))
        return str(executable(source.package, source.name) if source.package else node_file(folder, source.name))

    def arguments(self, parameters: Path) -> list[str]:
        """The words of its command line for names and parameters."""
        namespace, _, name = self.name.rpartition("/")
        names = {"__node": name, "__ns": namespace or "/", **self.remappings}
        said = [part for own, other in names.items() for part in ("-r", f"{own}:={other}")]
        if self.parameters:
            parameters.write_text(parameters_text(self.parameters))
            said += ["--params-file", str(parameters)]
        return ["--ros-args", *said]

    def _key(self, port: str) -> str:
        return f"{self.transformation.label}/{port}"

    def _name_of(self, port: InputPort | OutputPort, direction: str) -> str:
        if self.is_foreign:
            return resolved(port.remap or port.name, self.name.rpartition("/")[0], self.name)
        return f"{self.name}/{direction}/{word(port.name)}"


def message_of(port: InputPort | OutputPort) -> str | None:
    """The message type of a port as ROS 2 writes it; None for a service, and if the file does not say the type."""
    if port.type is None:
        return None
    kind = MessageType.read(port.type, "srv" if isinstance(port, InputPort) and port.service else "msg")
    return kind.ros2


def node_source(transformation: Transformation) -> NodeSource:
    """The ROS 2 node that units of a transformation are. Raises InputError for one that can't be."""
    label = transformation.label
    source = NodeSource.read(transformation.source)
    if source is None or source.kind == "nodelet":
        mend = "write node:PACKAGE/EXECUTABLE, node:./FILE, component:PACKAGE/PLUGIN or external:/NAME"
        raise InputError.of(
            f"{label}: `{transformation.source}` is not a node of ROS 2 that a run can start", mend=mend
        )
    if source.kind == "component":
        _check_component(label, source)
    if source.kind != "external":
        check_names(transformation, _own_name)
        for name, value in transformation.params.items():
            _check_parameter(f"{label}: params: {name}", value)
    ports: tuple[InputPort | OutputPort, ...] = (*transformation.inputs, *transformation.outputs)
    for port in ports:
        message_of(port)
    return source


def check_start(transformation: Transformation, folder: Path) -> None:
    """Raise InputError if the program of a node can't be found; files are relative to `folder`."""
    source = node_source(transformation)
    if source.kind != "external":
        Ros2Unit("/name", source, transformation).program(folder)


def _check_component(label: str, source: NodeSource) -> None:
    """Raise InputError for what no container can load."""
    other = next((each for each in source.arguments if REMAPS not in each), None)
    if other is not None:
        what = f"{label}: a component takes no argument `{other}`, only remappings"
        raise InputError.of(what, mend="write parameters as `params`")
    if source.group and not _CONTAINER_NAME.fullmatch(source.group):
        what = f"{label}: `{source.group}` can't be the name of a container"
        raise InputError.of(what, mend="use letters, digits and underscores, between slashes for a namespace")


def executable(package: str, name: str) -> Path:
    """An executable of a package, as `ros2 run` finds it. Raises InputError."""
    prefixes = [one for one in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if one]
    for prefix in prefixes:
        path = Path(prefix, "lib", package, name)
        if path.is_file() and os.access(path, os.X_OK):
            return path
    what = f"there is no executable {name!r} of a package {package!r}"
    mend = (
        "look at its spelling, and source the setup file of its workspace before `cfgplan run`"
        if prefixes
        else "source the setup file of its workspace before `cfgplan run`: AMENT_PREFIX_PATH is empty"
    )
    raise InputError.of(what, mend=mend)


def parameters_text(params: Mapping[str, object]) -> str:
    """A file of parameters for any node that reads it. Texts are quoted: rcl takes `1e3` for a number."""
    return yaml.dump({"/**": {"ros__parameters": dict(params)}}, Dumper=_Dumper, allow_unicode=True, sort_keys=True)


class _Dumper(yaml.SafeDumper):
    """Writes texts in quotes, and no aliases."""

    def ignore_aliases(self, data: object) -> bool:  # noqa: ARG002
        return True


_Dumper.add_representer(str, lambda dumper, text: dumper.represent_scalar("tag:yaml.org,2002:str", text, style='"'))


def _own_name(port: InputPort | OutputPort) -> str:
    """The name of a port in the node's code, private names as ROS 2 writes them."""
    return re.sub("^~/?", "~/", port.remap or port.name)


def _check_parameter(place: str, value: object) -> None:
    """Raise InputError for a value that no parameter of ROS 2 can have."""
    if isinstance(value, Mapping) and value:
        for name, part in value.items():
            _check_parameter(f"{place}.{name}", part)
        return
    values = list(value) if isinstance(value, Mapping | Sequence) and not isinstance(value, str) else [value]
    kinds = {type(one) for one in values}
    if not values:
        mend = "leave it out: an empty value has no type, so ROS 2 gives the node none"
    elif not all(kind in _PLAIN for kind in kinds) or len(kinds) > 1:
        mend = "write a number, a text, true or false, or a list of one kind of these (1.0 and 2, say, are two kinds)"
    elif kinds == {int} and not all(one in _INTEGERS for one in values):
        mend = "an integer has 64 bits: write a number with a point, or a text"
    else:
        return
    raise InputError.of(f"{place}: `{value}` can't be a parameter of ROS 2", mend=mend)
