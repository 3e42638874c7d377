"""Message types: every spelling is one value, and each is written in three."""

from __future__ import annotations

import pytest

from cfgplan.errors import InputError
from cfgplan.ros.types import MessageType

ODOMETRY = MessageType("nav_msgs", "Odometry")


@pytest.mark.parametrize(
    "text",
    [
        "nav_msgs/Odometry",
        "nav_msgs/msg/Odometry",
        "nav_msgs::msg::dds_::Odometry_",
        "nav_msgs::msg::Odometry",
        "nav_msgs::Odometry",
        "nav_msgs.msg.Odometry",
        " nav_msgs/Odometry\n",
    ],
)
def test_every_spelling_is_one_type(text: str) -> None:
    assert MessageType.read(text) == ODOMETRY


def test_a_type_is_written_in_three_spellings_and_each_is_read_back() -> None:
    written = (ODOMETRY.ros1, ODOMETRY.ros2, ODOMETRY.dds)
    assert written == ("nav_msgs/Odometry", "nav_msgs/msg/Odometry", "nav_msgs::msg::dds_::Odometry_")
    assert {MessageType.read(text) for text in written} == {ODOMETRY}
    assert str(ODOMETRY) == "nav_msgs/msg/Odometry"


def test_a_service_and_a_message_of_one_name_are_two_types() -> None:
    service = MessageType.read("std_srvs::srv::dds_::SetBool_")
    assert service == MessageType("std_srvs", "SetBool", "srv")
    assert service != MessageType("std_srvs", "SetBool")


def test_ros_1_names_no_kind_so_the_reader_does() -> None:
    assert MessageType.read("std_srvs/SetBool", "srv").ros2 == "std_srvs/srv/SetBool"
    assert MessageType.read("std_srvs/msg/SetBool", "srv").kind == "msg"


def test_only_dds_ends_names_with_an_underscore() -> None:
    assert MessageType.read("a/B_").name == "B_"
    assert MessageType.read("a::msg::dds_::B__").name == "B_"


@pytest.mark.parametrize("text", ["", "*", "Odometry", "nav_msgs/", "/Odometry", "a/b/C", "a::msg/B", "a/msg/", "é/B"])
def test_what_is_no_type_is_refused_with_a_mend(text: str) -> None:
    with pytest.raises(InputError, match="is not a message type") as raised:
        MessageType.read(text)
    assert raised.value.faults[0].mend == "write it as package/Name or package/msg/Name"
