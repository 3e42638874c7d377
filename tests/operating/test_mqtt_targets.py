"""`cfgplan run --mqtt BROKER`: targets as topics of a real broker, which may be away, be killed and come back."""

from __future__ import annotations

import json
import queue
import re
import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import psutil
import pytest
from mosquitto import NEEDS_MOSQUITTO, PATIENCE_S, Broker
from mosquitto import running as running_broker
from operated_world import await_event, eventually, running

from cfgplan import extras
from cfgplan.cli import main

pytestmark = [NEEDS_MOSQUITTO, pytest.mark.xdist_group("mqtt")]

UNITS = """\
import numpy

def count():
    for number in range(10**9):
        yield {"number": number, "picture": numpy.full((2, 2), 7, numpy.uint8)}

def raw():
    while True:
        yield b"raw"
"""
ENVIRONMENT = """\
format: cfgplan/1
transformations:
  - {label: counter, source: 'units.py:count', run: {rate: 50}, outputs: {number: Number}}
  - {label: raw, source: 'units.py:raw', run: {rate: 20}, outputs: {data: Raw}}
targets:
  - {label: number, topic: house/number, tag: Number}
"""
RAW = "  - {label: raw, topic: house/raw, tag: Raw}\n"
STATUS = "cfgplan/env/status"


@pytest.fixture(autouse=True)
def paho() -> None:
    pytest.importorskip("paho", reason="paho-mqtt is not installed (extra mqtt)")


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[Broker]:
    folder = tmp_path / "broker"
    folder.mkdir()
    with running_broker(folder) as broker:
        yield broker


@pytest.fixture
def env(tmp_path: Path) -> Path:
    (tmp_path / "units.py").write_text(UNITS)
    path = tmp_path / "env.yaml"
    path.write_text(ENVIRONMENT)
    return path


Messages = queue.SimpleQueue[tuple[str, str, bool]]
"""Topic, payload, and whether the broker had kept it."""


@contextmanager
def hearing(broker: Broker, *topics: str) -> Iterator[Messages]:
    from paho.mqtt.client import Client
    from paho.mqtt.enums import CallbackAPIVersion

    heard: Messages = queue.SimpleQueue()
    client = Client(CallbackAPIVersion.VERSION2)
    client.on_message = lambda _, __, message: heard.put((message.topic, message.payload.decode(), message.retain))
    client.on_connect = lambda *_: client.subscribe([(topic, 1) for topic in topics])
    client.connect("127.0.0.1", broker.port)
    client.loop_start()
    try:
        yield heard
    finally:
        client.disconnect()
        client.loop_stop()


def await_message(heard: Messages, topic: str, payload: str | None = None) -> str:
    """The next payload of a topic, or the next one that is just so."""
    while True:
        found = heard.get(timeout=PATIENCE_S)
        if found[0] == topic and payload in (None, found[1]):
            return found[1]


def await_warning(process: subprocess.Popen[str], text: str) -> str:
    while text not in (told := await_event(process, "Warning")["text"]):
        pass
    return str(told)


def end(process: subprocess.Popen[str]) -> list[str]:
    """Stop a run; the warnings that it had not told yet."""
    process.terminate()
    out, _ = process.communicate(timeout=PATIENCE_S)
    told = map(json.loads, out.splitlines())
    return [each["text"] for each in told if each["event"] == "Warning"]


def test_targets_come_as_json_on_their_topics_and_a_topic_says_whether_the_run_is_there(
    broker: Broker, env: Path
) -> None:
    with hearing(broker, "house/#", STATUS) as heard, running(env, "--mqtt", broker.name) as process:
        await_message(heard, STATUS, "online")
        first = json.loads(await_message(heard, "house/number"))
        assert first == {"number": first["number"], "picture": [[7, 7], [7, 7]]}
        following = [json.loads(await_message(heard, "house/number"))["number"] for _ in range(20)]
        assert following == list(range(first["number"] + 1, first["number"] + 21))

        # The file holds as soon as it is edited; JSON has no bytes.
        env.write_text(ENVIRONMENT + RAW)
        assert await_warning(process, "house/raw") == (
            "house/raw: a value is not published at the broker: bytes has no form in JSON"
        )
        env.write_text(ENVIRONMENT.replace("house/number", "house/+"))
        assert "`house/+` is not a topic to publish on" in await_warning(process, "number is not published")
        assert not [told for told in end(process) if "house/raw" in told], "it is told once"
        assert process.returncode == 0
        assert await_message(heard, STATUS) == "offline"
        with hearing(broker, "house/#", STATUS) as later:
            assert later.get(timeout=PATIENCE_S) == (STATUS, "offline", True)
            assert later.empty(), "no value was kept"


