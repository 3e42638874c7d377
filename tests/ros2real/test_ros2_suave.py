"""SUAVE's problem as nodes of ROS 2: the search follows the visibility, and a lost thruster is replaced."""

from __future__ import annotations

import shutil
import subprocess
from itertools import pairwise
from pathlib import Path

from operated_world import await_event, command, eventually, running
from ros2_words import observing

SUAVE = Path(__file__).parents[2] / "models" / "suave"
ALTITUDES = {1.0, 2.0, 3.0}
PERIOD_S = 30
"""The visibility passes both bounds twice in it. A node that starts too slowly for one passage serves the next."""
BESIDE_M2 = 0.5
"""Two nodes that publish side by side at a switch differ by less: each counts the motions that it got."""


def test_the_search_changes_its_altitude_with_the_visibility_and_loses_nothing(tmp_path: Path) -> None:
    shutil.copytree(SUAVE, tmp_path / "suave")
    env = tmp_path / "suave" / "ros2" / "1-search.yaml"
    env.write_text(env.read_text().replace("period_s: 80", f"period_s: {PERIOD_S}"))
    with observing() as observer, running("--middleware", "ros2", env) as process:
        searched = observer.listen("/search", "geometry_msgs/msg/Point")
        run = await_event(process, "Running")["run"]
        altitudes, areas = set[float](), list[float]()
        while altitudes != ALTITUDES:
            altitude, area, _ = map(float, next(searched).split())
            areas.append(area)
            altitudes.add(altitude)
        lost_m2 = max(before - area for before, area in pairwise(areas))
        assert lost_m2 < BESIDE_M2, "a new altitude continues from what was searched"
        assert areas[-1] > areas[0]

        subprocess.run(command("ctl", "--run", run, "fact", "thruster_1=false"), check=True, capture_output=True)

        def started() -> list[str]:
            review = await_event(process, "Reviewed", decision="applied")
            return [unit["transformation"] for unit in review["change_set"]["started"]]

        eventually(lambda: "recover" in started())
