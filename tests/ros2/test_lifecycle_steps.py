"""How the helper leads a lifecycle node from state to state, with a node that is there only in thought."""

from __future__ import annotations

import sys
from collections import deque
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest
from cfgplan_runtime.ros2.host.lifecycle import ACTIVE, INACTIVE, UNCONFIGURED, UNKNOWN, Lifecycle

CONFIGURE, ACTIVATE, DEACTIVATE, ACTIVATING = 1, 3, 4, 13
LABELS = {UNCONFIGURED: "unconfigured", INACTIVE: "inactive", ACTIVE: "active", ACTIVATING: "activating"}


class Client:
    """A client of a service: what was asked, in order, and the answers that have come."""

    def __init__(self, kind: SimpleNamespace) -> None:
        self.srv_type, self.handle = kind, self
        self.asked: list[Any] = []
        self.answers: deque[tuple[int, Any]] = deque()
        self.hear: Callable[[], None] = lambda: None

    def service_is_ready(self) -> bool:
        return True

    def send_request(self, request: Any) -> int:
        self.asked.append(request)
        return len(self.asked)

    def take_response(self, _: type) -> tuple[Any, Any]:
        number, response = self.answers.popleft()
        return SimpleNamespace(request_id=SimpleNamespace(sequence_number=number)), response

    def answer(self, number: int, response: Any) -> None:
        self.answers.append((number, response))
        self.hear()


class Led:
    """A lifecycle that is led, and the two services of its node."""

    def __init__(self) -> None:
        self.clients: dict[str, Client] = {}
        self.times: list[tuple[float, Callable[[], None]]] = []
        self.changes = 0
        node = SimpleNamespace(create_client=self._client)
        self.waits_s: list[float] = []
        waiting = SimpleNamespace(watch=self._watch, later=self._later)
        self.life = Lifecycle(SimpleNamespace(node=node, waiting=waiting), "/worker_1", self._note)  # type: ignore[arg-type]

    def _client(self, kind: SimpleNamespace, name: str) -> Client:
        return self.clients.setdefault(name.rpartition("/")[2], Client(kind))

    def _watch(self, _: str, client: Client, hear: Callable[[], None]) -> None:
        client.hear = hear

    def _later(self, seconds: float, call: Callable[[], None]) -> None:
        self.times.append((seconds, call))
        self.waits_s.append(seconds)

    def _note(self) -> None:
        self.changes += 1

    @property
    def orders(self) -> list[int]:
        """The transitions that the node was told to make."""
        return [request.transition.id for request in self.clients["change_state"].asked]

    @property
    def questions(self) -> int:
        return len(self.clients["get_state"].asked)

    def done(self, order: int, *, success: bool = True) -> None:
        self.clients["change_state"].answer(order, SimpleNamespace(success=success))

    def says(self, state: int) -> None:
        """Answer the last question about the state."""
        found = SimpleNamespace(id=state, label=LABELS[state])
        self.clients["get_state"].answer(self.questions, SimpleNamespace(current_state=found))

    def pass_time(self) -> None:
        """Let all that is due later happen."""
        due, self.times = self.times, []
        for _, call in due:
            call()


@pytest.fixture(autouse=True)
def services(monkeypatch: pytest.MonkeyPatch) -> None:
    """The module of both services: rclpy is not installed here."""

    def request() -> SimpleNamespace:
        return SimpleNamespace(transition=SimpleNamespace(id=0))

    kind = SimpleNamespace(Request=request, Response=SimpleNamespace)
    monkeypatch.setitem(sys.modules, "lifecycle_msgs", SimpleNamespace())
    monkeypatch.setitem(sys.modules, "lifecycle_msgs.srv", SimpleNamespace(ChangeState=kind, GetState=kind))


@pytest.fixture
def configured() -> Led:
    """One that is configured."""
    led = Led()
    led.life.go(INACTIVE)
    led.says(UNCONFIGURED)
    led.life.go(INACTIVE)
    led.done(1)
    assert (led.life.state, led.orders) == (INACTIVE, [CONFIGURE])
    return led


def test_a_node_is_asked_for_its_state_then_led_up_and_down_step_by_step(configured: Led) -> None:
    configured.life.go(ACTIVE)
    configured.life.go(ACTIVE)
    configured.done(2)
    configured.life.go(INACTIVE)
    configured.done(3)
    configured.life.go(INACTIVE)
    assert configured.orders == [CONFIGURE, ACTIVATE, DEACTIVATE]
    assert (configured.life.state, configured.changes) == (INACTIVE, 4)


def test_a_node_that_is_active_already_is_told_nothing() -> None:
    led = Led()
    led.life.go(ACTIVE)
    assert led.life.state == UNKNOWN
    led.says(ACTIVE)
    led.life.go(ACTIVE)
    assert (led.life.state, led.orders) == (ACTIVE, [])


def test_a_first_question_that_a_dead_node_of_that_name_has_got_is_soon_repeated() -> None:
    led = Led()
    led.life.go(INACTIVE)
    led.pass_time()
    led.pass_time()
    assert led.questions == 3
    led.says(UNCONFIGURED)
    led.life.go(INACTIVE)
    led.done(1)
    assert (led.life.state, led.orders) == (INACTIVE, [CONFIGURE])
    (first, *_, last) = led.waits_s
    assert first < 1 < last


def test_a_refusal_of_an_order_that_was_repeated_does_not_end_the_next_step() -> None:
    """The node is slow: it says that it is not configured before it takes the order, and then takes it twice."""
    led = Led()
    led.life.go(INACTIVE)
    led.says(UNCONFIGURED)
    led.life.go(INACTIVE)
    led.pass_time()
    led.says(UNCONFIGURED)
    assert led.orders == [CONFIGURE, CONFIGURE]
    led.done(1)
    led.life.go(ACTIVE)
    led.done(2, success=False)
    assert led.questions == 2
    led.done(3)
    assert (led.life.state, led.life.cause) == (ACTIVE, "")


def test_a_node_in_a_transition_is_asked_again_until_that_is_over(configured: Led) -> None:
    configured.life.go(ACTIVE)
    configured.done(2, success=False)
    configured.says(ACTIVATING)
    asked = configured.questions
    configured.pass_time()
    assert configured.questions > asked
    configured.says(ACTIVE)
    assert (configured.life.state, configured.life.cause) == (ACTIVE, "")


@pytest.mark.parametrize("state", [UNCONFIGURED, INACTIVE])
def test_a_refusal_has_the_state_as_its_cause_and_ends_the_way(state: int, configured: Led) -> None:
    configured.life.go(ACTIVE)
    configured.done(2, success=False)
    configured.says(state)
    assert configured.life.cause == f"could not be activated; its state is {LABELS[state]}"
    configured.life.go(ACTIVE)
    configured.pass_time()
    assert configured.orders == [CONFIGURE, ACTIVATE]
