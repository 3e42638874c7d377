"""SUAVE's problem as nodes of ROS 2: the search follows the visibility, and a lost thruster is replaced."""

from __future__ import annotations

import shutil
import subprocess
from itertools import pairwise
from pathlib import Path

from operated_world import await_event, command, eventually, running
from ros2_words import observing

SUAVE = Path(__file__).parents[2] / "models" / "suave"
BESIDE = {frozenset({3.0, 2.0}), frozenset({2.0, 1.0})}
"""The altitudes between which the visibility crosses one bound."""
PERIOD_S = 24


def test_the_search_changes_its_altitude_with_the_visibility_and_loses_nothing(tmp_path: Path) -> None:
    shutil.copytree(SUAVE, tmp_path / "suave")
    env = tmp_path / "suave" / "ros2" / "1-search.yaml"
    env.write_text(env.read_text().replace("period_s: 80", f"period_s: {PERIOD_S}"))
    with observing() as observer, running("--middleware", "ros2", env) as process:
        searched = observer.listen("/search", "geometry_msgs/msg/Point")
        run = await_event(process, "Running")["run"]
        altitudes, areas = list[float](), list[float]()
        while len(altitudes) < 5:
            altitude, area, _ = map(float, next(searched).split())
            areas.append(area)
            if altitudes[-1:] != [altitude]:
                altitudes.append(altitude)
        assert {frozenset(pair) for pair in pairwise(altitudes)} <= BESIDE
        assert areas == sorted(areas), "a new altitude continues from what was searched"
        assert areas[-1] > areas[0]

        subprocess.run(command("ctl", "--run", run, "fact", "thruster_1=false"), check=True, capture_output=True)

        def started() -> list[str]:
            review = await_event(process, "Reviewed", decision="applied")
            return [unit["transformation"] for unit in review["change_set"]["started"]]

        eventually(lambda: "recover" in started())
