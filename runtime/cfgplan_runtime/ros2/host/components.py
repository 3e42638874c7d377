"""Loads components into containers and unloads them, by the services of `composition_interfaces`.

A dead container stays in the graph for a while with its services, and the next one of its name may not answer yet. So a
container is asked for its components first; after its answer it is told to load a component, once.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any

from cfgplan_runtime.ros2.host.endpoints import UnknownTypeError, message_class
from cfgplan_runtime.ros2.host.host import Host

_SERVICES = {"list_nodes": "ListNodes", "load_node": "LoadNode", "unload_node": "UnloadNode"}
_ASK_AGAIN_S = 0.2
"""Seconds from one question to a container that does not answer to the next."""
_START_S = 30.0
"""Seconds that a container may take to answer, and then to load a component: its constructor is part of that."""
_UNLOAD_S = 3.0
"""Seconds after which a component that is not unloaded takes its container along (rclcpp issue 1866)."""
_GRAPH_S = 4.0
"""Seconds that the graph takes to tell of the containers of others."""
_FOUND_S = 1.0
"""Seconds that a container which somebody else runs may take to answer."""


class Container:
    """The clients of one container's services. Raises UnknownTypeError."""

    def __init__(self, host: Host, name: str) -> None:
        self._host, self.name = host, name
        self._clients: dict[str, Any] = {}
        self._answers: dict[tuple[str, int], Callable[[Any], None]] = {}
        kinds = {service: message_class(f"composition_interfaces/srv/{kind}") for service, kind in _SERVICES.items()}
        for service, kind in kinds.items():
            client = self._clients[service] = host.node.create_client(kind, f"{name}/_container/{service}")
            host.waiting.watch("client", client.handle, partial(self._hear, service))

    def ask(self, service: str, answered: Callable[[Any], None], **fields: object) -> None:
        """Call a service; `answered` is called with the response, if one comes."""
        client = self._clients[service]
        if client.service_is_ready():
            number = client.handle.send_request(client.srv_type.Request(**fields))
            self._answers[service, number] = answered

    def close(self) -> None:
        self._answers.clear()
        for client in self._clients.values():
            self._host.waiting.unwatch("client", client.handle)
            self._host.node.destroy_client(client)

    def _hear(self, service: str) -> None:
        client = self._clients[service]
        header, response = client.handle.take_response(client.srv_type.Response)
        if header is not None:
            answered = self._answers.pop((service, header.request_id.sequence_number), None)
            if answered is not None:
                answered(response)


