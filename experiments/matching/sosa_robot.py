"""A robot's graph of ROS nodes, and the SOSA tags that a person gave its ports before cfgplan proposed any.

SOSA is not included in this project; download it from https://github.com/w3c/sdw-sosa-ssn.
"""

from __future__ import annotations

from cfgplan.ros.graph import Role, RosGraph, RosNode, RosPort
from cfgplan.ros.types import MessageType

_NODES = {
    "lidar": {"gives": {"scan": "sensor_msgs/LaserScan"}},
    "imu": {"gives": {"imu_data": "sensor_msgs/Imu"}},
    "camera": {"gives": {"image_raw": "sensor_msgs/Image"}},
    "thermometer": {"gives": {"temperature": "sensor_msgs/Temperature"}},
    "base": {"gives": {"odom": "nav_msgs/Odometry"}, "takes": {"cmd_vel": "geometry_msgs/Twist"}},
    "amcl": {
        "gives": {"amcl_pose": "geometry_msgs/PoseWithCovarianceStamped"},
        "takes": {"scan": "sensor_msgs/LaserScan", "odom": "nav_msgs/Odometry"},
    },
    "move_base": {
        "gives": {"cmd_vel": "geometry_msgs/Twist"},
        "takes": {"scan": "sensor_msgs/LaserScan", "amcl_pose": "geometry_msgs/PoseWithCovarianceStamped"},
    },
    "detector": {"gives": {"detections": "vision_msgs/Detection2DArray"}, "takes": {"image_raw": "sensor_msgs/Image"}},
    "stabiliser": {"takes": {"imu_data": "sensor_msgs/Imu", "image_raw": "sensor_msgs/Image"}},
    "fire_watch": {"takes": {"temperature": "sensor_msgs/Temperature"}},
}
THINGS = """
@prefix : <https://robot.example/#> .
@prefix sosa: <http://www.w3.org/ns/sosa/> .
@prefix owl: <http://www.w3.org/2002/07/owl#> .
<https://robot.example/> a owl:Ontology .
:lidar a owl:NamedIndividual , sosa:Sensor .
:imu a owl:NamedIndividual , sosa:Sensor .
:camera a owl:NamedIndividual , sosa:Sensor .
:thermometer a owl:NamedIndividual , sosa:Sensor .
:base a owl:NamedIndividual , sosa:Actuator .
:robot a owl:NamedIndividual , sosa:Platform , sosa:FeatureOfInterest .
:temperature a owl:NamedIndividual , sosa:ObservableProperty .
"""
_LIDAR, _IMU, _CAMERA = (f"Observation ⊓ ∃madeBySensor.{name}" for name in ("lidar", "imu", "camera"))
_DRIVING = "Actuation ⊓ ∃madeByActuator.base"
_PLACE = "Observation ⊓ ∃hasFeatureOfInterest.robot"
WRITTEN = {
    "lidar/scan": _LIDAR,
    "imu/imu_data": _IMU,
    "camera/image_raw": _CAMERA,
    "thermometer/temperature": "Observation ⊓ ∃madeBySensor.thermometer",
    "base/odom": _PLACE,
    "base/cmd_vel": _DRIVING,
    "amcl/amcl_pose": _PLACE,
    "amcl/scan": _LIDAR,
    "amcl/odom": _PLACE,
    "move_base/cmd_vel": _DRIVING,
    "move_base/scan": _LIDAR,
    "move_base/amcl_pose": _PLACE,
    "detector/detections": "Observation ⊓ ∃madeBySensor.camera",
    "detector/image_raw": _CAMERA,
    "stabiliser/imu_data": _IMU,
    "stabiliser/image_raw": _CAMERA,
    "fire_watch/temperature": "Observation ⊓ ∃observedProperty.{temperature}",
}
"""The tag of each port."""


def robot() -> RosGraph:
    """Return the robot's graph: its nodes, topics and message types."""
    roles = {"gives": Role.PUBLISHES, "takes": Role.SUBSCRIBES}
    return RosGraph(
        tuple(
            RosNode(
                f"/{name}",
                tuple(
                    RosPort(roles[role], f"/{topic}", MessageType.read(kind, "msg"))
                    for role, ports in said.items()
                    for topic, kind in ports.items()
                ),
            )
            for name, said in _NODES.items()
        ),
        ("sosa_robot.py",),
    )
