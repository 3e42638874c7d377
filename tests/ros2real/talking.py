#!/usr/bin/env python3
"""Nodes that tests run, by the Python that has rclpy: `talking.py NODE`."""

from __future__ import annotations

import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import PointStamped, PoseWithCovarianceStamped
from rclpy.action import ActionClient, ActionServer, CancelResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.lifecycle import LifecycleNode, State, TransitionCallbackReturn
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import String
from std_srvs.srv import Trigger

TICKS_PER_S = 100
DEEP = QoSProfile(depth=1000)


class Talker(Node):
    """Counts aloud, from `first` on."""

    quality = DEEP

    def __init__(self) -> None:
        super().__init__("talker")
        self.number = self.declare_parameter("first", 0).value
        self.words = self.create_publisher(String, "chatter", self.quality)
        self.create_timer(1 / self.declare_parameter("rate", 100).value, self.talk)

    def talk(self) -> None:
        self.words.publish(String(data=str(self.number)))
        self.number += 1


class Whisperer(Talker):
    """Counts, and does not care who hears it."""

    quality = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)


class Shouter(Node):
    quality = DEEP

    def __init__(self) -> None:
        super().__init__("shouter")
        self.loud = self.create_publisher(String, "~/loud", DEEP)
        self.create_subscription(String, "quiet", self.shout, self.quality)

    def shout(self, word: String) -> None:
        self.loud.publish(String(data=word.data + "!"))


class Stubborn(Shouter):
    """Does not let itself be unloaded."""

    def __init__(self) -> None:
        super().__init__()
        self.declare_parameter("stays", True)


