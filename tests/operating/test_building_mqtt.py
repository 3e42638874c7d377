"""The building of models/building_mqtt: where its thermometer falls silent, the one at the window takes its place."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from cfgplan_runtime import subscribe
from mosquitto import NEEDS_MOSQUITTO, Broker
from mosquitto import running as running_broker
from operated_world import await_event, running

import cfgplan
from cfgplan.cli import main

WORLD = Path(__file__).parents[2] / "models" / "building_mqtt"
BROKER = "127.0.0.1:18830"
"""What the files of the world name."""

pytestmark = [NEEDS_MOSQUITTO, pytest.mark.xdist_group("mqtt")]


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[Broker]:
    pytest.importorskip("paho", reason="paho-mqtt is not installed (extra mqtt)")
    with running_broker(tmp_path) as broker, simulated(broker):
        yield broker


@contextmanager
def simulated(broker: Broker) -> Iterator[None]:
    """The building, once it is there."""
    line = [sys.executable, WORLD / "simulator.py", "--broker", broker.name]
    with subprocess.Popen(line, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == f"The building is on {broker.name}.\n"
            yield
        finally:
            process.kill()


def started(process: subprocess.Popen[str]) -> set[str]:
    """The units that the next update starts."""
    return {unit["id"] for unit in await_event(process, "Reviewed", decision="applied")["change_set"]["started"]}


def test_a_dead_thermometer_is_healed_by_the_one_at_the_window(broker: Broker, tmp_path: Path) -> None:
    from paho.mqtt.publish import single

    folder = shutil.copytree(WORLD, tmp_path / "world")
    for path in folder.glob("*.yaml"):
        path.write_text(path.read_text().replace(BROKER, broker.name))
    with running(folder / "1-start.yaml") as process:
        run = await_event(process, "Running")["run"]
        with subscribe("/meeting/temperature", run=run, wait_s=60) as subscription:
            before = next(iter(subscription)).value
            assert "office-meeting-thermometer.1" in started(process)
            single("simulator/break", "thermometer", qos=1, hostname="127.0.0.1", port=broker.port)
            while not {"celsius.1", "office-meeting-window.1"} <= started(process):
                pass  # the thermometer may be tried once more
            after = next(iter(subscription)).value
    assert abs(after - before) < 10, "degrees Celsius, not Fahrenheit"


def test_the_import_of_the_building_is_the_one_of_the_world(broker: Broker, tmp_path: Path) -> None:
    assert main(["import", "mqtt", broker.name, "--for", "2s", "--out", str(tmp_path / "building.yaml")]) == 0
    assert (tmp_path / "building.ttl").read_text() == (WORLD / "building.ttl").read_text()
    found = {each.label: each for each in cfgplan.load(tmp_path / "building.yaml").environment.library}
    there = {each.label: each for each in cfgplan.load(WORLD / "1-start.yaml").environment.library}
    for label, transformation in found.items():
        assert {**transformation.params, "broker": BROKER} == dict(there[label].params)
        assert transformation.outputs[0].tag == there[label].outputs[0].tag
