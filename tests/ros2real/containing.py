#!/usr/bin/env python3
"""A component container in rclpy, for tests: answers the services of rclcpp's container with the nodes of talking.py.

No rclcpp is to be had for tests. It refuses the plugin `talking::Mute`, and to unload a node whose parameter `stays`
is set.
"""

from __future__ import annotations

import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

import rclpy
from composition_interfaces.srv import ListNodes, LoadNode, UnloadNode
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter

sys.path.append(str(Path(__file__).resolve().parent))

import talking


class Container(Node):
    """Loads and unloads nodes, which run in its own process."""

    def __init__(self, executor: SingleThreadedExecutor) -> None:
        super().__init__("container")
        self.own_executor = executor
        self.loaded: dict[int, Node] = {}
        self.number = 0
        self.create_service(LoadNode, "~/_container/load_node", self.load)
        self.create_service(UnloadNode, "~/_container/unload_node", self.unload)
        self.create_service(ListNodes, "~/_container/list_nodes", self.list)

    def load(self, wanted: LoadNode.Request, answer: LoadNode.Response) -> LoadNode.Response:
        if wanted.plugin_name == "talking::Mute":
            answer.error_message = f"{wanted.package_name} has no {wanted.plugin_name}"
            return answer
        node = made(getattr(talking, wanted.plugin_name.rpartition("::")[2]), wanted)
        self.number += 1
        self.loaded[self.number] = node
        self.own_executor.add_node(node)
        answer.success, answer.unique_id = True, self.number
        answer.full_node_name = node.get_fully_qualified_name()
        print(f"loaded {answer.full_node_name}", flush=True)  # noqa: T201
        return answer

    def unload(self, wanted: UnloadNode.Request, answer: UnloadNode.Response) -> UnloadNode.Response:
        node = self.loaded.get(wanted.unique_id)
        if node is None or (node.has_parameter("stays") and node.get_parameter("stays").value):
            answer.error_message = "it stays"
            return answer
        del self.loaded[wanted.unique_id]
        self.own_executor.remove_node(node)
        print(f"unloaded {node.get_fully_qualified_name()}", flush=True)  # noqa: T201
        node.destroy_node()
        answer.success = True
        return answer

    def list(self, _: ListNodes.Request, answer: ListNodes.Response) -> ListNodes.Response:
        answer.full_node_names = [node.get_fully_qualified_name() for node in self.loaded.values()]
        answer.unique_ids = list(self.loaded)
        return answer


def made(kind: type[Node], wanted: LoadNode.Request) -> Node:
    """A node of a class with the names, remappings and parameters that a request says."""
    named = {"__node": wanted.node_name, "__ns": wanted.node_namespace}
    rules = [*(f"{own}:={other}" for own, other in named.items() if other), *wanted.remap_rules]
    words = ["--ros-args", *(word for rule in rules for word in ("-r", rule))]
    given = [Parameter.from_parameter_msg(one) for one in wanted.parameters]
    begin = Node.__init__

    def begin_as_told(self: Any, *args: Any, **options: Any) -> None:
        begin(self, *args, **options, cli_args=words, parameter_overrides=given, use_global_arguments=False)

    Node.__init__ = begin_as_told
    try:
        return kind()
    finally:
        Node.__init__ = begin


def main() -> None:
    """Run a container until it is told to end."""
    rclpy.init()
    executor = SingleThreadedExecutor()
    executor.add_node(Container(executor))
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        executor.spin()


if __name__ == "__main__":
    main()
