#!/usr/bin/python3
"""Nodes that tests run, by the Python that has rospy: `talking.py talker|shouter|mute`."""

from __future__ import annotations

import sys

import rospy
from std_msgs.msg import String


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


def mute() -> None:
    sys.exit("has no voice")


if __name__ == "__main__":
    {"talker": talker, "shouter": shouter, "mute": mute}[sys.argv[1]]()
