"""The component containers of a run: their processes, and the container of each unit.

A unit without a group has a container of its own, which starts and ends with it. Units of one group share a container
and its fate. A container that the run has started stays when it is empty: the next component then needs no participant
of its own. A foreign container of the name is used if it runs.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import msgspec

from cfgplan.errors import InputError
from cfgplan_runtime.children.exit_status import clause_of
from cfgplan_runtime.nodes.node_process import NodeProcess
from cfgplan_runtime.nodes.shared_process import SharedProcess
from cfgplan_runtime.nodes.watched_processes import NOT_OURS, WatchedProcesses
from cfgplan_runtime.ros2.host_messages import EndContainer, Load, LookForContainer, Unload
from cfgplan_runtime.ros2.ros2_unit import Ros2Unit
from cfgplan_runtime.supervision import events
from cfgplan_runtime.supervision.backend import Usage


@dataclass(eq=False)
class _Component:
    """A unit's component. `number` is its container's number for it, once it is loaded."""

    unit: str
    ros: Ros2Unit
    number: int | None = None
    is_leaving: bool = False


@dataclass(eq=False)
class _Container:
    """A container by its full name. `is_there` is true once it has been started or found."""

    name: str
    is_private: bool
    shared: SharedProcess = field(default_factory=SharedProcess)
    is_there: bool = False


class Containers:
    """All containers of a run.

    `tell` sends an order to the helper, `start` starts a container's process, and `lose` is called with a unit that has
    ended and the cause.
    """

    def __init__(
        self,
        tell: Callable[[msgspec.Struct], None],
        start: Callable[[str, list[str]], NodeProcess],
        processes: WatchedProcesses,
        lose: Callable[[str, str, events.End], None],
    ) -> None:
        self._tell, self._start, self._processes, self._lose = tell, start, processes, lose
        self._containers: dict[str, _Container] = {}
        self._components: dict[str, _Component] = {}
        self._own: set[str] = set()
        """The names of containers that the run has started."""

    def __contains__(self, unit: str) -> bool:
        return unit in self._components

    def is_loaded(self, unit: str) -> bool:
        return self._components[unit].number is not None

    def add(self, unit: str, ros: Ros2Unit) -> None:
        """Load a unit's component into its container, and start the container first if it does not run.

        Raises InputError or OSError if the container can't be started; a shared one may fail later.
        """
        component = _Component(unit, ros)
        container = self._containers.get(_container_of(ros))
        if container is None:
            container = _Container(_container_of(ros), not ros.source.group)
            if container.is_private or container.name in self._own:
                self._begin(container, ros)
            else:
                self._tell(LookForContainer(container.name))
            self._containers[container.name] = container
        self._components[unit] = component
        container.shared.add(unit)
        if container.is_there:
            self._load(component)

    def stop(self, unit: str) -> None:
        """Unload a unit's component; ask a container of its own to end."""
        component = self._components[unit]
        container = self._of(component)
        if container.is_private and container.shared.process is not None:
            container.shared.process.interrupt()
        elif not container.is_there:
            self._lose(unit, NOT_OURS, "was given up")
        elif not component.is_leaving:
            component.is_leaving = True
            self._unload(component)

    def kill(self, unit: str) -> None:
        """Unload a unit's component. If it is not loaded yet, or can't be unloaded, its container is ended."""
        component = self._components[unit]
        container = self._of(component)
        is_stuck = component.number is None or component.is_leaving
        if container.shared.process is not None and (container.is_private or is_stuck):
            self._end(container)
        elif is_stuck:
            self._lose(unit, NOT_OURS, "was given up")
        else:
            self.stop(unit)

    def remove(self, unit: str) -> None:
        """Forget a unit that has ended. An empty container stays if the run has started it for a group."""
        component = self._components.pop(unit)
        container = self._containers.get(_container_of(component.ros))
        if container is None:
            return
        container.shared.remove(unit)
        if not container.shared and (container.is_private or container.shared.process is None):
            self._end(container)

    def usage(self, unit: str) -> Usage | None:
        """A unit's share of its container's usage."""
        return self._of(self._components[unit]).shared.usage(unit)

    def process(self, unit: str) -> NodeProcess | None:
        """The process that a unit is in; None in a foreign container."""
        return self._of(self._components[unit]).shared.process

    def note_found(self, name: str, *, is_there: bool) -> None:
        """Load the components that wait for a container; start it first if it was not found."""
        container = self._containers.get(name)
        if container is None or container.is_there:
            return
        units = list(container.shared)
        try:
            if is_there:
                container.is_there = True
            else:
                self._begin(container, self._components[units[0]].ros)
        except (InputError, OSError) as error:
            for unit in units:
                self._lose(unit, f"its container can't be started: {error}", "could not start")
            return
        for unit in units:
            self._load(self._components[unit])

    def note_loaded(self, unit: str, number: int) -> None:
        if unit in self._components:
            component = self._components[unit]
            component.number = number
            if component.is_leaving:
                self._unload(component)

    def note_unloaded(self, unit: str, *, is_done: bool) -> None:
        """End a container that has failed to unload a component; a foreign one keeps running."""
        if unit not in self._components:
            return
        container = self._of(self._components[unit])
        if is_done or container.shared.process is None:
            if is_done:
                self._lose(unit, "it was unloaded", "died")
            else:
                self._lose(unit, f"{container.name} does not unload it", "was given up")
        else:
            self._end(container)

    def tell_again(self, unit: str) -> None:
        """Repeat the orders for a unit to a new helper."""
        component = self._components[unit]
        container = self._of(component)
        if not container.is_there:
            self._tell(LookForContainer(container.name))
        elif component.number is None:
            self._load(component)
        elif component.is_leaving:
            self._unload(component)

    def close(self) -> None:
        """End all containers of the run."""
        for container in list(self._containers.values()):
            self._end(container)

    def _of(self, component: _Component) -> _Container:
        return self._containers[_container_of(component.ros)]

    def _begin(self, container: _Container, ros: Ros2Unit) -> None:
        """Start a container's process. Raises InputError and OSError."""
        namespace, _, own = container.name.rpartition("/")
        names = ["-r", f"__node:={own}", "-r", f"__ns:={namespace or '/'}"]
        command = [ros.program(Path()), "--ros-args", *names]
        process = self._start(container.name, command)
        container.shared.process, container.is_there = process, True
        self._own.add(container.name)
        self._processes.attend(process, lambda: self._end(container), lambda: container.shared.last)

    def _end(self, container: _Container) -> None:
        """End a container of the run with all its components. A foreign container keeps running."""
        if self._containers.get(container.name) is not container:
            return
        how: events.End = "was given up"
        units, cause = list(container.shared), NOT_OURS
        if container.shared.process is not None:
            end, how = self._processes.last_words(container.shared.process, container.shared.last), "died"
            cause = end if container.is_private else f"it was in the container {container.name}, which {clause_of(end)}"
        del self._containers[container.name]
        self._tell(EndContainer(container.name))
        for unit in units:
            self._lose(unit, cause, how)

    def _load(self, component: _Component) -> None:
        ros = component.ros
        namespace, _, node = ros.name.rpartition("/")
        source, params = ros.source, ros.parameters
        remaps = [*(f"{own}:={topic}" for own, topic in ros.remappings.items()), *source.arguments]
        name = _container_of(ros)
        self._tell(Load(component.unit, name, source.package, source.name, node, namespace or "/", remaps, params))

    def _unload(self, component: _Component) -> None:
        """Unload a component, once it is loaded."""
        if component.number is not None:
            self._tell(Unload(component.unit, _container_of(component.ros), component.number))


def _container_of(ros: Ros2Unit) -> str:
    """The full name of a component's container: that of its group, or one made of the node's."""
    group = ros.source.group
    return f"/{group.lstrip('/')}" if group else f"{ros.name}_container"
