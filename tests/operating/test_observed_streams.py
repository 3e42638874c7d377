"""Units that say how good their elements are: a run replaces one that is too bad now, and `solve` agrees with it."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from operated_world import await_event, command, eventually, running

UNITS = """\
from pathlib import Path
from cfgplan_runtime import WithQuality

def sonar(folder):
    water = Path(folder) / "water"
    while True:
        error = float(water.read_text() or 0.2)
        yield {"x": 1.0, "how": {"error": error}}

def camera():
    while True:
        yield WithQuality(2.0, {"error": 0.31})

def clumsy():
    while True:
        yield {"x": 1.0, "how": {}}
"""
ENVIRONMENT = """\
format: cfgplan/1
horizon: 600
qualities:
  - {{name: error, better: lower, unit: m}}
transformations:
  - label: sonar
    source: units.py:sonar
    {place}
    params: {{folder: "{folder}"}}
    run: {{rate: 50}}
    labor: 0.1
    upkeep: 0.001
    outputs: {{p: {{tag: Position, quality: {{error: {{set: 0.2, observe: how.error}}}}}}}}
  - label: camera
    source: units.py:camera
    run: {{rate: 50}}
    labor: 0.1
    upkeep: 0.1
    outputs: {{p: {{tag: Position, quality: {{error: {{set: 0.3}}}}}}}}
targets:
  - {{label: position, topic: /position, tag: Position, quality: {{error: {{at_most: 0.5}}}}}}
{more}
"""
HOSTS = "hosts: [{name: r1}, {name: r2}]"


def write(folder: Path, more: str = "", units: str = UNITS, place: str = "") -> Path:
    (folder / "units.py").write_text(units)
    (folder / "water").write_text("0.2")
    path = folder / "env.yaml"
    path.write_text(ENVIRONMENT.format(folder=folder, more=more, place=f"host: {place}" if place else ""))
    return path


def said(*arguments: object) -> str:
    return subprocess.run(command(*arguments), capture_output=True, text=True, check=True).stdout


@pytest.mark.parametrize("more", ["", HOSTS], ids=["one computer", "hosts"])
def test_a_stream_that_says_it_is_worse_than_its_bound_is_replaced_and_solve_agrees(tmp_path: Path, more: str) -> None:
    env, observed = write(tmp_path, more, place="r1" if more else ""), tmp_path / "observed.json"
    with running(env, *(["--local"] if more else [])) as process:
        run = await_event(process, "Running")["run"]
        of_run = ("--run", run)
        eventually(lambda: json.loads(said("ctl", *of_run, "observed", "--json"))["qualities"])
        (tmp_path / "water").write_text("0.8")
        await_event(process, "Perturbed")
        applied = await_event(process, "Reviewed", decision="applied")
        assert [unit["transformation"] for unit in applied["change_set"]["started"]] == ["camera"]
        assert applied["change_set"]["stopped"] == ["sonar.1"]
        said("ctl", *of_run, "observed", "--out", observed)
        planned = json.loads(said("ctl", *of_run, "plan", "--json"))
    told = {one["output"]: one for one in json.loads(observed.read_text())["qualities"]}
    assert told["sonar/p"]["declared"] == 0.2
    assert told["sonar/p"]["planned"] > 0.5
    solved = json.loads(said("solve", env, "--observed", observed, "--json"))
    assert [unit["transformation"] for unit in solved["change_set"]["started"]] == ["camera"]
    assert solved["qualities"] == planned["qualities"]
    before = json.loads(said("solve", env, "--json"))
    assert [unit["transformation"] for unit in before["change_set"]["started"]] == ["sonar"]


BY_HOST = UNITS.replace(
    "def sonar(folder):\n",
    "def sonar(folder):\n    first = Path(folder) / 'first'\n    is_clean = first.exists()\n    first.touch()\n",
).replace("float(water.read_text() or 0.2)", "0.2 if is_clean else float(water.read_text() or 0.2)")
"""The sonar that runs first gets dirty; one on the other host stays clean."""


def test_a_unit_with_a_dirty_sonar_is_replaced_by_one_on_the_other_host_and_solve_agrees(tmp_path: Path) -> None:
    env, observed = write(tmp_path, HOSTS, BY_HOST), tmp_path / "observed.json"
    with running(env, "--local") as process:
        of_run = ("--run", (await_event(process, "Running"))["run"])
        (first,) = (await_event(process, "Reviewed", decision="applied"))["change_set"]["started"]
        eventually(lambda: json.loads(said("ctl", *of_run, "observed", "--json"))["qualities"])
        (tmp_path / "water").write_text("0.8")
        (second,) = (await_event(process, "Reviewed", decision="applied"))["change_set"]["started"]
        assert (first["transformation"], second["transformation"]) == ("sonar", "sonar")
        assert {first["host"], second["host"]} == {"r1", "r2"}
        eventually(lambda: len(json.loads(said("ctl", *of_run, "observed", "--json"))["qualities"]) == 2)
        said("ctl", *of_run, "observed", "--out", observed)
        shown = said("ctl", *of_run, "observed")
        explained = said("explain", env, "--observed", observed)
    known = {one["host"]: one for one in json.loads(observed.read_text())["qualities"]}
    assert known[first["host"]]["planned"] > 0.5
    assert known[second["host"]]["planned"] == pytest.approx(0.2, rel=0.06)
    assert shown.split()[:3] == ["output", "host", "quality"]
    assert f"sonar/p error on {first['host']} {known[first['host']]['planned']:g}" in explained
    solved = json.loads(said("solve", env, "--observed", observed, "--json"))
    assert [unit["host"] for unit in solved["change_set"]["started"]] == [second["host"]]
    assert list(solved["qualities"]) == [f"sonar/p error on {first['host']}"]


def test_a_value_without_the_field_is_told_once_with_output_and_field(tmp_path: Path) -> None:
    env = write(
        tmp_path, units=UNITS.replace("def sonar(folder)", "def other(folder)").replace("clumsy()", "sonar(folder)")
    )
    with running(env) as process:
        told = await_event(process, "UnitFailed")
        assert "output p does not say its error: a value has no field 'how.error'" in json.dumps(told)


PROGRAM = """\
import json, sys
from pathlib import Path

