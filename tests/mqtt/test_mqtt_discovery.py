"""What Home Assistant's discovery messages say, in full and short keys, one by one and for whole devices."""

from __future__ import annotations

import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cfgplan.mqtt.discovery import Discovered, Entity, discovered


def of(config: dict[str, Any], where: str = "sensor/kitchen") -> Discovered:
    return discovered({f"homeassistant/{where}/config": json.dumps(config).encode()})


@pytest.mark.parametrize(
    "config",
    [
        {"state_topic": "house/t", "device_class": "temperature", "unit_of_measurement": "°C"},
        {"stat_t": "house/t", "dev_cla": "temperature", "unit_of_meas": "°C"},
        {"~": "house", "stat_t": "~/t", "dev_cla": "temperature", "unit_of_meas": "°C", "val_tpl": "{{ value }}"},
        {"~": "t", "stat_t": "house/~", "dev_cla": "temperature", "unit_of_meas": "°C"},
    ],
)
def test_a_message_in_any_spelling_describes_its_topic(config: dict[str, Any]) -> None:
    assert of(config).entities == (Entity("house/t", "temperature", True, "°C"),)


def test_a_node_and_an_area_may_be_named() -> None:
    config = {"stat_t": "x", "dev": {"name": "n", "sa": " Living room "}}
    assert of(config, "binary_sensor/node_1/x-2").entities == (Entity("x", "binary_sensor", False, area="Living room"),)


def test_a_device_describes_all_its_entities() -> None:
    device = {
        "dev": {"sa": "Hall"},
        "stat_t": "zb/1",
        "cmps": {
            "t": {"p": "sensor", "dev_cla": "temperature", "unit_of_meas": "°C", "val_tpl": "{{ value_json.t }}"},
            "d": {"p": "binary_sensor", "dev_cla": "door", "stat_t": "zb/door"},
            "gone": "",
        },
    }
    assert of(device, "device/zb").entities == (
        Entity("zb/1", "temperature", True, "°C", "Hall", ("t",)),
        Entity("zb/door", "door", False, None, "Hall"),
    )


@pytest.mark.parametrize(
    ("template", "path"),
    [
        ("{{ value }}", ()),
        ("{{ value|float }}", ()),
        ("{{value_json.temperature}}", ("temperature",)),
        ("{{ value_json['BME280'].Temperature | round(1) }}", ("BME280", "Temperature")),
        ('{{ value_json["PM2.5"] | default(0) | int }}', ("PM2.5",)),
        ("{{ value_json.values[2] | is_defined }}", ("values", 2)),
        ("{{ value_json.t * 2 }}", None),
        ("{{ value_json.t | my_filter }}", None),
        ("{% if value_json.on %}1{% endif %}", None),
        (7, None),
    ],
)
def test_a_template_that_looks_up_a_field_is_read_and_no_other(template: object, path: object) -> None:
    (entity,) = of({"stat_t": "x", "val_tpl": template}).entities
    assert entity.path == path


def test_commands_availability_and_current_values_are_told_apart_from_the_state() -> None:
    found = of(
        {
            "~": "hall/heater",
            "temp_cmd_t": "~/target/set",
            "mode_command_topic": "~/mode/set",
            "set_pos_t": "~/position/set",
            "curr_temp_t": "~/now",
            "curr_temp_tpl": "{{ value_json.t }}",
            "temp_unit": "F",
            "avty": [{"t": "~/status"}],
        },
        "climate/hall",
    )
    assert found.commands == {"hall/heater/target/set", "hall/heater/mode/set", "hall/heater/position/set"}
    assert found.entities == (
        Entity("hall/heater/now", "temperature", True, "°F", None, ("t",)),
        Entity("hall/heater/status", "availability", False),
    )


@pytest.mark.parametrize("payload", [b"", b"no json", b"[1]", b"\xff", b"[" * 100_000])
def test_a_message_that_describes_nothing_is_told(payload: bytes) -> None:
    assert discovered({"homeassistant/sensor/x/config": payload}).unread == ("homeassistant/sensor/x/config",)


KEYS = st.sampled_from(["~", "stat_t", "dev", "sa", "cmps", "p", "avty", "t", "val_tpl", "dev_cla", "unit_of_meas"])
VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.sampled_from(["x", "~/a", "", "a/#", "{{ value_json.a }}"]),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(KEYS, inner, max_size=4),
)


@given(st.dictionaries(KEYS, VALUES), st.sampled_from(["sensor/x", "device/x", "climate/x"]))
def test_no_message_is_too_odd(config: dict[str, Any], where: str) -> None:
    assert of(config, where).unread == ()