def test_a_broker_keeps_last_values_if_it_is_asked_to(broker: Broker, env: Path) -> None:
    with running(env, "--mqtt", broker.name, "--mqtt-retain", "--mqtt-status", "here") as process:
        with hearing(broker, "house/#", "here") as heard:
            await_message(heard, "here", "online")
            await_message(heard, "house/number")
        with hearing(broker, "house/number") as later:
            assert later.get(timeout=PATIENCE_S)[2], "the last value comes first"
        end(process)


def test_the_broker_says_that_a_run_that_was_killed_is_offline(broker: Broker, env: Path) -> None:
    with hearing(broker, STATUS) as heard, running(env, "--mqtt", broker.name) as process:
        await_message(heard, STATUS, "online")
        process.kill()
        assert await_message(heard, STATUS) == "offline"


def test_a_broker_that_is_away_or_dies_is_told_once_and_the_run_goes_on(broker: Broker, env: Path) -> None:
    broker.stop()
    with running(env, "--mqtt", broker.name) as process:
        assert "does not answer" in await_warning(process, f"the broker {broker.name}")
        broker.start()
        await_warning(process, f"{broker.name} is connected again")
        with hearing(broker, "house/#", STATUS) as heard:
            await_message(heard, STATUS, "online")
            number = json.loads(await_message(heard, "house/number"))["number"]
        broker.stop(signal.SIGKILL)
        assert "is lost" in await_warning(process, f"the broker {broker.name}")
        broker.start()
        await_warning(process, f"{broker.name} is connected again")
        with hearing(broker, "house/#", STATUS) as heard:
            await_message(heard, STATUS, "online")
            # The broker may have died before it had confirmed the last ones that were heard: they come again.
            while json.loads(await_message(heard, "house/number"))["number"] <= number:
                pass
        assert not [told for told in end(process) if broker.name in told], "nothing is told twice"
        assert process.returncode == 0


def test_a_broker_that_lets_nobody_in_is_told_once_and_the_run_goes_on(
    tmp_path: Path, env: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    users = tmp_path / "users"
    subprocess.run(["mosquitto_passwd", "-b", "-c", users, "bob", "open sesame"], check=True, capture_output=True)
    users.chmod(0o644)
    login = ("--mqtt-username", "bob", "--mqtt-password-env", "MQTT_PASSWORD")
    with running_broker(tmp_path, "allow_anonymous false", f"password_file {users}") as broker:
        monkeypatch.setenv("MQTT_PASSWORD", "open barley")
        with running(env, "--mqtt", broker.name, *login) as process:
            told = await_warning(process, "the broker refuses this client")
            assert "targets are not published there" in told
            assert "barley" not in told
            assert not [told for told in end(process) if "refuses" in told]
            assert process.returncode == 0
        monkeypatch.setenv("MQTT_PASSWORD", "open sesame")
        with running(env, "--mqtt", broker.name, *login) as process:
            await_event(process, "Running")
            assert not end(process)


def test_nothing_is_lost_while_a_subscribers_process_is_replaced(broker: Broker, env: Path) -> None:
    from paho.mqtt.publish import single

    env.write_text(
        "format: cfgplan/1\n"
        "transformations:\n"
        "  - label: reader\n"
        "    source: cfgplan_runtime.mqtt:Subscriber\n"
        f"    params: {{broker: '{broker.name}', topic: in}}\n"
        "    outputs: {number: Number}\n"
        "targets:\n"
        "  - {label: number, topic: out, tag: Number}\n"
    )

    def send(number: int) -> None:
        single("in", str(number), qos=1, hostname="127.0.0.1", port=broker.port)

    with hearing(broker, "out") as heard, running(env, "--mqtt", broker.name) as process:
        run = await_event(process, "Running")["run"]
        eventually(lambda: send(0) or not heard.empty())
        while await_message(heard, "out") != "0":
            pass
        name = f"cfgplan {run} reader.1"
        (reader,) = (one for one in psutil.process_iter(["cmdline"]) if (one.info["cmdline"] or [""])[0] == name)
        reader.suspend()  # it dies with what comes from now on, which it never takes
        for number in (1, 2, 3):
            send(number)
        reader.kill()
        numbers = [json.loads(await_message(heard, "out")) for _ in range(3)]
        while numbers[-1] != 3:
            numbers.append(json.loads(await_message(heard, "out")))
        assert [number for number in numbers if number] == [1, 2, 3]
        end(process)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--mqtt-retain", "--mqtt-ca", "x.pem"), "--mqtt-ca, --mqtt-retain without a broker"),
        (("--mqtt", "http://house"), "`http://house` is not the address of a broker"),
        (("--mqtt", "house", "--mqtt-status", "a/#"), "`a/#` is not a topic to publish on"),
        (("--mqtt", "house", "--mqtt-password-env", "X"), "there is a password without a name"),
        (("--mqtt", "house", "--mqtt-username", "bob", "--mqtt-password-env", "NO_SUCH"), "NO_SUCH is not set"),
        (("--mqtt", "mqtts://house", "--mqtt-ca", "/absent"), "the files of TLS"),
        (("--mqtt", "house", "--middleware", "ros1"), "--mqtt is for units that are processes, not for nodes of ROS 1"),
    ],
)
def test_options_that_can_not_be_meant_start_nothing(
    options: tuple[str, ...], message: str, env: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["run", str(env), *options]) == 30
    assert message in " ".join(capsys.readouterr().err.split())


