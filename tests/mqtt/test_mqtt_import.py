"""`cfgplan import mqtt` against a real broker: what it writes, and what it says where it can't."""

from __future__ import annotations

import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from mosquitto import NEEDS_MOSQUITTO, Broker, make_certificate, running

import cfgplan
from cfgplan.cli import main

pytestmark = [NEEDS_MOSQUITTO, pytest.mark.xdist_group("mqtt")]


class Said(NamedTuple):
    code: int
    out: str
    err: str


Import = Callable[..., Said]


@pytest.fixture
def imported(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Import:
    monkeypatch.setenv("COLUMNS", "200")

    def imported(broker: object, *more: object, out: Path | None = tmp_path / "env.yaml") -> Said:
        files = () if out is None else ("--out", str(out))
        code = main(
            ["import", "mqtt", str(broker), *map(str, more), *files, *(() if "--for" in more else ("--for", "0.3s"))]
        )
        return Said(code, *capsys.readouterr())

    return imported


TEMPERATURE = {"stat_t": "house/t", "dev_cla": "temperature", "unit_of_meas": "°C", "dev": {"sa": "Hall"}}


def test_what_a_broker_keeps_and_what_comes_live_become_sources(
    broker: Broker, keep: Callable[..., None], imported: Import, tmp_path: Path
) -> None:
    keep("homeassistant/sensor/t/config", TEMPERATURE)
    keep("house/door", "open")
    keep("spBv1.0/plant/NBIRTH/n", b"\x08")
    with publishing(broker, "house/t", "20.5"):
        said = imported(broker.name, "--for", "1s")
    assert said.code == 0
    assert "not imported: 1 topic of Sparkplug (spBv1.0/...), whose messages are not read" in said.err
    door, temperature = cfgplan.load(tmp_path / "env.yaml").environment.library
    assert dict(door.params) == {"broker": broker.name, "topic": "house/door", "payload": "text", "retained": True}
    assert (door.outputs[0].tag, door.outputs[0].rate_uhz) == ("house-door", 0)
    assert temperature.outputs[0].tag == "Temperature and inUnit some DegreeCelsius and inArea some Hall and house-t"
    assert (temperature.params["payload"], temperature.params["retained"]) == ("number", False)
    assert 2 <= temperature.outputs[0].rate_uhz / 1e6 <= 20


@contextmanager
def publishing(broker: Broker, topic: str, payload: str) -> Iterator[None]:
    """Ten messages a second, as good as the computer can."""
    from paho.mqtt.client import Client
    from paho.mqtt.enums import CallbackAPIVersion

    client, over = Client(CallbackAPIVersion.VERSION2), threading.Event()
    client.connect("127.0.0.1", broker.port)
    client.loop_start()

    def publish() -> None:
        while not over.wait(0.1):
            client.publish(topic, payload)

    thread = threading.Thread(target=publish)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()
        client.disconnect()
        client.loop_stop()


def test_only_topics_that_are_asked_for_are_taken(
    broker: Broker, keep: Callable[..., None], imported: Import, tmp_path: Path
) -> None:
    keep("homeassistant/sensor/t/config", TEMPERATURE)
    keep("homeassistant/sensor/u/config", {**TEMPERATURE, "stat_t": "garden/t"})
    for topic in ("house/t", "garden/t"):
        keep(topic, "20")
    for asked in ("garden/#", "+/t/#", "garden/+"):
        found = imported(broker.name, "--topic", asked)
        assert found.code == 0
        garden, *rest = cfgplan.load(tmp_path / "env.yaml").environment.library
        assert (garden.label, "Temperature" in garden.outputs[0].tag) == ("garden-t", True)
        assert [each.label for each in rest] == (["house-t"] if asked == "+/t/#" else [])


def test_a_broker_with_names_is_read_by_a_name_which_stands_in_the_file_without_its_password(
    imported: Import, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("paho", reason="paho-mqtt is not installed (extra mqtt)")
    from paho.mqtt.publish import single

    users = tmp_path / "users"
    subprocess.run(["mosquitto_passwd", "-b", "-c", users, "bob", "open sesame"], check=True, capture_output=True)
    users.chmod(0o644)
    monkeypatch.setenv("MQTT_PASSWORD", "open sesame")
    with running(tmp_path, "allow_anonymous false", f"password_file {users}") as broker:
        login: Any = {"username": "bob", "password": "open sesame"}
        single("x", "1", qos=1, retain=True, hostname="127.0.0.1", port=broker.port, auth=login)
        nobody = imported(broker.name)
        assert (nobody.code, "the broker refuses this client: Not authorized" in nobody.err) == (30, True)
        assert "name it by --username" in nobody.err
        assert imported(broker.name, "--username", "bob", "--password-env", "MQTT_PASSWORD").code == 0
    text = (tmp_path / "env.yaml").read_text()
    assert ("username: bob" in text, "password_env: MQTT_PASSWORD" in text, "sesame" in text) == (True, True, False)


def test_a_broker_is_read_by_tls_and_its_authority_stands_in_the_file(imported: Import, tmp_path: Path) -> None:
    from paho.mqtt.publish import single

    make_certificate(tmp_path)
    files = (f"certfile {tmp_path}/cert.pem", f"keyfile {tmp_path}/key.pem")
    ca = str(tmp_path / "cert.pem")
    with running(tmp_path, "allow_anonymous true", *files) as broker:
        single("x", "1", qos=1, retain=True, hostname="127.0.0.1", port=broker.port, tls={"ca_certs": ca})
        unsafe = imported(broker.name)
        assert (unsafe.code, "is not a broker of MQTT 5, or speaks TLS" in unsafe.err) == (30, True)
        untrusted = imported(f"mqtts://{broker.name}")
        assert (untrusted.code, "certificate verify failed" in untrusted.err) == (30, True)
        assert imported(f"mqtts://{broker.name}", "--ca", ca).code == 0
    (x,) = cfgplan.load(tmp_path / "env.yaml").environment.library
    assert (x.params["broker"], x.params["ca"]) == (f"mqtts://{broker.name}", ca)


def test_a_broker_on_which_nothing_comes_is_told(broker: Broker, imported: Import, tmp_path: Path) -> None:
    said = imported(broker.name)
    assert (said.code, said.err.count("error:")) == (30, 1)
    assert f"nothing came from {broker.name} in 0.3 s" in said.err
    assert "listen longer" in said.err
    assert not (tmp_path / "env.yaml").exists()


def test_a_client_that_may_read_nothing_is_told_what_to_name(
    broker: Broker, keep: Callable[..., None], imported: Import
) -> None:
    keep("house/t", "20")
    broker.stop()
    rights = broker.config.parent / "rights"
    rights.write_text("topic write #\n")
    rights.chmod(0o644)
    broker.config.write_text(f"{broker.config.read_text()}acl_file {rights}\n")
    broker.start()
    said = imported(broker.name)
    assert said.code == 30
    assert said.err.count("error:") == 1


@pytest.mark.parametrize(
    ("broker_name", "more", "message", "mend"),
    [
        ("127.0.0.1:1", (), "the broker 127.0.0.1:1 does not answer", "start it, or name the address of one that runs"),
        ("house:many", (), "`house:many` is not the address of a broker", "write HOST, HOST:PORT"),
        ("house", ("garden",), "`import mqtt` takes one path", "name one broker"),
        ("house", ("--topic", "a/#/b"), "`a/#/b` is not a topic filter", "`+` stands for one level"),
        ("house", ("--password-env", "X"), "there is a password without a name", "write `username` too"),
        ("house", ("--objective", "length"), "--objective: `import mqtt` does not take this option", "leave it out"),
    ],
)
def test_what_can_not_be_meant_is_one_error_with_a_mend(
    broker_name: str, more: tuple[str, ...], message: str, mend: str, imported: Import
) -> None:
    pytest.importorskip("paho", reason="paho-mqtt is not installed (extra mqtt)")
    said = imported(broker_name, *more)
    assert (said.code, said.err.count("error:")) == (30, 1)
    assert message in said.err
    assert mend in said.err


def test_a_file_to_write_has_to_be_named(imported: Import) -> None:
    assert "name the environment file with --out" in imported("house", out=None).err


def test_options_of_mqtt_are_refused_elsewhere(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["import", "xml", "a.xml", "--topic", "x", "--for", "3s"]) == 30
    assert "--for, --topic: `import xml` does not take this option" in capsys.readouterr().err


def test_what_listens_and_is_no_broker_is_told(imported: Import) -> None:
    pytest.importorskip("paho", reason="paho-mqtt is not installed (extra mqtt)")
    with socket.create_server(("127.0.0.1", 0)) as server:

        def answer() -> None:
            with suppress(OSError):
                while True:
                    client, _ = server.accept()
                    client.sendall(b"HTTP/1.1 400 Bad Request\r\n\r\n")
                    client.close()

        threading.Thread(target=answer, daemon=True).start()
        said = imported(f"127.0.0.1:{server.getsockname()[1]}")
        server.shutdown(socket.SHUT_RDWR)
    assert said.code == 30
    assert "is not a broker of MQTT 5, or speaks TLS: it ended the connection" in said.err


def test_without_paho_the_extra_is_named(tmp_path: Path) -> None:
    code = (
        "import sys; sys.modules['paho'] = None\n"
        "import cfgplan.extras as extras; extras.find_spec = lambda name: None\n"
        "from cfgplan.cli import main; sys.exit(main(['import', 'mqtt', 'house', '--out', sys.argv[1]]))"
    )
    said = subprocess.run([sys.executable, "-c", code, tmp_path / "env.yaml"], capture_output=True, text=True)
    assert said.returncode == 30
    assert "pip install 'cfgplan[mqtt]'" in said.stderr
    assert "Listening" not in said.stderr
    assert "Traceback" not in said.stderr
