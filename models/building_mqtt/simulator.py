"""A building on MQTT: sensors, a heater, and discovery messages, on a broker of its own or a given one.

`python models/building_mqtt/simulator.py --run` starts mosquitto, the building and `cfgplan run`, breaks the meeting
room's thermometer after ten seconds, and prints what happens. Without `--run` the building runs until Ctrl-C; a
sensor's name published on `simulator/break` silences the sensor, published on `simulator/mend` it restores it.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
BROKER = "127.0.0.1:18830"
"""The broker that this world's files name."""
PERIOD_S = 0.5
OUTSIDE_C = 8.0
HEATING_C, LOSS = 0.15, 0.01
"""The rise by the heater in a period, in degrees, and the share of the difference to outside that is lost in it."""
THERMOMETER, WINDOW, AIR, LOBBY = "thermometer", "window", "air", "lobby"
TOPICS = {
    THERMOMETER: "office/meeting/thermometer",
    WINDOW: "office/meeting/window",
    AIR: "zigbee2mqtt/meeting_air",
    LOBBY: "office/lobby/thermometer",
}
SET, STATE = "office/meeting/heater/set", "office/meeting/heater/state"


def sensor(name: str, kind: str, unit: str, area: str, **more: str) -> tuple[str, dict[str, Any]]:
    """Return a discovery message: its topic and its content, with Home Assistant's abbreviated keys."""
    topic = TOPICS[name]
    said = {"stat_t": topic, "dev_cla": kind, "unit_of_meas": unit, "dev": {"name": name, "sa": area}, **more}
    return f"homeassistant/sensor/{name}/{kind}/config", said


DISCOVERY = dict(
    [
        sensor(THERMOMETER, "temperature", "°C", "Meeting room"),
        sensor(WINDOW, "temperature", "°F", "Meeting room"),
        sensor(AIR, "carbon_dioxide", "ppm", "Meeting room", val_tpl="{{ value_json.co2 }}"),
        sensor(AIR, "humidity", "%", "Meeting room", val_tpl="{{ value_json.humidity }}"),
        sensor(LOBBY, "temperature", "°C", "Lobby"),
        (
            "homeassistant/switch/heater/config",
            {"~": "office/meeting/heater", "cmd_t": "~/set", "stat_t": "~/state", "dev": {"sa": "Meeting room"}},
        ),
    ]
)


class Building:
    """The simulated rooms and sensors. Messages switch the heater, and silence or restore sensors."""

    def __init__(self, broker: str) -> None:
        try:
            from paho.mqtt.client import Client
            from paho.mqtt.enums import CallbackAPIVersion
        except ModuleNotFoundError:
            sys.exit("paho-mqtt is not installed: pip install 'cfgplan[mqtt]'")

        self.meeting_c, self.is_heating, self.broken = 17.0, False, set[str]()
        self.over = threading.Event()
        self._client = Client(CallbackAPIVersion.VERSION2)
        self._client.on_message = self._told
        host, _, port = broker.partition(":")
        try:
            self._client.connect(host, int(port or 1883))
        except (OSError, ValueError) as error:
            sys.exit(f"there is no broker at {broker}: {error}")
        self._client.subscribe([(SET, 1), ("simulator/#", 1)])
        self._client.loop_start()

    def describe(self) -> None:
        """Publish the discovery messages; the broker retains them."""
        for topic, said in DISCOVERY.items():
            self._publish(topic, said, retain=True)

    def live(self) -> None:
        """Publish the measurements until `over` is set."""
        while not self.over.wait(PERIOD_S):
            heat = HEATING_C if self.is_heating else 0
            self.meeting_c += heat - LOSS * (self.meeting_c - OUTSIDE_C)
            values: dict[str, Any] = {
                THERMOMETER: round(self.meeting_c, 2),
                WINDOW: round(self.meeting_c * 9 / 5 + 32, 2),
                AIR: {"co2": 600 + int(time.time()) % 50, "humidity": 40.5, "linkquality": 96},
                LOBBY: 19.0,
            }
            for name, value in values.items():
                if name not in self.broken:
                    self._publish(TOPICS[name], value)
            self._publish(STATE, "ON" if self.is_heating else "OFF", retain=True)

    def close(self) -> None:
        self.over.set()
        self._client.disconnect()
        self._client.loop_stop()

    def _publish(self, topic: str, value: Any, *, retain: bool = False) -> None:
        self._client.publish(topic, value if isinstance(value, str) else json.dumps(value), qos=1, retain=retain)

    def _told(self, _client: object, _data: object, message: Any) -> None:
        said = message.payload.decode()
        if message.topic == SET:
            self.is_heating = said == "ON"
        elif message.topic == "simulator/break":
            self.broken.add(said)
        elif message.topic == "simulator/mend":
            self.broken.discard(said)


