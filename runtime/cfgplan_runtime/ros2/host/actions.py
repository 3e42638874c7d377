"""Leads an action to the node that offers it now: its three services and two topics together.

A goal stays with the server that has accepted it: who cancels it or asks for its result reaches that one, and its
feedback comes from there. Goals of a server that has died end as aborted.
"""

from __future__ import annotations

from functools import partial
from typing import Any

from rclpy.qos import QoSProfile, qos_profile_action_status_default

from cfgplan_runtime.ros2.host.host import Host
from cfgplan_runtime.ros2.host.services import LedService

SEND_GOAL = "/_action/send_goal"
"""The suffix of an action's name in the name of the service that takes goals."""
GOAL_TYPE = "_SendGoal"
"""The suffix of an action's type in the type of this service."""
_CANCEL, _RESULT, _FEEDBACK, _STATUS = (
    f"/_action/{part}" for part in ("cancel_goal", "get_result", "feedback", "status")
)
_ABORTED = 6
"""The status of `action_msgs/msg/GoalStatus` of a goal that its server has ended."""
_DEAD_S = 1.0
"""Seconds between two checks for dead servers."""
_FEEDBACK_DEPTH = 100


class LedAction:
    """An action of class `kind` that clients know as `target`, and that `source` carries out."""

    def __init__(self, host: Host, target: str, kind: Any) -> None:
        self._host, parts = host, kind.Impl
        self._server_of: dict[bytes, str] = {}
        """The server of each goal that was accepted."""
        self._ready: set[str] = set()
        """The servers that were connected at the last look."""
        self._is_closed = False
        self.source = ""
        self._services = {
            SEND_GOAL: LedService(host, target + SEND_GOAL, parts.SendGoalService, answered=self._note_goal),
            _CANCEL: LedService(
                host, target + _CANCEL, parts.CancelGoalService, lambda of: self._routed(of.goal_info.goal_id, _CANCEL)
            ),
            _RESULT: LedService(
                host,
                target + _RESULT,
                parts.GetResultService,
                lambda of: self._routed(of.goal_id, _RESULT),
                self._forget,
            ),
        }
        self._result = parts.GetResultService
        self._topics = {
            _FEEDBACK: (kind.Impl.FeedbackMessage, QoSProfile(depth=_FEEDBACK_DEPTH)),
            _STATUS: (kind.Impl.GoalStatusMessage, qos_profile_action_status_default),
        }
        self._publishers = {
            part: host.node.create_publisher(message, target + part, quality)
            for part, (message, quality) in self._topics.items()
        }
        self._subscriptions: dict[tuple[str, str], Any] = {}
        """By server and part."""
        host.waiting.later(_DEAD_S, self._look)

    def lead(self, source: str) -> None:
        """Have another server take goals from now on."""
        self.source = source
        for part, service in self._services.items():
            service.lead(source + part)
        for part, (message, quality) in self._topics.items():
            if (source, part) not in self._subscriptions:
                heard = self._host.node.create_subscription(message, source + part, lambda _: None, quality, raw=True)
                self._subscriptions[source, part] = heard
                self._host.waiting.watch("subscription", heard.handle, partial(self._pass_on, heard, message, part))

    def close(self) -> None:
        self._is_closed = True
        for service in self._services.values():
            service.close()
        for heard in self._subscriptions.values():
            self._host.waiting.unwatch("subscription", heard.handle)
            self._host.node.destroy_subscription(heard)
        for publisher in self._publishers.values():
            self._host.node.destroy_publisher(publisher)

    def _note_goal(self, service: str, request: Any, response: Any) -> None:
        if response.accepted:
            self._server_of[bytes(request.goal_id.uuid)] = service.removesuffix(SEND_GOAL)

    def _routed(self, goal: Any, part: str) -> str | None:
        """The service of the server that has a goal; None if none has accepted it, as where all are cancelled."""
        server = self._server_of.get(bytes(goal.uuid))
        return None if server is None else server + part

    def _forget(self, _: str, request: Any, __: Any) -> None:
        self._server_of.pop(bytes(request.goal_id.uuid), None)

    def _pass_on(self, heard: Any, message: Any, part: str) -> None:
        taken = heard.handle.take_message(message, True)
        if taken is not None:
            self._publishers[part].publish(taken[0])

    def _look(self) -> None:
        """Give up the goals of servers that were there and are no more."""
        if self._is_closed:
            return
        self._host.waiting.later(_DEAD_S, self._look)
        results = self._services[_RESULT]
        ready = {server for server, part in self._subscriptions if results.is_ready(server + _RESULT)}
        for server in self._ready - ready:
            results.answer_all(server + _RESULT, self._result.Response(status=_ABORTED))
            self._server_of = {goal: other for goal, other in self._server_of.items() if other != server}
        self._ready = ready
