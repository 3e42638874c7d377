"""A world of ROS nodes of which one says how good it is, the same for ROS 1 and ROS 2."""

from __future__ import annotations

import json
import queue
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

from cfgplan_runtime import Manager, Policy, Runtime
from cfgplan_runtime.lifecycle.reports import Report, Reviewed
from cfgplan_runtime.ros1.ros1_backend import Ros1Backend
from cfgplan_runtime.ros2.ros2_backend import Ros2Backend
from operated_world import PATIENCE_S, Call, await_event, command, eventually, running
from warm import command as warm_command

from cfgplan import load
from cfgplan.domain import ChangeSet

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


_MEASURED = """\
format: cfgplan/1
horizon: 600
qualities:
  - {name: rate, better: higher, unit: Hz, best: 1000}
  - {name: age, better: lower, unit: s}
  - {name: jitter, better: lower, unit: s}
transformations:
  - label: cheap
    source: node:./talking.py talker
    params: {rate: 100}
    labor: 0.1
    upkeep: 0.001
    outputs:
      words:
        tag: Word
        type: std_msgs/String
        remap: chatter
        quality:
          rate: {set: 200, observe: measured.rate}
          age: {set: 0.01, observe: measured.age}
          jitter: {set: 0.01, observe: measured.jitter}
  - label: dear
    source: node:./talking.py talker
    params: {rate: 200}
    labor: 0.1
    upkeep: 0.1
    outputs: {words: {tag: Word, type: std_msgs/String, remap: chatter, quality: {rate: {set: 200}}}}
targets:
  - {label: words, topic: /words, tag: Word, quality: {rate: {at_least: 180}}}
"""


WITH_FACT = """\
format: cfgplan/1
facts:
  left:
    declared: true
    topic: /diagnostics
    type: diagnostic_msgs/DiagnosticArray
    field: status.thrusters.values.left.value
    qos: best_effort
transformations:
  - {label: strong, source: "node:./talking.py talker", params: {rate: 20}, requires: left, labor: 0.1, upkeep: 0.01,
     outputs: {words: {tag: Word, type: std_msgs/String, remap: chatter}}}
  - {label: weak, source: "node:./talking.py talker", params: {rate: 20}, labor: 0.1, upkeep: 0.1,
     outputs: {words: {tag: Word, type: std_msgs/String, remap: chatter}}}
targets:
  - {label: words, topic: /words, tag: Word}
"""


def write_with_fact(folder: Path, nodes: Path, text: str = WITH_FACT) -> Path:
    """Write an environment file whose fact is observed on a topic, with its nodes beside it. Returns its path."""
    shutil.copy(nodes, folder / "talking.py")
    path = folder / "env.yaml"
    path.write_text(text)
    return path


def check_that_a_fact_is_followed(env: Path, health: Path, middleware: str, call: Call = command) -> None:
    """A node that is not of the run says on `/diagnostics` what the file `health` says: whether a thruster works."""
    with running("--middleware", middleware, env, call=call) as process:
        run = await_event(process, "Running")["run"]
        first = await_event(process, "Reviewed", decision="applied")
        assert [unit["transformation"] for unit in first["change_set"]["started"]] == ["strong"]
        health.write_text("False")
        broken = await_event(process, "Reviewed", decision="applied")
        assert broken["perturbations"][0]["left_out"] == ["strong"]
        assert [unit["transformation"] for unit in broken["change_set"]["started"]] == ["weak"]
        assert json.loads(_said("ctl", "--run", run, "state", "--json"))["facts"]["left"] == "false"
        health.write_text("True")
        mended = await_event(process, "Reviewed", decision="applied")
        assert [unit["transformation"] for unit in mended["change_set"]["started"]] == ["strong"]


def write_finders(folder: Path, nodes: Path, field: str = "pose.covariance.0") -> Path:
    """Write the environment file, with its nodes and the file of the sonar's error beside it. Returns its path."""
    shutil.copy(nodes, folder / "talking.py")
    (folder / "water").write_text("0.2")
    path = folder / "env.yaml"
    path.write_text(_ENVIRONMENT.format(folder=folder).replace("pose.covariance.0", field))
    return path


