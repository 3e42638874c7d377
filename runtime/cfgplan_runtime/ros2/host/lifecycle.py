"""Leads a lifecycle node to a state: configured, or active."""

from __future__ import annotations

from collections.abc import Callable

from cfgplan_runtime.ros2.host.host import Host

UNCONFIGURED, INACTIVE, ACTIVE = 1, 2, 3
"""States of `lifecycle_msgs/msg/State`."""
_CONFIGURE, _ACTIVATE = 1, 3
_AGAIN_S = 5.0
"""Seconds after which a node that does not answer is asked again: the first question may have gone to a dead one."""


class Lifecycle:
    """One node's life. `changed` is called when it has come to `state`, or when it has failed to, with a `cause`."""

    def __init__(self, host: Host, name: str, changed: Callable[[], None]) -> None:
        from lifecycle_msgs.srv import ChangeState, GetState

        self.state, self.cause = UNCONFIGURED, ""
        self._host, self._changed = host, changed
        self._is_waiting, self._serial = False, 0
        self._change = host.node.create_client(ChangeState, f"{name}/change_state")
        self._get = host.node.create_client(GetState, f"{name}/get_state")
        host.waiting.watch("client", self._change.handle, self._hear_change)
        host.waiting.watch("client", self._get.handle, self._hear_state)

    def go(self, state: int) -> None:
        """Take the next step to a state, unless one is under way or has failed."""
        if self._is_waiting or self.cause or self.state >= state or not self._change.service_is_ready():
            return
        self._is_waiting, self._serial = True, self._serial + 1
        request = self._change.srv_type.Request()
        request.transition.id = _CONFIGURE if self.state == UNCONFIGURED else _ACTIVATE
        self._change.handle.send_request(request)
        serial = self._serial
        self._host.waiting.later(_AGAIN_S, lambda: self._note_silence(serial))

    def close(self) -> None:
        for client in (self._change, self._get):
            self._host.waiting.unwatch("client", client.handle)
            self._host.node.destroy_client(client)

    def _hear_change(self) -> None:
        header, response = self._change.handle.take_response(self._change.srv_type.Response)
        if header is None or not self._is_waiting:
            return
        if response.success:
            self._note(self.state + 1)
        else:
            self._get.handle.send_request(self._get.srv_type.Request())

    def _hear_state(self) -> None:
        header, response = self._get.handle.take_response(self._get.srv_type.Response)
        if header is None or not self._is_waiting:
            return
        state = response.current_state
        if state.id not in (INACTIVE, ACTIVE) or state.id <= self.state:
            self.cause = f"can't be {'configured' if self.state == UNCONFIGURED else 'activated'}"
            self.cause += f": it is {state.label}"
            self._note(self.state)
        else:
            self._note(state.id)

    def _note(self, state: int) -> None:
        self.state, self._is_waiting = state, False
        self._changed()

    def _note_silence(self, serial: int) -> None:
        if self._is_waiting and serial == self._serial:
            self._is_waiting = False
            self._changed()
