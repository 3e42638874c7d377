"""The underwater robot of models/suave: it changes its altitude with the water, and loses nothing of its search."""

from __future__ import annotations

import shutil
from pathlib import Path

from cfgplan_runtime import subscribe
from operated_world import await_event, running

WORLD = Path(__file__).parents[2] / "models" / "suave"
PACE = 16
"""A period of the visibility takes five seconds."""


def test_the_search_changes_its_altitude_with_the_water_and_goes_on_from_what_was_searched(tmp_path: Path) -> None:
    folder = shutil.copytree(WORLD, tmp_path / "suave")
    library = folder / "transformations.yaml"
    at_pace = library.read_text().replace("{period_s: 80", f"{{pace: {PACE}, period_s: 80")
    library.write_text(at_pace.replace("share: ", f"pace: {PACE}, share: "))
    with running(folder / "1-search.yaml") as process:
        run = await_event(process, "Running")["run"]
        seen: list[tuple[int, float]] = []
        with subscribe("/search", run=run, wait_s=60) as subscription:
            for received in subscription:
                seen.append((received.value["altitude"], received.value["searched_m2"]))
                if {altitude for altitude, _ in seen} == {1, 2, 3}:
                    break
    searched = [area for _, area in seen]
    assert searched == sorted(searched)
