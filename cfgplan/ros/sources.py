"""The `source` of a unit that is a ROS node."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Iterator, Mapping
from typing import Literal, get_args

from cfgplan.errors import Fault, InputError
from cfgplan.frozen import dataclass
from cfgplan.transformations import ContainerKind, Transformation

CONTAINER_PACKAGE = "rclcpp_components"
CONTAINER_EXECUTABLES: Mapping[ContainerKind, str] = {
    "plain": "component_container",
    "mt": "component_container_mt",
    "isolated": "component_container_isolated",
}
"""The containers of ROS 2's components."""
NodeKind = Literal["node", "nodelet", "component", "external"]
_FORMS = "node:PACKAGE/EXECUTABLE, node:./FILE, nodelet:PACKAGE/CLASS, component:PACKAGE/PLUGIN or external:/NAME"

REMAPS = ":="
"""The sign between the two names of a remapping in a node's arguments."""


@dataclass(frozen=True, slots=True)
class NodeSource:
    """The ROS node that a transformation's units run as.

    A `node` is an executable of a package, or a file (`package` is "") relative to the environment file. A `nodelet`
    (ROS 1) or a `component` (ROS 2) is a class of a package, loaded into the manager or container `group`, or if that
    is "" into the run's own. An `external` node is started outside of cfgplan, under the name `name`.
    """

    kind: NodeKind
    package: str
    name: str
    arguments: tuple[str, ...] = ()
    group: str = ""

    @classmethod
    def read(cls, source: str | None) -> NodeSource | None:
        """The node that `source` names; None if it names unit code in Python, or nothing. Raises InputError."""
        scheme, colon, rest = (source or "").partition(":")
        if scheme not in get_args(NodeKind) or not colon or "/" not in rest:
            return None
        kind: NodeKind = scheme  # type: ignore[assignment]
        try:
            first, *arguments = shlex.split(rest)
        except ValueError as error:
            raise InputError.of(f"source `{source}`: {error}", mend="quote arguments as in a shell") from None
        if kind == "external" and first.startswith("/") and len(first) > 1 and not arguments:
            return cls(kind, "", first)
        if kind == "node" and first.startswith(("./", "../", "/")):
            return cls(kind, "", first, tuple(arguments))
        package, _, name = first.partition("/")
        name, at, group = name.partition("@") if kind in ("nodelet", "component") else (name, "", "")
        if not package or not name or (at and not group) or kind == "external":
            raise InputError.of(f"source `{source}` names no node", mend=f"write {_FORMS}")
        return cls(kind, package, name, tuple(arguments), group)

    def __str__(self) -> str:
        first = f"{self.package}/{self.name}" if self.package else self.name
        group = f"@{self.group}" if self.group else ""
        return f"{self.kind}:{' '.join([first + group, *(shlex.quote(each) for each in self.arguments)])}"


def container_faults(library: Iterable[Transformation]) -> Iterator[Fault]:
    """Yield the faults of components that share a container and ask for different kinds of it."""
    kinds: dict[str, dict[ContainerKind, str]] = {}
    for transformation in library:
        source = NodeSource.read(transformation.source)
        if source is not None and source.kind == "component" and source.group:
            kinds.setdefault(source.group, {}).setdefault(transformation.run.container, transformation.label)
    for group, labels in kinds.items():
        if len(labels) > 1:
            said = " and ".join(f"`{label}` asks for {kind}" for kind, label in labels.items())
            mend = "write the same `run: {container: ...}` at all of them, or name two containers"
            yield from InputError.of(f"components share the container `{group}`: {said}", mend=mend).faults
