"""A live graph of ROS 1 nodes is imported, ends, and runs again from its file."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from pathlib import Path

import pytest
from operated_world import await_event, eventually, running
from warm import command
from warm_nodes import start
from words import listening, node_names, system_state

from cfgplan.cli import main
from cfgplan.ros.node_api import SilentError

PROGRAM = """\
#!/usr/bin/python3
import rospy
from std_msgs.msg import String
rospy.init_node("echo")
publisher = rospy.Publisher("out", String, queue_size=9)
rospy.Subscriber("in", String, lambda message: publisher.publish(message.data + "!"))
rate = rospy.Rate(20)
while not rospy.is_shutdown():
    publisher.publish("word")
    rate.sleep()
"""


@pytest.fixture
def live(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[ExitStack]:
    """Two nodes of a package under a master, in a namespace, until the stack is closed."""
    package = tmp_path / "my_robot"
    package.mkdir()
    (package / "package.xml").write_text("<package><name>my_robot</name></package>")
    (package / "echo.py").write_text(PROGRAM)
    (package / "echo.py").chmod(0o755)
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path))
    port = os.environ["ROS_MASTER_URI"].rpartition(":")[2]
    master = start(["rosmaster", "--core", "-p", port], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    names = {"first": ("in:=nothing", "out:=words"), "second": ("in:=words", "out:=loud")}
    commands = [[str(package / "echo.py"), f"__name:={name}", "__ns:=lab", *more] for name, more in names.items()]
    with ExitStack() as stack:
        stack.callback(master.wait)
        stack.callback(master.kill)
        for command in commands:
            process = stack.enter_context(
                subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            )
            stack.callback(process.kill)
        eventually(lambda: _topics() >= {"/lab/words", "/lab/loud", "/lab/nothing"})
        yield stack


def _topics() -> set[str]:
    with suppress(SilentError):
        published, subscribed, _ = system_state()
        return {*published, *subscribed}
    return set()


@pytest.mark.usefixtures("warm_cfgplan")
def test_an_imported_graph_runs_again_with_its_nodes_wired_as_they_were(live: ExitStack, tmp_path: Path) -> None:
    env = tmp_path / "robot.yaml"
    assert main(["import", "ros1", "live", "--works", "--out", str(env)]) == 0
    live.close()
    text = env.read_text()
    env.write_text(text[: text.index("units:")] + text[text.index("targets:") :])
    with running("--middleware", "ros1", env, call=command) as process:
        await_event(process, "Running")
        assert {"/lab_first_1", "/lab_second_1"} <= node_names()
        with listening("/lab_second_1/out/loud") as words:
            assert next(word for word in words if word.endswith("!")) == "word!"
        process.terminate()
        process.communicate()
    assert process.returncode == 0
