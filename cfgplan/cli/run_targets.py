"""Publish the targets of `cfgplan run` outside of it: as topics of ROS 2, and at an MQTT broker."""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from cfgplan.cli.broker import add_connection, connection
from cfgplan.errors import InputError

if TYPE_CHECKING:
    from cfgplan_runtime.mqtt.targets import MqttTargets
    from cfgplan_runtime.operating.operation import Operation

    from cfgplan.domain import Environment

_MQTT = "mqtt-"
"""Begins the names of options of a broker."""


def add_to(parser: argparse.ArgumentParser) -> None:
    """Add the options that say where targets are published."""
    parser.add_argument("--ros2", action="store_true", help="publish targets with a message `type` as ROS 2 topics")
    group = parser.add_argument_group("mqtt", "publish targets at an MQTT broker; see `cfgplan help mqtt`")
    broker = "publish targets at this broker: HOST, HOST:PORT, mqtt://HOST:PORT, or mqtts://HOST:PORT for TLS"
    group.add_argument("--mqtt", metavar="BROKER", help=broker)
    group.add_argument("--mqtt-retain", action="store_true", help="have the broker keep the last value of each target")
    status = "topic with the run's status, online or offline (default: cfgplan/NAME/status for a file NAME.yaml)"
    group.add_argument("--mqtt-status", metavar="TOPIC", help=status)
    add_connection(group, _MQTT)


def check_options(options: argparse.Namespace) -> None:
    """Raise InputError if options do not go together, or if a package is missing."""
    if options.ros2:
        from cfgplan_runtime.ros2.topics import check_installed

        check_installed()
    given = {**connection(options, _MQTT), "retain": options.mqtt_retain, "status": options.mqtt_status}
    lone = [f"--{_MQTT}{name.replace('_', '-')}" for name, value in given.items() if value]
    if options.mqtt is None and lone:
        raise InputError.of(f"{', '.join(lone)} without a broker", mend="name the broker by --mqtt")


def mqtt_check(options: argparse.Namespace, environment: Environment) -> Callable[[], object] | None:
    """Return a check of the targets that a broker gets; None without a broker. The check raises InputError."""
    if options.mqtt is None:
        return None
    from cfgplan_runtime.mqtt.targets import check_targets

    def check() -> None:
        _mqtt_targets(options)(lambda _: None)
        check_targets(environment, options.mqtt)

    return check


@contextmanager
def published(options: argparse.Namespace, operation: Operation, folder: Path) -> Iterator[None]:
    """Publish targets wherever that is asked for. Raises InputError."""
    from cfgplan_runtime.operating.published import PublishedTargets

    with ExitStack() as stack:
        if options.ros2:
            from cfgplan_runtime.ros2.targets import RosTargets

            stack.enter_context(PublishedTargets(operation, RosTargets(operation.id, folder, operation.show)))
        if options.mqtt is not None:
            targets = _mqtt_targets(options)(operation.show)
            targets.open()
            stack.enter_context(PublishedTargets(operation, targets))
        yield


def _mqtt_targets(options: argparse.Namespace) -> Callable[[Callable[[str], None]], MqttTargets]:
    """Makes what publishes at the broker of the options, given what tells the user."""
    from cfgplan_runtime.mqtt.targets import MqttTargets

    name = re.sub(r"[^\w.-]", "_", Path(options.env).resolve().stem)
    status = options.mqtt_status or f"cfgplan/{name}/status"
    params = connection(options, _MQTT)
    return lambda tell: MqttTargets(options.mqtt, tell, status=status, retain=options.mqtt_retain, **params)