def check_that_a_bad_node_is_replaced(env: Path, middleware: str, call: Call = command) -> None:
    """Run the sonar, let it say that it is worse than the bound, and compare what the run, ctl and solve make of it."""
    observed = env.with_name("observed.json")
    with running("--middleware", middleware, env, call=call) as process:
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


def check_that_diagnostics_are_learned(env: Path, middleware: str, call: Call = command) -> None:
    """Let a node that is not of the run tell on `/diagnostics` that the sonar is worse than the bound."""
    with running("--middleware", middleware, env, call=call) as process:
        of_run = ("--run", await_event(process, "Running")["run"])
        eventually(lambda: json.loads(_said("ctl", *of_run, "observed", "--json"))["qualities"])
        env.with_name("water").write_text("0.8")
        await_event(process, "Perturbed")
        applied = await_event(process, "Reviewed", decision="applied")
        assert [unit["transformation"] for unit in applied["change_set"]["started"]] == ["camera"]
        (told,) = json.loads(_said("ctl", *of_run, "observed", "--json"))["qualities"]
        assert (told["output"], told["planned"] > 0.5) == ("sonar/p", True)


def check_that_a_slow_node_is_replaced(folder: Path, nodes: Path, middleware: str, call: Call = command) -> None:
    """A node that publishes 100 messages a second is to publish 180: the run measures it, and takes another."""
    shutil.copy(nodes, folder / "talking.py")
    env = folder / "env.yaml"
    env.write_text(_MEASURED)
    with running("--middleware", middleware, env, call=call) as process:
        run = await_event(process, "Running")["run"]
        first = await_event(process, "Reviewed", decision="applied")
        applied = await_event(process, "Reviewed", decision="applied")
        started = [unit["transformation"] for review in (first, applied) for unit in review["change_set"]["started"]]
        assert (started, applied["change_set"]["stopped"]) == (["cheap", "dear"], ["cheap.1"])
        told = json.loads(_said("ctl", "--run", run, "observed", "--json"))["qualities"]
    (rate,) = (one for one in told if one["attribute"] == "rate")
    assert 5 < rate["estimate"] < 150
    assert {one["attribute"] for one in told} == {"rate", "age", "jitter"}


def check_that_a_look_brings_a_node_back(env: Path, backend: Callable[..., Ros1Backend | Ros2Backend]) -> None:
    """Run the sonar until it is too bad, then let it become good: it runs for nobody, then in place of the camera."""
    reports: queue.SimpleQueue[Report] = queue.SimpleQueue()
    policy = Policy(look_every_s=1.0)

    def awaited(is_it: Callable[[Report], object]) -> Report:
        while not is_it(report := reports.get(timeout=PATIENCE_S)):
            pass
        return report

    def applied(report: Report) -> ChangeSet | None:
        return report.review.change_set if isinstance(report, Reviewed) else None

    def starts(label: str) -> Callable[[Report], object]:
        return lambda told: (found := applied(told)) and any(one.transformation == label for one in found.started)

    with (
        Runtime(folder=env.parent, backend=lambda: backend(folder=env.parent)) as runtime,
        Manager(load(env), runtime, policy=policy, report=reports.put) as manager,
    ):
        awaited(starts("sonar"))
        env.with_name("water").write_text("0.8")
        awaited(starts("camera"))
        env.with_name("water").write_text("0.2")
        look = applied(awaited(starts("sonar")))
        assert look is not None
        (unit,) = look.started
        assert (unit.publications, look.stopped) == ((), ())
        awaited(lambda told: (found := applied(told)) and "camera.1" in found.stopped)
        assert [one.transformation for one in manager.snapshot().environment.units] == ["sonar"]


def unsaid(env: Path, middleware: str, call: Call = command) -> dict[str, str]:
    """Return the first failure that a run reports."""
    with running("--middleware", middleware, env, call=call) as process:
        return await_event(process, "UnitFailed")


def _said(*arguments: object) -> str:
    return subprocess.run(warm_command(*arguments), capture_output=True, text=True, check=True).stdout
