#!/usr/bin/python3
"""Nodes that tests run, by the Python that has rospy: `talking.py NODE`."""

from __future__ import annotations

import sys
import time
from pathlib import Path

import rospy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import PointStamped, PoseWithCovarianceStamped
from roscpp.msg import Logger
from roscpp.srv import GetLoggers, GetLoggersResponse
from sensor_msgs.msg import Image
from std_msgs.msg import String

TICKS_PER_S = 100


def talker() -> None:
    """Counts aloud, from `~first` on."""
    rospy.init_node("talker")
    words = rospy.Publisher("chatter", String, queue_size=100)
    rate, number = rospy.Rate(rospy.get_param("~rate")), rospy.get_param("~first", 0)
    while not rospy.is_shutdown():
        words.publish(str(number))
        number += 1
        rate.sleep()


def shouter() -> None:
    rospy.init_node("shouter")
    loud = rospy.Publisher("~loud", String, queue_size=100)
    rospy.Subscriber("quiet", String, lambda word: loud.publish(word.data + "!"))
    rospy.spin()


def clock() -> None:
    """Numbers the hundredths of a second, each with its time: all clocks tell the same."""
    rospy.init_node("clock")
    ticks = rospy.Publisher("ticks", PointStamped, queue_size=1000)
    number = int(time.time() * TICKS_PER_S)
    while not rospy.is_shutdown():
        number += 1
        time.sleep(max(0.0, number / TICKS_PER_S - time.time()))
        tick = PointStamped()
        tick.header.stamp = rospy.Time(number // TICKS_PER_S, number % TICKS_PER_S * (10**9 // TICKS_PER_S))
        tick.point.x = number
        ticks.publish(tick)


def mapper() -> None:
    """Says one thing once, `~first`, for whoever comes, however late."""
    rospy.init_node("mapper")
    rospy.Publisher("chatter", String, queue_size=1, latch=True).publish(str(rospy.get_param("~first")))
    rospy.spin()


def oracle() -> None:
    """Answers with its name, `~called`."""
    rospy.init_node("oracle")
    answer = GetLoggersResponse([Logger(rospy.get_param("~called"), "info")])
    rospy.Service("~ask", GetLoggers, lambda _: answer)
    rospy.spin()


def asker() -> None:
    """Asks again and again, and says who has answered."""
    rospy.init_node("asker")
    ask = rospy.ServiceProxy("oracle", GetLoggers)
    answers = rospy.Publisher("answers", String, queue_size=100)
    while not rospy.is_shutdown():
        try:
            answers.publish(ask().loggers[0].name)
        except rospy.ServiceException:
            answers.publish("nobody")
        rospy.sleep(0.02)


def finder() -> None:
    """Says where it is, with the variance that the file `~water` has; 0.3 without one."""
    rospy.init_node("finder")
    poses = rospy.Publisher("pose", PoseWithCovarianceStamped, queue_size=10)
    water = Path(rospy.get_param("~water", ""))
    while not rospy.is_shutdown():
        pose = PoseWithCovarianceStamped()
        pose.header.stamp = rospy.Time.now()
        pose.pose.covariance[0] = float(water.read_text() or 0.2) if water.is_file() else 0.3
        poses.publish(pose)
        rospy.sleep(0.02)


def doctor() -> None:
    """Tells the health of a pump, and beside it that of the thrusters as the file `~water` says it."""
    rospy.init_node("doctor")
    health = rospy.Publisher("/diagnostics", DiagnosticArray, queue_size=10)
    water = Path(rospy.get_param("~water"))
    while not rospy.is_shutdown():
        for name, key, value in (("pump", "volt", "11.5"), ("thrusters", "left", water.read_text() or "True")):
            values = [KeyValue(key="age", value="3"), KeyValue(key=key, value=value)]
            health.publish(DiagnosticArray(status=[DiagnosticStatus(name=name, values=values)]))
        rospy.sleep(0.05)


def camera() -> None:
    """Gives white pictures, `~size` pixels wide."""
    rospy.init_node("camera")
    pictures = rospy.Publisher("image_raw", Image, queue_size=10)
    size = rospy.get_param("~size")
    picture = Image(height=size, width=size, encoding="mono8", step=size, data=b"\xff" * size * size)
    while not rospy.is_shutdown():
        picture.header.stamp = rospy.Time.now()
        pictures.publish(picture)
        rospy.sleep(0.05)


def mute() -> None:
    sys.exit("has no voice")


def main() -> None:
    nodes = (talker, shouter, clock, mapper, oracle, asker, camera, finder, doctor, mute)
    {each.__name__: each for each in nodes}[sys.argv[1]]()


if __name__ == "__main__":
    main()