def test_a_target_whose_topic_mqtt_does_not_allow_is_told_before_anything_starts(
    env: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    env.write_text(ENVIRONMENT.replace("house/number", "house/+"))
    assert main(["run", str(env), "--mqtt", "house"]) == 30
    said = " ".join(capsys.readouterr().err.split())
    assert "env.yaml: target number: `house/+` is not a topic to publish on" in said
    assert "has no wildcards" in said


def test_without_paho_the_extra_is_named(
    env: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    find = extras.find_spec
    monkeypatch.setattr(extras, "find_spec", lambda name: None if name == "paho" else find(name))
    assert main(["run", str(env), "--mqtt", "house"]) == 30
    assert "pip install 'cfgplan[mqtt]'" in " ".join(capsys.readouterr().err.split())


def heard_there(broker: Broker, topic: str) -> str:
    params = f"{{broker: '{broker.name}', topic: '{topic}'}}"
    return f"""\
format: cfgplan/1
transformations:
  - {{label: sensor, source: 'cfgplan_runtime.mqtt:Subscriber', params: {params}, outputs: {{value: Value}}}}
targets:
  - {{label: value, topic: /hall/t, tag: Value}}
"""


@pytest.mark.parametrize("topic", ["/hall/t", "/hall/+", "/#"])
def test_a_run_does_not_publish_where_it_listens(
    broker: Broker, env: Path, topic: str, capsys: pytest.CaptureFixture[str]
) -> None:
    env.write_text(heard_there(broker, topic))
    other_name = broker.name.replace("127.0.0.1", "localhost")
    assert main(["run", str(env), "--mqtt", f"mqtt://{other_name}", "--for", "1s"]) == 30
    told = capsys.readouterr().err
    assert f"sensor subscribes to {topic} there: the run would receive its own values" in told
    assert "`topic: cfgplan/hall/t`" in told
    elsewhere = env.read_text().replace("topic: /hall/t, tag", "topic: hall/t, tag")
    env.write_text(elsewhere)
    with running(env, "--mqtt", broker.name) as process, hearing(broker, "hall/t", "/hall/t") as heard:
        publish(broker, "/hall/t", 1)
        assert "1" in await_message(heard, "hall/t")
        env.write_text(heard_there(broker, topic))
        assert "value is not published at the broker: the topic /hall/t" in await_warning(process, "not published")
        end(process)


def publish(broker: Broker, topic: str, value: object) -> None:
    from paho.mqtt.publish import single

    single(topic, json.dumps(value), retain=True, hostname="127.0.0.1", port=broker.port)


def test_a_broker_whose_topics_begin_with_a_slash_becomes_a_run_that_publishes_them(
    broker: Broker, tmp_path: Path
) -> None:
    for topic, value in (("/hall/t", 21), ("hall/t", 5)):
        publish(broker, topic, value)
    env = tmp_path / "house.yaml"
    assert main(["import", "mqtt", broker.name, "--topic", "/hall/#", "--for", "0.5s", "--out", str(env)]) == 0
    text = env.read_text()
    head = "\n".join(line.removeprefix("# ") for line in text.splitlines() if line.startswith("#   "))
    env.write_text(text + "\n".join(line.removeprefix("  ") for line in head.splitlines()) + "\n")
    with running(env, "--mqtt", broker.name) as process, hearing(broker, "cfgplan/hall-t") as heard:
        assert await_message(heard, "cfgplan/hall-t") == "21.0"
        end(process)


def test_the_first_file_of_the_page_warms_the_kitchen(broker: Broker, tmp_path: Path) -> None:
    page = (Path(extras.__file__).parent / "manual" / "mqtt.md").read_text()
    file = re.findall(r"```yaml\n(.*?)```", page, re.DOTALL)[0]
    env = tmp_path / "house.yaml"
    env.write_text(file.replace("mqtt://localhost", f"mqtt://{broker.name}"))
    topic, value = re.findall(r"mosquitto_pub -t (\S+) -m (\S+)", page)[0]
    heard_on, shown = re.findall(r"mosquitto_sub -t (\S+) -C 1 +# prints (\S+)", page)[0]
    with running(env) as process, hearing(broker, heard_on) as heard:
        await_event(process, "Reviewed")
        publish(broker, topic, float(value))
        assert await_message(heard, heard_on) == shown
        end(process)
