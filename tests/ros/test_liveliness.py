"""Liveliness tokens: what a running system said is read, and every token is written as it was read."""

from __future__ import annotations

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cfgplan.errors import InputError
from cfgplan.ros import EndpointToken, MessageType, NodeToken, Qos, all_tokens, read_token

STRING_HASH = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
"""Of std_msgs/msg/String, as ROS 2 Jazzy tells it."""
TALKER = NodeToken(domain=2, session="aac3178e146ba6f1fc6e6a4085e77f21", number=0, name="talker")
CHATTER = EndpointToken(
    TALKER, 10, "publisher", "/chatter", MessageType("std_msgs", "String"), STRING_HASH, Qos(depth=10)
)
NODE_TEXT = "@ros2_lv/2/aac3178e146ba6f1fc6e6a4085e77f21/0/0/NN/%/%/talker"
TEXT = (
    "@ros2_lv/2/aac3178e146ba6f1fc6e6a4085e77f21/0/10/MP/%/%/talker/%chatter/std_msgs::msg::dds_::String_/"
    f"{STRING_HASH}/::,10:,:,:,,"
)


@pytest.mark.parametrize(("text", "token"), [(NODE_TEXT, TALKER), (TEXT, CHATTER)])
def test_a_token_is_read_and_written(text: str, token: object) -> None:
    assert read_token(text) == token
    assert str(token) == text


def test_a_key_has_domain_topic_type_and_hash() -> None:
    assert CHATTER.key == f"2/chatter/std_msgs::msg::dds_::String_/{STRING_HASH}"


def test_a_namespace_stands_before_the_name() -> None:
    token = read_token("@ros2_lv/0/ab/1/1/NN/%sec/%lab%robot/camera")
    assert isinstance(token, NodeToken)
    assert (token.namespace, token.name, token.enclave) == ("/lab/robot", "camera", "/sec")


def test_a_service_keeps_its_kind_of_type() -> None:
    text = "@ros2_lv/0/ab/1/4/SS/%/%/adder/%add/example_interfaces::srv::dds_::AddTwoInts_/RIHS01_0/::,10:,:,:,,"
    token = read_token(text)
    assert isinstance(token, EndpointToken)
    assert (token.kind, token.type) == ("service", MessageType("example_interfaces", "AddTwoInts", "srv"))
    assert str(token) == text


def test_what_newer_versions_append_is_kept() -> None:
    token = read_token(f"{TEXT}/backends:cpu")
    assert isinstance(token, EndpointToken)
    assert token.more == ("backends:cpu",)
    assert str(token) == f"{TEXT}/backends:cpu"


def test_quality_of_service_that_is_left_out_is_that_of_rmw_zenoh() -> None:
    assert Qos.read("::,:,:,:,,") == Qos("reliable", "volatile", "keep_last", 42)
    assert str(Qos()) == "::,:,:,:,,"


def test_every_part_of_the_quality_of_service_is_read() -> None:
    qos = Qos.read("2:1:2,5:1,500:3,0:3,7,8")
    assert qos == Qos(
        "best_effort",
        "transient_local",
        "keep_all",
        5,
        1_000_000_500,
        3_000_000_000,
        "manual_by_topic",
        7_000_000_008,
    )


policies = st.builds(
    Qos,
    st.sampled_from(["system_default", "reliable", "best_effort", "unknown", "best_available"]),
    st.sampled_from(["system_default", "transient_local", "volatile", "unknown", "best_available"]),
    st.sampled_from(["system_default", "keep_last", "keep_all", "unknown"]),
    st.integers(0, 10**6),
    *[st.integers(0, 2**63 - 1)] * 2,
    st.sampled_from(["automatic", "manual_by_node", "manual_by_topic", "best_available"]),
    st.integers(0, 2**63 - 1),
)


@settings(suppress_health_check=[HealthCheck.too_slow], deadline=None)
@given(policies)
def test_every_quality_of_service_is_read_as_it_was_written(qos: Qos) -> None:
    assert Qos.read(str(qos)) == qos


@pytest.mark.parametrize(
    "text",
    [
        "",
        "0/chatter/std_msgs::msg::dds_::String_/RIHS01_0",
        "@ros2_lv/0/ab/1/1/NN/%/%",
        "@ros2_lv/0/ab/1/1/XX/%/%/talker",
        "@ros2_lv/zero/ab/1/1/NN/%/%/talker",
        "@ros2_lv/0/ab/1/1/NN/%//talker",
        "@ros2_lv/0/ab/1/10/MP/%/%/talker/%chatter",
        TEXT.replace("::,10:", ":10:"),
        TEXT.replace("::,10:", "9::,10:"),
        TEXT.replace("std_msgs::msg::dds_::String_", "EMPTY_TOPIC_TYPE"),
    ],
)
def test_what_is_no_token_is_refused(text: str) -> None:
    with pytest.raises(InputError):
        read_token(text)


def test_the_tokens_of_a_domain_are_below_its_number() -> None:
    assert TEXT.startswith(all_tokens(2).removesuffix("**"))
