"""The graph of other nodes as ROS tells of it: topics, services, actions, types, qualities of service, parameters."""

from __future__ import annotations

import array
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Any

import rclpy
from rcl_interfaces.srv import GetParameters, ListParameters
from rclpy.action import (
    get_action_client_names_and_types_by_node,
    get_action_server_names_and_types_by_node,
)
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import parameter_value_to_python
from rclpy.qos import DurabilityPolicy, LivelinessPolicy, ReliabilityPolicy

from cfgplan_runtime.ros2.host.host import Host

LEAST_S, QUIET_S, MOST_S = 2.0, 1.0, 10.0
"""A look takes at least so long, ends when nothing has changed for so long, and takes at most so long."""
_GLANCE_S = 0.05
_ANSWER_S = 2.0
"""Seconds in which nodes have to answer for their parameters."""
_INFINITE_S = 1e9


class GraphLook:
    """Answers the order `DescribeGraph` by one message `Graph`, once the graph no longer changes."""

    def __init__(self, host: Host) -> None:
        self._host, self._node = host, host.node
        host.handlers["DescribeGraph"] = lambda _: self._begin()

    def _begin(self) -> None:
        self._began = self._changed = time.monotonic()
        self._seen: Any = None
        self._look()

    def _look(self) -> None:
        now, seen = time.monotonic(), (self._nodes(), self._ends())
        if seen != self._seen:
            self._seen, self._changed = seen, now
        is_quiet = now - self._began >= LEAST_S and now - self._changed >= QUIET_S
        if not is_quiet and now - self._began < MOST_S:
            self._host.waiting.later(_GLANCE_S, self._look)
            return
        nodes, ends = seen
        silent = self._ask_parameters(nodes)
        self._host.say("Graph", nodes=nodes, ends=ends, silent=silent, is_at_rest=is_quiet)

    def _nodes(self) -> list[dict[str, Any]]:
        found = []
        for name, namespace, _ in sorted(self._node.get_node_names_and_namespaces_with_enclaves()):
            if name.startswith("_") or name == self._node.get_name():
                continue
            one: dict[str, Any] = {"name": f"{namespace.rstrip('/')}/{name}"}
            with suppress(RuntimeError):  # the node has just ended
                for key, ask in self._questions():
                    one[key] = [[topic, list(types)] for topic, types in ask(name, namespace)]
                found.append(one)
        return found

    def _questions(self) -> Iterator[tuple[str, Callable[[str, str], Any]]]:
        node = self._node
        yield "publishes", node.get_publisher_names_and_types_by_node
        yield "subscribes", node.get_subscriber_names_and_types_by_node
        yield "serves", node.get_service_names_and_types_by_node
        yield "calls", node.get_client_names_and_types_by_node
        yield "acts", lambda *of: get_action_server_names_and_types_by_node(node, *of)
        yield "wants", lambda *of: get_action_client_names_and_types_by_node(node, *of)

    def _ends(self) -> list[dict[str, Any]]:
        found = []
        for topic, _ in self._node.get_topic_names_and_types():
            publishers = self._node.get_publishers_info_by_topic(topic)
            subscriptions = self._node.get_subscriptions_info_by_topic(topic)
            for gives, infos in ((True, publishers), (False, subscriptions)):
                found += [_end(topic, gives, one) for one in infos if not one.node_name.startswith("_")]
        return sorted(found, key=lambda end: sorted(map(str, end.items())))

    def _ask_parameters(self, nodes: list[dict[str, Any]]) -> list[str]:
        """Add the parameters of each node; returns the nodes that do not answer."""
        executor = SingleThreadedExecutor(context=self._host.context)
        listed = self._ask(executor, {one["name"]: (ListParameters, "list_parameters", {}) for one in nodes})
        asked = {
            name: (GetParameters, "get_parameters", {"names": list(answer.result.names)})
            for name, answer in listed.items()
        }
        valued = self._ask(executor, asked)
        for one in nodes:
            answer = valued.get(one["name"])
            if answer is not None:
                names = listed[one["name"]].result.names
                values = map(parameter_value_to_python, answer.values)
                one["parameters"] = {name: _plain(value) for name, value in zip(names, values, strict=False)}
        executor.shutdown()
        return [one["name"] for one in nodes if "parameters" not in one]

    def _ask(self, executor: Any, questions: dict[str, tuple[Any, str, dict[str, Any]]]) -> dict[str, Any]:
        """The answers of nodes, all asked at once; those that give none in time are left out."""
        until = time.monotonic() + _ANSWER_S
        clients = {
            name: (self._node.create_client(kind, f"{name}/{service}"), kind.Request(**fields))
            for name, (kind, service, fields) in questions.items()
        }
        waiting = dict(clients)
        futures: dict[str, Any] = {}
        while time.monotonic() < until and (waiting or not all(one.done() for one in futures.values())):
            for name, (client, request) in [*waiting.items()]:
                if client.service_is_ready():
                    futures[name] = client.call_async(request)
                    del waiting[name]
            rclpy.spin_once(self._node, executor=executor, timeout_sec=_GLANCE_S)
        for client, _ in clients.values():
            self._node.destroy_client(client)
        return {name: one.result() for name, one in futures.items() if one.done() and one.result() is not None}


def _end(topic: str, gives: bool, info: Any) -> dict[str, Any]:
    qos = info.qos_profile
    return {
        "topic": topic,
        "gives": gives,
        "node": f"{info.node_namespace.rstrip('/')}/{info.node_name}",
        "message": info.topic_type,
        "definition": str(getattr(info, "topic_type_hash", "") or ""),
        "reliable": qos.reliability != ReliabilityPolicy.BEST_EFFORT,
        "transient_local": qos.durability == DurabilityPolicy.TRANSIENT_LOCAL,
        "deadline_s": _finite_s(qos.deadline),
        "lease_s": _finite_s(qos.liveliness_lease_duration),
        "manual": qos.liveliness == LivelinessPolicy.MANUAL_BY_TOPIC,
    }


def _finite_s(duration: Any) -> float | None:
    seconds = duration.nanoseconds / 1e9
    return seconds if 0 < seconds < _INFINITE_S else None


def _plain(value: Any) -> Any:
    """A parameter's value as JSON knows it."""
    if isinstance(value, bytes):
        return list(value)
    return [_plain(one) for one in value] if isinstance(value, list | tuple | array.array) else value
