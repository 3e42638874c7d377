#!/usr/bin/env python3
"""Nodes of which one tells topic statistics, by the Python that has rclpy: `ticking.py NODE`.

rclpy has no topic statistics of its own. The watcher tells those that nodes of rclcpp tell of a subscription, by the
same messages: each second the mean age and the mean period of what came, in milliseconds.
"""

from __future__ import annotations

import sys
from contextlib import suppress
from pathlib import Path
from statistics import fmean

import rclpy
from geometry_msgs.msg import PointStamped
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.time import Time
from statistics_msgs.msg import MetricsMessage, StatisticDataPoint, StatisticDataType
from std_msgs.msg import String

DEEP = QoSProfile(depth=100)


class Ticker(Node):
    """Publishes stamps that are as many seconds late as the file `lag` says; without one, of the present time."""

    def __init__(self) -> None:
        super().__init__("ticker")
        self.ticks = self.create_publisher(PointStamped, "ticks", DEEP)
        self.lag = Path(self.declare_parameter("lag", "").value)
        self.create_timer(0.02, self.tick)

    def tick(self) -> None:
        tick, lag = PointStamped(), float(self.lag.read_text() or 0.0) if self.lag.is_file() else 0.0
        tick.header.stamp = (self.get_clock().now() - Duration(seconds=lag)).to_msg()
        self.ticks.publish(tick)


class Watcher(Node):
    """Says a word for each stamp that comes, and tells statistics of them."""

    def __init__(self) -> None:
        super().__init__("watcher")
        self.words = self.create_publisher(String, "words", DEEP)
        self.statistics = self.create_publisher(MetricsMessage, "/statistics", QoSProfile(depth=10))
        self.ages_ms: list[float] = []
        self.came_ms: list[float] = []
        self.create_subscription(PointStamped, "ticks", self.hear, DEEP)
        self.create_timer(1.0, self.tell)

    def hear(self, tick: PointStamped) -> None:
        now = self.get_clock().now()
        self.ages_ms.append((now - Time.from_msg(tick.header.stamp)).nanoseconds / 1e6)
        self.came_ms.append(now.nanoseconds / 1e6)
        self.words.publish(String(data=tick.header.frame_id))

    def tell(self) -> None:
        periods = [after - before for before, after in zip(self.came_ms, self.came_ms[1:], strict=False)]
        for source, values in (("message_age", self.ages_ms), ("message_period", periods)):
            figures = {
                StatisticDataType.STATISTICS_DATA_TYPE_AVERAGE: fmean(values) if values else float("nan"),
                StatisticDataType.STATISTICS_DATA_TYPE_MAXIMUM: max(values, default=float("nan")),
                StatisticDataType.STATISTICS_DATA_TYPE_SAMPLE_COUNT: float(len(values)),
            }
            points = [StatisticDataPoint(data_type=kind, data=value) for kind, value in figures.items()]
            told = MetricsMessage(measurement_source_name=self.get_name(), metrics_source=source, unit="ms")
            told.statistics = points
            self.statistics.publish(told)
        self.ages_ms, self.came_ms = [], []


def main() -> None:
    rclpy.init()
    node = {"ticker": Ticker, "watcher": Watcher}[sys.argv[1]]()
    with suppress(KeyboardInterrupt, rclpy.executors.ExternalShutdownException):
        rclpy.spin(node)


if __name__ == "__main__":
    main()