class Components:
    """All containers of a run, and the components that are on their way into them or out of them."""

    def __init__(self, host: Host) -> None:
        self._host = host
        self._begun_s = time.monotonic()
        self._containers: dict[str, Container] = {}
        self._under_way: dict[str, dict[str, Any]] = {}
        """The orders to load or unload that have no answer yet, by unit."""
        host.handlers.update(
            Load=self._load, Unload=self._unload, LookForContainer=self._look_for, EndContainer=self._end
        )

    def _container(self, name: str) -> Container:
        if name not in self._containers:
            self._containers[name] = Container(self._host, name)
        return self._containers[name]

    def _end(self, order: dict[str, Any]) -> None:
        container = self._containers.pop(order["container"], None)
        if container is not None:
            container.close()
        self._under_way = {unit: one for unit, one in self._under_way.items() if one["container"] != order["container"]}

    # Whether a container is there.

    def _look_for(self, order: dict[str, Any]) -> None:
        """Tell whether a foreign container has this name."""
        name = order["container"]
        services = {service for service, _ in self._host.node.get_service_names_and_types()}
        if f"{name}/_container/load_node" in services:
            self._ask_whether_there(name)
        elif time.monotonic() - self._begun_s < _GRAPH_S:
            self._host.waiting.later(_ASK_AGAIN_S, lambda: self._look_for(order))
        else:
            self._host.say("ContainerFound", container=name, is_there=False)

    def _ask_whether_there(self, name: str) -> None:
        try:
            container = self._container(name)
        except UnknownTypeError:
            self._host.say("ContainerFound", container=name, is_there=False)
            return
        until, told = time.monotonic() + _FOUND_S, False

        def tell(*, is_there: bool) -> None:
            nonlocal told
            if not told:
                told = True
                self._host.say("ContainerFound", container=name, is_there=is_there)

        def look() -> None:
            if told:
                return
            if time.monotonic() > until:
                tell(is_there=False)
                return
            container.ask("list_nodes", lambda _: tell(is_there=True))
            self._host.waiting.later(_ASK_AGAIN_S, look)

        look()

    # Loading.

    def _load(self, order: dict[str, Any]) -> None:
        self._under_way[order["unit"]] = order
        try:
            container = self._container(order["container"])
        except UnknownTypeError as error:
            self._fail(order, f"can't be loaded: {error}")
            return
        self._load_once_there(order, container, time.monotonic() + _START_S)

    def _load_once_there(self, order: dict[str, Any], container: Container, until: float) -> None:
        """Ask a container for its components until it answers."""
        if not self._is_under_way(order) or order.get("is_sent"):
            return
        if time.monotonic() > until:
            self._fail(order, f"can't be loaded: the container {container.name} does not answer")
            return
        container.ask("list_nodes", lambda held: self._send(order, container, held))
        self._host.waiting.later(_ASK_AGAIN_S, lambda: self._load_once_there(order, container, until))

    def _send(self, order: dict[str, Any], container: Container, held: Any) -> None:
        """Have a component loaded, unless the container holds it: the helper may be a new one."""
        if not self._is_under_way(order) or order.get("is_sent"):
            return
        order["is_sent"] = True
        name = f"{order['namespace'].rstrip('/')}/{order['node']}"
        if name in held.full_node_names:
            self._note_loaded(order, held.unique_ids[held.full_node_names.index(name)])
            return
        container.ask(
            "load_node",
            lambda response: self._note_load(order, response),
            package_name=order["package"],
            plugin_name=order["plugin"],
            node_name=order["node"],
            node_namespace=order["namespace"],
            remap_rules=order["remaps"],
            parameters=_parameters(order["parameters"]),
        )
        late = f"can't be loaded: its constructor has taken {_START_S:g} s"
        self._host.waiting.later(_START_S, lambda: self._fail(order, late))

    def _note_load(self, order: dict[str, Any], response: Any) -> None:
        if response.success:
            self._note_loaded(order, response.unique_id)
        else:
            said = f": {response.error_message}" if response.error_message else ": see what its container printed"
            self._fail(order, f"can't be loaded{said}")

    def _note_loaded(self, order: dict[str, Any], number: int) -> None:
        if self._is_under_way(order):
            del self._under_way[order["unit"]]
            self._host.say("Loaded", unit=order["unit"], number=number)

    def _fail(self, order: dict[str, Any], cause: str) -> None:
        if self._is_under_way(order):
            del self._under_way[order["unit"]]
            self._host.say("Failed", unit=order["unit"], cause=f"{order['plugin']} {cause}")

    def _is_under_way(self, order: dict[str, Any]) -> bool:
        return self._under_way.get(order["unit"]) is order

    # Unloading.

    def _unload(self, order: dict[str, Any]) -> None:
        self._under_way[order["unit"]] = order
        container = self._container(order["container"])
        container.ask(
            "unload_node",
            lambda response: self._note_unload(order, is_done=response.success),
            unique_id=order["number"],
        )
        self._host.waiting.later(_UNLOAD_S, lambda: self._note_unload(order, is_done=False))

    def _note_unload(self, order: dict[str, Any], *, is_done: bool) -> None:
        if self._is_under_way(order):
            del self._under_way[order["unit"]]
            self._host.say("Unloaded", unit=order["unit"], is_done=is_done)


def _parameters(values: dict[str, Any], prefix: str = "") -> list[Any]:
    """Parameters as messages; those of a mapping have its name and a dot before theirs."""
    from rclpy.parameter import Parameter

    found: list[Any] = []
    for name, value in values.items():
        if isinstance(value, dict):
            found += _parameters(value, f"{prefix}{name}.")
        else:
            found.append(Parameter(f"{prefix}{name}", value=value).to_parameter_msg())
    return found
