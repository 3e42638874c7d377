"""An agent that is killed takes along everything that its units have started. Real processes."""

from __future__ import annotations

from pathlib import Path

import psutil
from cfgplan_runtime.supervision.events import HostLost
from living import lives
from small_fleet import eventually, seen, small_fleet

from cfgplan.domain import ChangeSet, ComputationUnit, OutputPort, Transformation


def test_a_daemon_of_a_unit_ends_with_the_agent(tmp_path: Path) -> None:
    note = tmp_path / "daemon"
    source = "fleet_units.py:count_beside_a_daemon"
    counts = Transformation("counts", outputs=(OutputPort("n", "N"),), source=source, params={"note": str(note)})
    with small_fleet("r1", "r2") as fleet, fleet.runtime() as runtime:
        started = (ComputationUnit("counts.1", "counts", host="r2"),)
        runtime.apply(ChangeSet(started, added_transformations=(counts,)))
        eventually(lambda: note.exists() and note.read_text() != "")
        daemon = psutil.Process(int(note.read_text()))
        assert lives(daemon)
        fleet.agents.processes["r2"].kill()
        eventually(lambda: not lives(daemon))
        eventually(lambda: bool(seen(runtime, HostLost)))