class Eager(Shouter):
    """Wants to hear what was said before it came, too."""

    quality = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Clock(Node):
    """Numbers the hundredths of a second, each with its time: all clocks tell the same.

    If it is `simulated`, stamps begin at 0 in the present hour and go ten times as fast.
    """

    def __init__(self) -> None:
        super().__init__("clock")
        self.ticks = self.create_publisher(PointStamped, "ticks", DEEP)
        self.is_simulated = self.declare_parameter("simulated", False).value
        self.number = int(time.time() * TICKS_PER_S)
        self.create_timer(0.5 / TICKS_PER_S, self.tick)

    def tick(self) -> None:
        while time.time() * TICKS_PER_S >= self.number + 1:
            self.number += 1
            tick = PointStamped()
            tick.header.frame_id = str(self.number)
            stamp = self.number % (3600 * TICKS_PER_S) * 10 if self.is_simulated else self.number
            tick.header.stamp.sec = stamp // TICKS_PER_S
            tick.header.stamp.nanosec = stamp % TICKS_PER_S * (10**9 // TICKS_PER_S)
            self.ticks.publish(tick)


class Mapper(Node):
    """Says one thing once, `first`, for whoever comes, however late."""

    def __init__(self) -> None:
        super().__init__("mapper")
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.maps = self.create_publisher(String, "chatter", latched)
        self.maps.publish(String(data=str(self.declare_parameter("first", 0).value)))


class Worker(LifecycleNode):
    """Shouts while it is active, by ports that it makes when it is configured. It is lame if `lame` is set."""

    def __init__(self) -> None:
        super().__init__("worker")
        self.declare_parameter("lame", False)

    def on_configure(self, state: State) -> TransitionCallbackReturn:
        if self.get_parameter("lame").value:
            return TransitionCallbackReturn.FAILURE
        self.loud = self.create_lifecycle_publisher(String, "~/loud", DEEP)
        self.create_subscription(String, "quiet", lambda word: self.loud.publish(String(data=word.data + "!")), DEEP)
        return super().on_configure(state)


class Oracle(Node):
    """Answers with its name, `called`."""

    def __init__(self) -> None:
        super().__init__("oracle")
        self.create_service(Trigger, "~/ask", self.answer)
        self.called = self.declare_parameter("called", "").value

    def answer(self, _: Trigger.Request, answer: Trigger.Response) -> Trigger.Response:
        answer.message = self.called
        return answer


class Asker(Node):
    """Asks again and again, and says who has answered."""

    def __init__(self) -> None:
        super().__init__("asker")
        self.answers = self.create_publisher(String, "answers", DEEP)
        self.client = self.create_client(Trigger, "oracle")
        self.create_timer(0.02, self.ask)

    def ask(self) -> None:
        if self.client.service_is_ready():
            call = self.client.call_async(Trigger.Request())
            call.add_done_callback(lambda call: self.answers.publish(String(data=call.result().message)))


class Counter(Node):
    """Counts to what it is asked for, a step each 20 ms, and begins at `first`; without end if that is 0."""

    def __init__(self) -> None:
        super().__init__("counter")
        from test_msgs.action import Fibonacci

        self.kind = Fibonacci
        self.first = self.declare_parameter("first", 0).value
        self.server = ActionServer(
            self,
            Fibonacci,
            "~/count",
            self.count,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
            callback_group=ReentrantCallbackGroup(),
        )

    async def count(self, goal: Any) -> Any:
        feedback, number = self.kind.Feedback(), 0
        while (number := number + 1) and (number <= goal.request.order or not goal.request.order):
            if goal.is_cancel_requested:
                goal.canceled()
                return self.kind.Result(sequence=feedback.sequence)
            feedback.sequence = [self.first, number]
            goal.publish_feedback(feedback)
            await self.tick()
        goal.succeed()
        return self.kind.Result(sequence=feedback.sequence)

    async def tick(self) -> None:
        passed: Any = rclpy.Future()
        timer = self.create_timer(0.02, lambda: passed.set_result(None))
        await passed
        self.destroy_timer(timer)


class Client(Node):
    """Has one count after the other done, and says what it hears: `goal`, `feedback`, and `result` with the status.

    It asks for `order` steps, and cancels after `patience` feedbacks if that is set.
    """

    def __init__(self) -> None:
        super().__init__("client")
        from test_msgs.action import Fibonacci

        self.kind = Fibonacci
        self.order = self.declare_parameter("order", 5).value
        self.patience = self.declare_parameter("patience", 0).value
        self.heard = self.create_publisher(String, "heard", DEEP)
        self.action = ActionClient(self, Fibonacci, "count")
        self.starting = self.create_timer(0.02, self.begin)
        self.feedbacks, self.goal = 0, None

    def begin(self) -> None:
        if self.action.server_is_ready():
            self.starting.cancel()
            self.feedbacks = 0
            sent = self.action.send_goal_async(self.kind.Goal(order=self.order), feedback_callback=self.note)
            sent.add_done_callback(self.follow)

    def note(self, message: Any) -> None:
        first, number = message.feedback.sequence
        self.feedbacks += 1
        self.heard.publish(String(data=f"feedback {first} {number}"))
        if self.feedbacks == self.patience and self.goal is not None:
            self.goal.cancel_goal_async()

    def follow(self, sent: Any) -> None:
        self.goal = sent.result()
        self.heard.publish(String(data=f"goal {self.goal.accepted}"))
        self.goal.get_result_async().add_done_callback(self.end)

    def end(self, got: Any) -> None:
        ended = got.result()
        self.heard.publish(String(data=f"result {ended.status} {' '.join(map(str, ended.result.sequence))}".strip()))
        self.starting.reset()


class Finder(Node):
    """Says where it is, with the variance that the file `water` has; 0.3 without one."""

    def __init__(self) -> None:
        super().__init__("finder")
        self.poses = self.create_publisher(PoseWithCovarianceStamped, "pose", DEEP)
        self.water = Path(self.declare_parameter("water", "").value)
        self.create_timer(0.02, self.find)

    def find(self) -> None:
        pose = PoseWithCovarianceStamped()
        pose.header.stamp, pose.header.frame_id = self.get_clock().now().to_msg(), "map"
        pose.pose.covariance[0] = float(self.water.read_text() or 0.2) if self.water.is_file() else 0.3
        self.poses.publish(pose)


class Diver(LifecycleNode):
    """Says where it is while it is active, with the variance 0.3."""

    def on_configure(self, state: State) -> TransitionCallbackReturn:
        self.poses = self.create_lifecycle_publisher(PoseWithCovarianceStamped, "pose", DEEP)
        self.create_timer(0.02, self.find)
        return super().on_configure(state)

    def find(self) -> None:
        pose = PoseWithCovarianceStamped()
        pose.pose.covariance[0] = 0.3
        self.poses.publish(pose)


class Doctor(Node):
    """Tells the health of a pump, and beside it that of the thrusters as the file `water` says it."""

    def __init__(self) -> None:
        super().__init__("doctor")
        self.health = self.create_publisher(DiagnosticArray, "/diagnostics", QoSProfile(depth=10))
        self.water = Path(self.declare_parameter("water", "").value)
        self.create_timer(0.05, self.tell)

    def tell(self) -> None:
        for name, key, value in (("pump", "volt", "11.5"), ("thrusters", "left", self.water.read_text() or "True")):
            values = [KeyValue(key="age", value="3"), KeyValue(key=key, value=value)]
            status = DiagnosticStatus(name=name, level=DiagnosticStatus.OK, values=values)
            self.health.publish(DiagnosticArray(status=[status]))


class Mute(Node):
    def __init__(self) -> None:
        sys.exit("has no voice")


def main() -> None:
    rclpy.init()
    kinds = (
        Talker,
        Whisperer,
        Shouter,
        Eager,
        Clock,
        Mapper,
        Worker,
        Oracle,
        Asker,
        Counter,
        Client,
        Finder,
        Doctor,
        Mute,
    )
    made = {each.__name__.lower(): each for each in kinds} | {"diver": lambda: Diver("diver")}
    node = made[sys.argv[1]]()
    with suppress(KeyboardInterrupt, rclpy.executors.ExternalShutdownException):
        rclpy.spin(node)


if __name__ == "__main__":
    main()
