"""Leads a lifecycle node to a state: configured, or active."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from cfgplan_runtime.ros2.host.host import Host

UNKNOWN, UNCONFIGURED, INACTIVE, ACTIVE = range(4)
"""States of `lifecycle_msgs/msg/State`."""
_TRANSITIONS = {
    (UNCONFIGURED, INACTIVE): (1, "configured"),
    (INACTIVE, ACTIVE): (3, "activated"),
    (ACTIVE, INACTIVE): (4, "deactivated"),
}
"""By the states before and after: a transition of `lifecycle_msgs/msg/Transition`, and its verb."""
_CHANGING = (UNKNOWN, *range(10, 16))
"""The states in which a node is during a transition."""
_FIRST_S, _AGAIN_S = 0.5, 5.0
"""Seconds after which a node that does not answer is asked for its state, at first and later. The first question may
have gone to a dead node of the same name, which stays in the graph for a while.
"""
_CHANGING_S = 0.1
"""Seconds after which a node that is in a transition is asked for its state again."""


class Lifecycle:
    """One node's life. `changed` is called when it has reached another `state`, or has refused to, with a `cause`.

    The node's answer about its state decides: it may refuse a late order because it has reached the state already.
    """

    def __init__(self, host: Host, name: str, changed: Callable[[], None]) -> None:
        from lifecycle_msgs.srv import ChangeState, GetState

        self.state, self.cause = UNKNOWN, ""
        self._host, self._changed = host, changed
        self._next: int | None = None
        """The state that a step under way leads to; UNKNOWN while the node is asked for its first state."""
        self._serial = 0
        self._orders: set[int] = set()
        """The numbers of the requests for the step under way."""
        self._questions: dict[int, bool] = {}
        """The numbers of the requests for the state, each with whether the node has refused the step before."""
        self._change = host.node.create_client(ChangeState, f"{name}/change_state")
        self._get = host.node.create_client(GetState, f"{name}/get_state")
        host.waiting.watch("client", self._change.handle, self._hear_change)
        host.waiting.watch("client", self._get.handle, self._hear_state)

    @property
    def is_changing(self) -> bool:
        """Whether a step is under way, which may lead away from `state`."""
        return self._next is not None

    def go(self, state: int) -> None:
        """Take the next step to a state, unless one is under way or the last one was refused."""
        is_ready = self._change.service_is_ready() and self._get.service_is_ready()
        if self._next is not None or self.cause or self.state == state or not is_ready:
            return
        self._serial += 1
        if self.state == UNKNOWN:
            self._next = UNKNOWN
            self._ask()
        else:
            self._next = self.state + (1 if self.state < state else -1)
            self._order()
        self._await_answer(self._serial)

    def close(self) -> None:
        self._end_step()
        for client in (self._change, self._get):
            self._host.waiting.unwatch("client", client.handle)
            self._host.node.destroy_client(client)

    def _order(self) -> None:
        assert self._next is not None
        request = self._change.srv_type.Request()
        request.transition.id, _ = _TRANSITIONS[self.state, self._next]
        self._orders.add(self._change.handle.send_request(request))

    def _ask(self, *, is_refused: bool = False) -> None:
        number = self._get.handle.send_request(self._get.srv_type.Request())
        self._questions[number] = is_refused

    def _hear_change(self) -> None:
        header, response = self._change.handle.take_response(self._change.srv_type.Response)
        if header is None or header.request_id.sequence_number not in self._orders:
            return
        assert self._next is not None
        if response.success:
            self._note(self._next)
        else:
            self._ask(is_refused=True)

    def _hear_state(self) -> None:
        header, response = self._get.handle.take_response(self._get.srv_type.Response)
        is_refused = None if header is None else self._questions.pop(header.request_id.sequence_number, None)
        if is_refused is None:
            return
        found, serial = response.current_state, self._serial
        if found.id in _CHANGING:
            self._host.waiting.later(_CHANGING_S, lambda: self._ask_again(serial, is_refused=is_refused))
        elif found.id == self.state and not is_refused:
            self._order()  # the order was lost
        elif (found.id in (INACTIVE, ACTIVE) and found.id != self.state) or (found.id, self.state) == (
            UNCONFIGURED,
            UNKNOWN,
        ):
            self._note(found.id)
        else:
            _, verb = _TRANSITIONS.get((self.state, self._next or INACTIVE), (0, "configured"))
            self.cause = f"could not be {verb}; its state is {found.label}"
            self._note(self.state)

    def _ask_again(self, serial: int, *, is_refused: bool) -> None:
        if self._next is not None and serial == self._serial:
            self._ask(is_refused=is_refused)

    def _await_answer(self, serial: int) -> None:
        def note_silence() -> None:
            if self._next is not None and serial == self._serial:
                self._ask()
                self._await_answer(serial)

        self._host.waiting.later(_FIRST_S if self.state == UNKNOWN else _AGAIN_S, note_silence)

    def _note(self, state: int) -> None:
        self._end_step()
        self.state = state
        self._changed()

    def _end_step(self) -> None:
        self._next = None
        self._orders.clear()
        self._questions.clear()
