"""A world of ROS nodes of which one says how good it is, the same for ROS 1 and ROS 2."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

from operated_world import await_event, command, eventually, running

_ENVIRONMENT = """\
format: cfgplan/1
horizon: 600
qualities:
  - {{name: error, better: lower, unit: m}}
transformations:
  - label: sonar
    source: node:./talking.py finder
    params: {{water: "{folder}/water"}}
    labor: 0.1
    upkeep: 0.001
    outputs:
      p:
        tag: Position
        type: geometry_msgs/PoseWithCovarianceStamped
        remap: pose
        quality: {{error: {{set: 0.2, observe: pose.covariance.0}}}}
  - label: camera
    source: node:./talking.py finder
    labor: 0.1
    upkeep: 0.1
    outputs:
      p: {{tag: Position, type: geometry_msgs/PoseWithCovarianceStamped, remap: pose, quality: {{error: {{set: 0.3}}}}}}
targets:
  - {{label: position, topic: /position, tag: Position, quality: {{error: {{at_most: 0.5}}}}}}
"""


def write_finders(folder: Path, nodes: Path, field: str = "pose.covariance.0") -> Path:
    """Write the environment file, with its nodes and the file of the sonar's error beside it. Returns its path."""
    shutil.copy(nodes, folder / "talking.py")
    (folder / "water").write_text("0.2")
    path = folder / "env.yaml"
    path.write_text(_ENVIRONMENT.format(folder=folder).replace("pose.covariance.0", field))
    return path


def check_that_a_bad_node_is_replaced(env: Path, middleware: str) -> None:
    """Run the sonar, let it say that it is worse than the bound, and compare what the run, ctl and solve make of it."""
    observed = env.with_name("observed.json")
    with running("--middleware", middleware, env) as process:
        of_run = ("--run", await_event(process, "Running")["run"])
        eventually(lambda: json.loads(_said("ctl", *of_run, "observed", "--json"))["qualities"])
        env.with_name("water").write_text("0.8")
        await_event(process, "Perturbed")
        applied = await_event(process, "Reviewed", decision="applied")
        assert [unit["transformation"] for unit in applied["change_set"]["started"]] == ["camera"]
        assert applied["change_set"]["stopped"] == ["sonar.1"]
        _said("ctl", *of_run, "observed", "--out", observed)
        planned = json.loads(_said("ctl", *of_run, "plan", "--json"))
    (told,) = json.loads(observed.read_text())["qualities"]
    assert (told["output"], told["declared"], told["planned"] > 0.5) == ("sonar/p", 0.2, True)
    solved = json.loads(_said("solve", env, "--observed", observed, "--json"))
    assert [unit["transformation"] for unit in solved["change_set"]["started"]] == ["camera"]
    assert solved["qualities"] == planned["qualities"]


def unsaid(env: Path, middleware: str) -> dict[str, str]:
    """Return the first failure that a run reports."""
    with running("--middleware", middleware, env) as process:
        return await_event(process, "UnitFailed")


def _said(*arguments: object) -> str:
    return subprocess.run(command(*arguments), capture_output=True, text=True, check=True).stdout
