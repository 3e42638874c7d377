#!/usr/bin/env python3
"""Lifecycle nodes that tests run, by the Python that has rclpy: `managed_nodes.py NODE`.

The parameter of a transition (`configure`, `activate`, `deactivate`) says how it goes: `well`, `refuse`, `raise`,
`die`, or the seconds that it takes. Each transition is printed when it begins.
"""

from __future__ import annotations

import os
import sys
import time
from contextlib import suppress

import rclpy
from geometry_msgs.msg import PointStamped
from rclpy.lifecycle import LifecycleNode, LifecycleNodeMixin, State, TransitionCallbackReturn
from rclpy.qos import QoSProfile

TICKS_PER_S = 100
DEEP = QoSProfile(depth=1000)


def say(line: str) -> None:
    print(line, flush=True)  # noqa: T201


class Living(LifecycleNode):
    """Goes through its transitions as its parameters say."""

    def __init__(self, name: str) -> None:
        super().__init__(name)
        for transition in ("configure", "activate", "deactivate"):
            self.declare_parameter(transition, "well")
        time.sleep(float(self.declare_parameter("late", 0.0).value))

    def go(self, transition: str) -> TransitionCallbackReturn:
        say(transition)
        how = self.get_parameter(transition).value
        if how == "refuse":
            return TransitionCallbackReturn.FAILURE
        if how == "raise":
            raise RuntimeError("is not well")
        if how == "die":
            os._exit(3)
        time.sleep(0.0 if how == "well" else float(how))
        return TransitionCallbackReturn.SUCCESS

    def on_configure(self, state: State) -> TransitionCallbackReturn:
        went = self.go("configure")
        return super().on_configure(state) if went is TransitionCallbackReturn.SUCCESS else went

    def on_activate(self, state: State) -> TransitionCallbackReturn:
        went = self.go("activate")
        return super().on_activate(state) if went is TransitionCallbackReturn.SUCCESS else went

    def on_deactivate(self, state: State) -> TransitionCallbackReturn:
        went = self.go("deactivate")
        return super().on_deactivate(state) if went is TransitionCallbackReturn.SUCCESS else went


class Keeper(Living):
    """Numbers the hundredths of a second while it is active, each with its time: all such nodes give the same. Prints
    the first number.
    """

    def on_configure(self, state: State) -> TransitionCallbackReturn:
        self.ticks = self.create_lifecycle_publisher(PointStamped, "ticks", DEEP)
        return super().on_configure(state)

    def on_activate(self, state: State) -> TransitionCallbackReturn:
        went = super().on_activate(state)
        self.number = int(time.time() * TICKS_PER_S)
        if went is TransitionCallbackReturn.SUCCESS:
            say(f"first {self.number}")
            self.publish()
            self.create_timer(0.5 / TICKS_PER_S, self.tick)
        return went

    def tick(self) -> None:
        while time.time() * TICKS_PER_S >= self.number + 1:
            self.number += 1
            self.publish()

    def publish(self) -> None:
        tick = PointStamped()
        tick.header.frame_id = str(self.number)
        tick.header.stamp.sec, rest = divmod(self.number, TICKS_PER_S)
        tick.header.stamp.nanosec = rest * (10**9 // TICKS_PER_S)
        self.ticks.publish(tick)


class Stalled(Keeper):
    """Is a node for four seconds before it has its lifecycle."""

    def __init__(self, name: str) -> None:
        begin = LifecycleNodeMixin.__init__

        def begin_late(*args: object, **options: object) -> None:
            time.sleep(4.0)
            begin(*args, **options)

        LifecycleNodeMixin.__init__ = begin_late
        super().__init__(name)


class Hearer(Living):
    """Prints the first number that it gets, by a subscription that it makes when it is activated."""

    def on_activate(self, state: State) -> TransitionCallbackReturn:
        self.heard: list[str] = []
        self.create_subscription(PointStamped, "ticks", self.note, DEEP)
        return super().on_activate(state)

    def note(self, tick: PointStamped) -> None:
        if not self.heard:
            say(f"heard {tick.header.frame_id}")
        self.heard.append(tick.header.frame_id)


def main() -> None:
    rclpy.init()
    kinds = {"keeper": Keeper, "stalled": Stalled, "hearer": Hearer}
    node = kinds[sys.argv[1]](sys.argv[1])
    with suppress(KeyboardInterrupt, rclpy.executors.ExternalShutdownException):
        rclpy.spin(node)


if __name__ == "__main__":
    main()
