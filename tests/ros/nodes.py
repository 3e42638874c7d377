"""Nodes for a live ROS 1 graph, run by the Python that has rospy: `nodes.py lidar|planner`."""

from __future__ import annotations

import sys

import rospy
from roscpp.srv import Empty
from std_msgs.msg import Float64, String


def lidar() -> None:
    rospy.init_node("lidar")
    rospy.Publisher("scan", Float64, queue_size=1)
    rospy.Service("~reset", Empty, lambda _: None)


def planner() -> None:
    rospy.init_node("planner")
    rospy.Subscriber("scan", Float64)
    rospy.Subscriber("map", String)
    rospy.Publisher("way", String, queue_size=1)


{"lidar": lidar, "planner": planner}[sys.argv[1]]()
rospy.spin()