print('{"ready": true}', flush=True)
for line in sys.stdin:
    error = float(Path("water").read_text() or 0.2)
    answer = {"step": json.loads(line)["step"], "outputs": {"p": {"x": 1.0}}, "quality": {"p": {"error": error}}}
    print(json.dumps(answer), flush=True)
"""


def test_a_program_says_how_good_its_results_are_beside_them(tmp_path: Path) -> None:
    env = write(tmp_path)
    (tmp_path / "sonar.py").write_text(PROGRAM)
    text = env.read_text().replace("units.py:sonar", f"program:{sys.executable} sonar.py").replace("how.error", "none")
    env.write_text(text.replace(", observe: none", ""))
    with running(env) as process:
        run = await_event(process, "Running")["run"]
        (tmp_path / "water").write_text("0.8")
        applied = await_event(process, "Reviewed", decision="applied")
        while not applied["change_set"]["stopped"]:
            applied = await_event(process, "Reviewed", decision="applied")
        assert [unit["transformation"] for unit in applied["change_set"]["started"]] == ["camera"]
        observed = json.loads(said("ctl", "--run", run, "observed", "--json"))["qualities"]
    (planned,) = [one["planned"] for one in observed if one["output"] == "sonar/p"]  # camera/p follows once it runs
    assert planned > 0.5


MEASURED = """\
import time
from pathlib import Path

def source():
    while True:
        yield 1

class Fast:
    def __init__(self, folder, does):
        self.water, self.does, self.held = Path(folder) / "water", does, []

    def __call__(self, n):
        if not float(self.water.read_text() or 0):
            return n
        if self.does == "block":
            time.sleep(0.15)
        self.held.append(n)
        return n if self.does == "block" or len(self.held) % 10 == 0 else None

class Sure:
    def __call__(self, n):
        return n
"""
MEASURED_ENVIRONMENT = """\
format: cfgplan/1
horizon: 600
qualities:
  - {{name: rate, better: higher, unit: Hz, worst: 0, best: 1000}}
  - {{name: age, better: lower, unit: s, worst: 100}}
  - {{name: loss, better: lower, worst: 1}}
transformations:
  - {{label: source, source: "units.py:source", run: {{rate: 50}}, labor: 0.1, upkeep: 0.001, outputs: {{n: N}}}}
  - label: fast
    source: units.py:Fast
    {place}
    params: {{folder: "{folder}", does: {does}}}
    run: {{queue: 1000}}
    labor: 0.1
    upkeep: 0.001
    inputs: {{n: N}}
    outputs: {{p: {{tag: P, quality: {quality}}}}}
  - label: sure
    source: units.py:Sure
    labor: 0.1
    upkeep: 0.1
    inputs: {{n: N}}
    outputs: {{p: {{tag: P, quality: {{rate: {{set: 50}}, age: {{set: 0.01}}}}}}}}
targets:
  - {{label: p, topic: /p, tag: P, quality: {bound}}}
{more}
"""


@pytest.mark.parametrize("more", ["", HOSTS], ids=["one computer", "hosts"])
@pytest.mark.parametrize(
    ("does", "quality", "bound"),
    [
        ("skip", "{rate: {set: 50, observe: measured.rate}}", "{rate: {at_least: 15}}"),
        ("block", "{age: {set: 0.01, observe: measured.age}}", "{age: {at_most: 1}}"),
    ],
    ids=["rate", "age"],
)
def test_a_stream_that_is_measured_to_be_worse_than_its_bound_is_replaced(
    tmp_path: Path, does: str, quality: str, bound: str, more: str
) -> None:
    """Nothing in the elements says it: the worker becomes slow, or gives a tenth of what it gave."""
    env = write(tmp_path, units=MEASURED)
    (tmp_path / "water").write_text("0")
    place = "host: r1" if more else ""
    env.write_text(
        MEASURED_ENVIRONMENT.format(folder=tmp_path, does=does, quality=quality, bound=bound, more=more, place=place)
    )
    with running(env, *(["--local"] if more else [])) as process:
        run = await_event(process, "Running")["run"]
        await_event(process, "Reviewed", decision="applied")
        eventually(lambda: json.loads(said("ctl", "--run", run, "observed", "--json"))["qualities"])
        (tmp_path / "water").write_text("1")
        applied = await_event(process, "Reviewed", decision="applied")
        assert [unit["transformation"] for unit in applied["change_set"]["started"]] == ["sure"]
        assert applied["change_set"]["stopped"] == ["fast.1"]
