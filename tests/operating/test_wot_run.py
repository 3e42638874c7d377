"""Things that are imported run: one on a broker, and one that is polled."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest
from cfgplan_runtime import subscribe
from mosquitto import NEEDS_MOSQUITTO, Broker
from mosquitto import running as running_broker
from operated_world import await_event, running

from cfgplan.cli import main

pytestmark = [NEEDS_MOSQUITTO, pytest.mark.xdist_group("mqtt")]


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[Broker]:
    pytest.importorskip("paho", reason="paho-mqtt is not installed (extra mqtt)")
    folder = tmp_path / "broker"
    folder.mkdir()
    with running_broker(folder) as broker:
        yield broker


@pytest.fixture
def resource() -> Iterator[str]:
    """A thermometer that answers 21 °C."""

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.end_headers()
            self.wfile.write(b"21")

        def log_message(self, *_: Any) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever, args=[0.02])
    thread.start()
    yield f"http://127.0.0.1:{server.server_port}/temperature"
    server.shutdown()
    server.server_close()
    thread.join()


def test_a_thing_on_a_broker_and_one_that_is_polled_give_what_a_target_wants(
    broker: Broker, resource: str, tmp_path: Path
) -> None:
    from paho.mqtt.publish import single

    def thing(title: str, href: str, op: str) -> dict[str, Any]:
        temperature = {"@type": "ex:Temperature", "type": "number", "unit": "ex:Celsius"}
        return {
            "@context": ["https://www.w3.org/2022/wot/td/v1.1", {"ex": "https://example.org/"}],
            "title": title,
            "properties": {"temperature": {**temperature, "forms": [{"href": href, "op": op}]}},
        }

    things = [
        thing("Hall", f"mqtt://{broker.name}/hall/t", "observeproperty"),
        thing("Kitchen", resource, "readproperty"),
    ]
    (tmp_path / "house.td.json").write_text(json.dumps(things))
    env = tmp_path / "house.yaml"
    assert main(["import", "wot", str(tmp_path / "house.td.json"), "--out", str(env)]) == 0
    single("hall/t", "20", qos=1, retain=True, hostname="127.0.0.1", port=broker.port)
    with env.open("a") as file:
        for place in ("Hall", "Kitchen"):
            tag = f"Temperature and inUnit some Celsius and ofThing some {place}"
            file.write(
                f"{'targets:' if place == 'Hall' else ''}\n  - {{label: {place}, topic: /{place}, tag: {tag}}}\n"
            )
    with running(env) as process:
        run = await_event(process, "Running")["run"]
        values = {}
        for place in ("Hall", "Kitchen"):
            with subscribe(f"/{place}", run=run, wait_s=60) as subscription:
                if place == "Hall":
                    single("hall/t", "20", qos=1, hostname="127.0.0.1", port=broker.port)
                values[place] = next(iter(subscription)).value
        process.terminate()
        process.communicate(timeout=60)
        assert process.returncode == 0
    assert values == {"Hall": 20, "Kitchen": 21}
