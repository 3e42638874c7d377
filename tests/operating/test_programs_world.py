"""The lamp of models/programs: programs in four languages run with one command, and one that is killed is replaced."""

from __future__ import annotations

import shutil
from itertools import islice
from pathlib import Path

import numpy
import psutil
import pytest
from cfgplan_runtime import subscribe
from operated_world import await_event, running

WORLD = Path(__file__).parents[2] / "models" / "programs"


@pytest.mark.skipif(shutil.which("cc") is None, reason="cc is not installed")
@pytest.mark.skipif(shutil.which("node") is None, reason="node is not installed")
@pytest.mark.skipif(shutil.which("jq") is None, reason="jq is not installed")
def test_the_lamp_is_watched_by_programs_and_a_killed_one_is_replaced(tmp_path: Path) -> None:
    folder = shutil.copytree(WORLD, tmp_path / "world", ignore=shutil.ignore_patterns("mask"))
    with running(folder / "light.yaml") as process:
        run = await_event(process, "Running")["run"]
        await_event(process, "Reviewed", decision="applied")
        with subscribe("/light/mask", run=run, wait_s=60) as subscription:
            mask = next(iter(subscription)).value
        assert (mask.dtype, mask.shape) == (numpy.uint8, (480, 960))
        assert set(numpy.unique(mask)) <= {0, 255}
        started = psutil.Process(process.pid).children(recursive=True)
        (node,) = [one for one in started if "level.js" in str(one.cmdline())]
        node.kill()
        change_set = await_event(process, "Reviewed", decision="applied")["change_set"]
        assert [unit["transformation"] for unit in change_set["started"]] in (["level"], ["level_slow"])
        with subscribe("/light/alarm", run=run, wait_s=60) as subscription:
            alarms = {received.value for received in islice(subscription, 45)}
    assert alarms == {False, True}