@contextmanager
def mosquitto(broker: str) -> Iterator[None]:
    """Run mosquitto at the address `broker`, HOST:PORT, while the context is open."""
    program = shutil.which("mosquitto", path=f"{os.environ.get('PATH', os.defpath)}:/usr/sbin")
    if program is None:
        sys.exit("there is no mosquitto: apt install mosquitto, or name a broker with --broker HOST:PORT")
    port = int(broker.rpartition(":")[2])
    with tempfile.TemporaryDirectory() as folder:
        config = Path(folder) / "mosquitto.conf"
        config.write_text(f"listener {port} 127.0.0.1\nallow_anonymous true\n", encoding="utf-8")
        process = subprocess.Popen([program, "-c", config], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            while process.poll() is None and not answers(port):
                time.sleep(0.05)
            if process.poll() is not None:
                sys.exit(f"mosquitto can't listen on port {port}: name a broker with --broker HOST:PORT")
            yield
        finally:
            process.terminate()
            process.wait()


def answers(port: int) -> bool:
    try:
        socket.create_connection(("127.0.0.1", port), 1).close()
    except OSError:
        return False
    return True


@contextmanager
def world_at(broker: str) -> Iterator[Path]:
    """Yield the path of a copy of the first stage that uses this broker."""
    if broker == BROKER:
        yield HERE / "1-start.yaml"
        return
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(shutil.copytree(HERE, Path(folder) / "world"))
        for path in copy.glob("*.yaml"):
            path.write_text(path.read_text(encoding="utf-8").replace(BROKER, broker), encoding="utf-8")
        yield copy / "1-start.yaml"


def main() -> None:
    parser = argparse.ArgumentParser(description="A building on MQTT.")
    parser.add_argument("--broker", metavar="HOST:PORT", help="a broker that runs (a mosquitto is started)")
    parser.add_argument("--run", action="store_true", help="run cfgplan on it, and break the thermometer")
    parser.add_argument("--after", type=float, default=10, metavar="S", help="break it after so many seconds (10)")
    parser.add_argument("--for", type=float, dest="span", metavar="S", help="end after so many seconds")
    options = parser.parse_args()
    with ExitStack() as stack:
        if options.broker is None:
            stack.enter_context(mosquitto(BROKER))
        broker = options.broker or BROKER
        building = Building(broker)
        stack.callback(building.close)
        building.describe()
        threading.Thread(target=building.live, daemon=True).start()
        print(f"The building is on {broker}.", flush=True)
        run = None
        if options.run:
            env = stack.enter_context(world_at(broker))
            line = [sys.executable, "-c", "from cfgplan.cli import main; main()", "run", "--no-estimates", str(env)]
            run = subprocess.Popen(line)
            stack.callback(run.wait)
            stack.callback(run.terminate)
            timer = threading.Timer(options.after, lambda: _break(building))
            stack.callback(timer.cancel)
            timer.start()
        try:
            if run is not None:
                run.wait(options.span)
            else:
                building.over.wait(options.span)
        except (KeyboardInterrupt, subprocess.TimeoutExpired):
            pass


def _break(building: Building) -> None:
    print("The thermometer of the meeting room breaks.", flush=True)
    building.broken.add(THERMOMETER)


if __name__ == "__main__":
    main()
