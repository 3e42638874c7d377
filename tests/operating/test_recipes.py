"""The recipes of the manual (recipes.md): their files are valid, and run with stand-ins where a program is not here."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml
from cfgplan_runtime import subscribe
from mosquitto import NEEDS_MOSQUITTO
from mosquitto import running as running_broker
from operated_world import await_event, running

PAGE = (Path(__file__).parents[2] / "cfgplan" / "manual" / "recipes.md").read_text()
FILES = dict(re.findall(r"<!-- file: (\S+) -->\n```\w+\n(.*?)^```$", PAGE, re.DOTALL | re.MULTILINE))
OTHERS = dict(re.findall(r"<!-- tested by: \S+ -->\n```(\w+)\n(.*?)^```$", PAGE, re.DOTALL | re.MULTILINE))
DOCKER = """\
#!{python}
# Does what `docker run` does of the options of the recipe: starts the image's entry point with the arguments behind.
import json, os, re, sys
verb, *words = sys.argv[1:]
assert verb == "run" and "--interactive" in words and "--rm" in words and "--tty" not in words, words
takes_value = {{"--network", "--memory", "--cpus"}}
while words[0].startswith("-"):
    del words[: 2 if words[0] in takes_value else 1]
image, *arguments = words
assert image == "detector"
text = open("Dockerfile").read()
copied = dict((there, here) for here, there in re.findall(r"^COPY (\\S+) (\\S+)$", text, re.MULTILINE))
entry = json.loads(re.search(r"^ENTRYPOINT (.*)$", text, re.MULTILINE)[1])
program, *given = [copied.get(word, word) for word in entry]
os.execvp(program, [program, *given, *arguments])
"""
PIPELINE = """\
#!{python}
# Writes frames as the pipeline of the recipe does: gray, in the size of its caps.
import re, sys, time
line = " ".join(sys.argv[1:])
assert line.endswith("! fdsink fd=1") and " ! " in line and "--quiet" in line, line
width, height = (int(re.search(rf"format=GRAY8.*{{name}}=(\\d+)", line)[1]) for name in ("width", "height"))
while True:
    sys.stdout.buffer.write(bytes([7]) * (width * height))
    sys.stdout.buffer.flush()
    time.sleep(0.02)
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name, text in FILES.items():
        (tmp_path / name).write_text(text)
    (tmp_path / "Dockerfile").write_text(OTHERS["dockerfile"])
    return tmp_path


def stand_in(name: str, text: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A program of this name that is found before all others."""
    programs = folder / "programs"
    programs.mkdir()
    (programs / name).write_text(text.format(python=sys.executable))
    (programs / name).chmod(0o755)
    monkeypatch.setenv("PATH", f"{programs}:{os.environ['PATH']}")


def first_value(env: Path, topic: str) -> Any:
    """The first value on a topic of a run, which then ends well."""
    with running(env) as process:
        run = await_event(process, "Running")["run"]
        with subscribe(topic, run=run, wait_s=60, timeout_s=60) as subscription:
            value = next(iter(subscription)).value
        process.terminate()
        process.communicate(timeout=60)
        assert process.returncode == 0
    return value


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="there is no systemd-analyze")
def test_the_service_is_one_that_systemd_takes(tmp_path: Path) -> None:
    text = OTHERS["ini"]
    assert "/opt/cfgplan/bin/cfgplan run /etc/cfgplan/heating.yaml" in text
    unit = tmp_path / "cfgplan.service"
    # Everything that has to be there is there: an executable, and a user.
    unit.write_text(text.replace("/opt/cfgplan/bin/cfgplan", sys.executable).replace("User=cfgplan", "User=daemon"))
    verified = subprocess.run(["systemd-analyze", "verify", "--man=no", unit], capture_output=True, text=True)
    assert [line for line in verified.stderr.splitlines() if "cfgplan.service" in line] == []
    assert verified.returncode == 0, verified.stderr
    unit.write_text(unit.read_text().replace("KillMode=mixed", "KillMode=mxed"))
    broken = subprocess.run(["systemd-analyze", "verify", "--man=no", unit], capture_output=True, text=True)
    assert "kill mode" in broken.stderr, "a fault would be told"


def test_the_options_of_the_service_are_those_of_the_command() -> None:
    from cfgplan.cli.main import parser_of

    (line,) = re.findall(r"^ExecStart=\S+ (.*)$", OTHERS["ini"], re.MULTILINE)
    options = parser_of(line.split()).parse_args(line.split())
    assert (options.mqtt, options.mqtt_password_env, options.plain) == ("localhost", "MQTT_PASSWORD", True)


def test_the_container_is_a_unit(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stand_in("docker", DOCKER, folder, monkeypatch)
    assert first_value(folder / "container.yaml", "/ball") is True


def test_the_pipeline_gives_images(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stand_in("gst-launch-1.0", PIPELINE, folder, monkeypatch)
    assert first_value(folder / "camera.yaml", "/brightness") == 7.0


@pytest.mark.skipif(shutil.which("gst-launch-1.0") is None, reason="there is no GStreamer")
def test_the_pipeline_runs_in_gstreamer(folder: Path) -> None:
    assert 0 < first_value(folder / "camera.yaml", "/brightness") < 255


@NEEDS_MOSQUITTO
@pytest.mark.xdist_group("mqtt")
def test_home_assistant_and_the_run_meet_on_their_topics(folder: Path) -> None:
    pytest.importorskip("paho", reason="paho-mqtt is not installed (extra mqtt)")
    from paho.mqtt.publish import single
    from paho.mqtt.subscribe import simple

    assistant = yaml.safe_load(OTHERS["yaml"])
    (sensor,) = assistant["mqtt"]["sensor"]
    stream = assistant["mqtt_statestream"]
    topics = [f"{stream['base_topic']}/{name.replace('.', '/')}/state" for name in stream["include"]["entities"]]
    env = folder / "heating.yaml"
    (folder / "broker").mkdir()
    with running_broker(folder / "broker") as broker:
        env.write_text(FILES["heating.yaml"].replace("localhost", broker.name))
        for topic, state in zip(topics, ("19", "off"), strict=True):
            single(topic, state, qos=1, retain=True, hostname="127.0.0.1", port=broker.port)
        with running(env, "--mqtt", broker.name, "--mqtt-retain") as process:
            await_event(process, "Running")
            power = simple(sensor["state_topic"], hostname="127.0.0.1", port=broker.port)
            there = simple(sensor["availability_topic"], hostname="127.0.0.1", port=broker.port)
            assert (json.loads(power.payload), there.payload.decode()) == (50, sensor["payload_available"])
            process.terminate()
            process.communicate(timeout=60)
        gone = simple(sensor["availability_topic"], hostname="127.0.0.1", port=broker.port)
        assert gone.payload.decode() == sensor["payload_not_available"]
