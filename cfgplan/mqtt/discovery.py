"""Home Assistant's MQTT discovery: messages that describe entities, each with its topics, its kind and its unit.

A message on `homeassistant/<component>/[<node>/]<object>/config` describes one entity, one on
`homeassistant/device/<object>/config` every entity of a device. Keys may be abbreviated, and `~` stands for a base
topic.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final, TypeGuard

_LONG: Final = {
    "avty": "availability",
    "avty_t": "availability_topic",
    "avty_tpl": "availability_template",
    "cmps": "components",
    "curr_hum_t": "current_humidity_topic",
    "curr_hum_tpl": "current_humidity_template",
    "curr_temp_t": "current_temperature_topic",
    "curr_temp_tpl": "current_temperature_template",
    "dev": "device",
    "dev_cla": "device_class",
    "p": "platform",
    "sa": "suggested_area",
    "stat_t": "state_topic",
    "t": "topic",
    "temp_unit": "temperature_unit",
    "unit_of_meas": "unit_of_measurement",
    "val_tpl": "value_template",
}
"""The abbreviations of the keys that are read."""
DISCOVERY: Final = "homeassistant/"
"""The prefix of discovery messages' topics."""
_COMMANDS: Final = re.compile(r"(\w+_)?(command_topic|cmd_t)|set_\w+_(topic|t)")
_TOPIC: Final = re.compile(rf"{DISCOVERY}(\w+)/(?:[\w-]+/)?[\w-]+/config")
_FILTER: Final = r"\s*\|\s*(?:float|int|round|default|is_defined)\s*(?:\([^()|]*\))?"
_TEMPLATE: Final = re.compile(
    rf"""\{{\{{-?\s*value(_json((?:\.\w+|\[\s*(?:'[^']*'|"[^"]*"|\d+)\s*\])+))?(?:{_FILTER})*\s*-?\}}\}}"""
)
_STEP: Final = re.compile(r"""\.(\w+)|\[\s*(?:'([^']*)'|"([^"]*)"|(\d+))\s*\]""")
_CURRENT: Final = {"current_temperature": "temperature", "current_humidity": "humidity"}
"""Measurements that an entity of another kind, such as a thermostat, has besides its state."""
_MEASURING: Final = ("sensor", "number")

Path = tuple[str | int, ...]
"""The keys that lead to a value in JSON."""


@dataclass(frozen=True, slots=True)
class Entity:
    """A value published on a topic, with its kind, unit and area; `path` leads to it in the messages.

    `is_measured` tells a measurement from a state. `path` is None if the template that finds the value can't be read.
    """

    topic: str
    kind: str | None
    is_measured: bool
    unit: str | None = None
    area: str | None = None
    path: Path | None = ()


@dataclass(frozen=True)
class Discovered:
    """The content of discovery messages: entities, topics that take commands, and the topics of unreadable messages."""

    entities: tuple[Entity, ...]
    commands: frozenset[str]
    unread: tuple[str, ...]


def discovered(messages: Mapping[str, bytes]) -> Discovered:
    """Read discovery messages, given by topic. If several describe the same value, the first topic in order counts."""
    found: dict[tuple[str, Path | None], Entity] = {}
    commands: set[str] = set()
    unread: list[str] = []
    for topic, payload in sorted(messages.items()):
        match = _TOPIC.fullmatch(topic)
        try:
            said = json.loads(payload)
        except (ValueError, RecursionError):
            said = None
        if match is None or not isinstance(said, dict):
            unread.append(topic)
            continue
        for component, config in _components(match[1], _long(said)):
            commands |= {config[key] for key in config if _COMMANDS.fullmatch(key) and _is_topic(config[key])}
            for entity in _entities(component, config):
                found.setdefault((entity.topic, entity.path), entity)
    return Discovered(tuple(found.values()), frozenset(commands), tuple(unread))


def _components(component: str, said: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield component and configuration of each entity; a device's shared keys are merged into each of its entities."""
    if component != "device":
        yield component, _based(said)
        return
    parts = said.get("components")
    for part in parts.values() if isinstance(parts, dict) else ():
        if isinstance(part, dict):
            own = {**{key: value for key, value in said.items() if key != "components"}, **_long(part)}
            yield str(own.get("platform", "")), _based(own)


def _entities(component: str, config: Mapping[str, Any]) -> Iterator[Entity]:
    device = config.get("device")
    area = _text(_long(device).get("suggested_area")) if isinstance(device, dict) else None
    if _is_topic(topic := config.get("state_topic")):
        kind, is_measured = _text(config.get("device_class")), component in _MEASURING
        yield Entity(
            topic,
            kind or (None if is_measured else component or None),
            is_measured,
            _text(config.get("unit_of_measurement")),
            area,
            _path(config.get("value_template")),
        )
    for name, kind in _CURRENT.items():
        if _is_topic(topic := config.get(f"{name}_topic")):
            unit = "%" if kind == "humidity" else _degrees(config.get("temperature_unit"))
            yield Entity(topic, kind, True, unit, area, _path(config.get(f"{name}_template")))
    for topic, template in _availability(config):
        yield Entity(topic, "availability", False, path=_path(template))


def _availability(config: Mapping[str, Any]) -> Iterator[tuple[str, object]]:
    if _is_topic(topic := config.get("availability_topic")):
        yield topic, config.get("availability_template")
    listed = config.get("availability")
    for each in listed if isinstance(listed, list) else [listed]:
        if isinstance(each, dict) and _is_topic(topic := _based(_long(each), config.get("~")).get("topic")):
            yield topic, _long(each).get("value_template")


def _long(said: Mapping[str, Any]) -> dict[str, Any]:
    """The same with keys in full."""
    return {_LONG.get(key, key): value for key, value in said.items()}


def _based(said: Mapping[str, Any], base: object = None) -> dict[str, Any]:
    """The same with the base topic in place of `~` at either end of topics."""
    base = said.get("~", base)
    if not isinstance(base, str):
        return {**said}

    def full(key: str, value: object) -> object:
        if not isinstance(value, str) or not key.endswith(("topic", "_t")):
            return value
        value = base + value[1:] if value.startswith("~") else value
        return value[:-1] + base if value.endswith("~") else value

    return {key: full(key, value) for key, value in said.items()}


def _path(template: object) -> Path | None:
    """The keys that a template of a value looks up; None if it does anything else."""
    if template is None or template == "":
        return ()
    match = _TEMPLATE.fullmatch(template.strip()) if isinstance(template, str) else None
    if match is None:
        return None
    steps = _STEP.findall(match[2] or "")
    return tuple(int(number) if number else name or single or double for name, single, double, number in steps)


def _degrees(unit: object) -> str | None:
    return f"°{unit}" if unit in ("C", "F") else None


def _text(value: object) -> str | None:
    return value.strip() or None if isinstance(value, str) else None


def _is_topic(value: object) -> TypeGuard[str]:
    return isinstance(value, str) and value != "" and not any(mark in value for mark in "+#\0")
