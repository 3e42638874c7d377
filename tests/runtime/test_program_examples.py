"""The programs of models/programs: each does in its language what its first lines say."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from dataclasses import replace
from itertools import islice, pairwise
from pathlib import Path
from typing import Any

import numpy
import pytest
from cfgplan_runtime import subscribe
from watching import StartRuntime
from world import RESULT, source, start, unit, worker

from cfgplan.domain import InputPort, OutputPort, RunOptions, Transformation

EXAMPLES = Path(__file__).parents[2] / "models" / "programs"
USUAL = RunOptions()
THROUGHPUT = Path(__file__).parents[2] / "experiments" / "programs" / "throughput.py"
NEEDS_CC = pytest.mark.skipif(shutil.which("cc") is None, reason="cc is not installed")
NEEDS_NODE = pytest.mark.skipif(shutil.which("node") is None, reason="node is not installed")
NEEDS_JQ = pytest.mark.skipif(shutil.which("jq") is None, reason="jq is not installed")


def results(run_units: StartRuntime, number: int, given: str, made: Transformation) -> list[Any]:
    """The first results of a program whose input x is fed by the source of unit code `given`."""
    runtime = run_units(source(code=given), made)
    runtime.apply(start(unit("count.1"), unit("work.1", topic="/result", x="count.1/n")))
    with subscribe(RESULT.topic or "", run=runtime.id, wait_s=60) as subscription:
        return [received.value for received in islice(subscription, number)]


def example(command: str, run: RunOptions = USUAL, **params: object) -> Transformation:
    return replace(worker(run=run, **params), source=f"program:{command}")


@pytest.fixture
def mask(tmp_path: Path) -> str:
    subprocess.run(
        ["cc", "-Wall", "-Wextra", "-Werror", "-O3", "-o", tmp_path / "mask", EXAMPLES / "mask.c"], check=True
    )
    return str(tmp_path / "mask")


@NEEDS_CC
def test_the_c_program_gives_the_bright_pixels_of_images(run_units: StartRuntime, mask: str) -> None:
    for image in results(run_units, 5, "image_units.py:shades", example(f"{mask} 128 y", RunOptions(format="msgpack"))):
        assert (image.dtype, image.shape) == (numpy.uint8, (480, 960))
        assert (image == numpy.where(numpy.arange(960) % 256 >= 128, 255, 0)).all()


@NEEDS_CC
def test_the_c_program_passes_on_whatever_else_comes(run_units: StartRuntime, mask: str) -> None:
    from running_units import VARIOUS

    made = example(f"{mask} 128 y", RunOptions(format="msgpack", queue=1000))
    first, *later = results(run_units, len(VARIOUS) + 1, "various", made)
    at = next(n for n, one in enumerate(VARIOUS) if type(one) is type(first) and one == first)  # True is 1
    assert later == [*VARIOUS[at + 1 :], *VARIOUS[: at + 1]]


@pytest.mark.parametrize(
    "command",
    [pytest.param(f"{EXAMPLES}/level.js", marks=NEEDS_NODE), f"{sys.executable} {EXAMPLES}/level.py"],
    ids=["Node.js", "Python"],
)
def test_the_level_is_the_mean_of_the_last_numbers(run_units: StartRuntime, command: str) -> None:
    made = replace(example(command, last=3), inputs=(InputPort("bright", "N"),), outputs=(OutputPort("level", "Y"),))
    runtime = run_units(source(), made)
    runtime.apply(start(unit("count.1"), unit("work.1", topic="/result", port="level", bright="count.1/n")))
    with subscribe("/result", run=runtime.id, wait_s=60) as subscription:
        values = [received.value for received in islice(subscription, 8)][3:]
    assert [later - value for value, later in pairwise(values)] == [1] * 4


@NEEDS_JQ
def test_the_alarm_is_whether_the_level_is_above_its_parameter(run_units: StartRuntime) -> None:
    made = example(f"{EXAMPLES}/alarm.sh 20")
    made = replace(made, inputs=(InputPort("level", "N"),), outputs=(OutputPort("alarm", "Y"),))
    runtime = run_units(source(rate_hz=20), made)
    runtime.apply(start(unit("count.1"), unit("work.1", topic="/result", port="alarm", level="count.1/n")))
    with subscribe("/result", run=runtime.id, wait_s=60) as subscription:
        values = [next(iter(subscription)).value]
        while not values[-1]:
            values.append(next(iter(subscription)).value)
    assert values == [False] * (len(values) - 1) + [True]


def test_the_camera_gives_images_of_a_lamp_that_is_on_or_off(run_units: StartRuntime) -> None:
    camera = Transformation(
        "camera",
        outputs=(OutputPort("image", "Y"),),
        source=f"program:{sys.executable} {EXAMPLES}/camera.py",
        run=RunOptions(format="msgpack"),
    )
    runtime = run_units(camera)
    runtime.apply(start(unit("camera.1", topic="/result", port="image")))
    with subscribe("/result", run=runtime.id, wait_s=60) as subscription:
        image = next(iter(subscription)).value
    assert (image.dtype, image.shape) == (numpy.uint8, (480, 960))
    assert (image > 128).sum() in (0, 160 * 160)


@NEEDS_CC
def test_small_elements_and_images_go_through_one_c_program_and_are_compared_with_a_python_unit(tmp_path: Path) -> None:
    file = tmp_path / "rates.json"
    line = [sys.executable, str(THROUGHPUT), "--rounds", "1", "--seconds", "0.1", "--json", str(file)]
    subprocess.run(line, check=True)
    rates = {row["what"]: row for row in json.loads(file.read_text())}
    assert set(rates) == {"small elements, msgpack", "small elements, JSON", "images of 460 kB, msgpack"}
    assert all(row["ratio"] == row["program"] / row["python"] > 0 for row in rates.values())
