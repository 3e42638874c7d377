"""Topic statistics of a running node tell how good the streams are that it gets: plans and looks follow them."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import pytest
from operated_world import await_event, command, eventually, running

ENVIRONMENT = """\
format: cfgplan/1
horizon: 600
qualities:
  - {{name: age, better: lower, unit: s}}
  - {{name: period, better: lower, unit: s}}
transformations:
  - label: cheap
    source: node:./ticking.py ticker
    params: {{lag: "{folder}/lag"}}
    labor: 0.1
    upkeep: 0.001
    outputs:
      ticks:
        tag: Tick
        type: geometry_msgs/PointStamped
        quality:
          age: {{set: 0.1, observe: statistics.watcher_1.age}}
          period: {{set: 0.05, observe: statistics.watcher_1.period}}
  - label: dear
    source: node:./ticking.py ticker
    labor: 0.1
    upkeep: 0.1
    outputs: {{ticks: {{tag: Tick, type: geometry_msgs/PointStamped, quality: {{age: {{set: 0.2}}}}}}}}
  - label: watcher
    source: node:./ticking.py watcher
    labor: 0.1
    upkeep: 0.01
    inputs: {{ticks: {{tag: Tick, type: geometry_msgs/PointStamped}}}}
    outputs: {{words: {{tag: Word, type: std_msgs/String, quality: {{age: {{add: 0.05}}}}}}}}
targets:
  - {{label: words, topic: /words, tag: Word, quality: {{age: {{at_most: 0.5}}}}}}
"""


def said(*arguments: object) -> str:
    return subprocess.run(command(*arguments), capture_output=True, text=True, check=True).stdout


@pytest.fixture
def env(tmp_path: Path) -> Path:
    shutil.copy(Path(__file__).with_name("ticking.py"), tmp_path)
    (tmp_path / "lag").write_text("0.02")
    path = tmp_path / "env.yaml"
    path.write_text(ENVIRONMENT.format(folder=tmp_path))
    return path


@pytest.mark.usefixtures("statistics")
def test_a_node_whose_messages_come_too_old_is_replaced_and_solve_agrees(env: Path) -> None:
    observed = env.with_name("observed.json")
    with running("--middleware", "ros2", env) as process:
        of_run = ("--run", await_event(process, "Running")["run"])
        first = await_event(process, "Reviewed", decision="applied")
        assert {unit["transformation"] for unit in first["change_set"]["started"]} == {"cheap", "watcher"}

        def learned() -> dict[str, dict[str, float]]:
            return {
                one["attribute"]: one for one in json.loads(said("ctl", *of_run, "observed", "--json"))["qualities"]
            }

        eventually(lambda: {"age", "period"} <= learned().keys())
        fresh = learned()
        assert fresh["period"]["estimate"] == pytest.approx(0.02, rel=0.5)
        assert 0.02 <= fresh["age"]["estimate"] < 0.4
        env.with_name("lag").write_text("2")
        applied = await_event(process, "Reviewed", decision="applied")
        assert [unit["transformation"] for unit in applied["change_set"]["started"]] == ["dear"]
        assert [unit["id"] for unit in applied["change_set"]["rewired"]] == ["watcher.1"]
        assert applied["change_set"]["stopped"] == ["cheap.1"]
        said("ctl", *of_run, "observed", "--out", observed)
    (age,) = (one for one in json.loads(observed.read_text())["qualities"] if one["attribute"] == "age")
    assert (age["output"], age["declared"], age["planned"] > 0.45) == ("cheap/ticks", 0.1, True)
    solved = json.loads(said("solve", env, "--observed", observed, "--json"))
    assert {unit["transformation"] for unit in solved["change_set"]["started"]} == {"dear", "watcher"}
