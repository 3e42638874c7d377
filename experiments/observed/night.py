"""NAO at night: plays days with a night, prints how well the run follows the light, and draws a chart.

python experiments/observed/night.py [--days 2] [--out models/nao/8-night.svg]
"""

from __future__ import annotations

import argparse
import math
import statistics
import sys
import threading
import time
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path

from cfgplan_runtime import subscribe
from cfgplan_runtime.operating.operation import Operation, Settings

import cfgplan

ENVIRONMENT = Path(__file__).parents[2] / "models" / "nao" / "8-night.yaml"
sys.path.insert(0, str(ENVIRONMENT.parent))
from football import scenario  # noqa: E402

LOOK_S = 0.1
BOUND_M = 0.5
LEAST_LIGHT = 0.84
"""Below, the error that the file says is more than the bound."""


@dataclass(frozen=True)
class Look:
    """A sample of the light and of the run's state."""

    at_s: float
    light: float
    believed: float
    error_m: float
    by_camera: bool
    reviews: int


@dataclass
class Positions:
    """The positions received on /result: the time of each, and its error."""

    run: str
    at_ns: list[int] = field(default_factory=list)
    off_m: list[float] = field(default_factory=list)

    def listen(self) -> None:
        with subscribe("/result", run=self.run, wait_s=60) as subscription:
            for received in subscription:
                x, y = scenario.ball(received.time_ns)
                self.at_ns.append(received.time_ns)
                self.off_m.append(math.hypot(received.value["x"] - x, received.value["y"] - y))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--days", type=float, default=2.0)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    loaded = cfgplan.load(ENVIRONMENT)
    day_s = float(loaded.environment.transformation["photometer(piff)"].params["day_s"])
    world = replace(loaded, environment=replace(loaded.environment, units=()))
    with Operation(world, ENVIRONMENT, Settings(estimator="declared")) as operation:
        operation.begun.wait()
        positions = Positions(operation.id)
        threading.Thread(target=positions.listen, daemon=True).start()
        looks = _watched(operation, options.days * day_s, day_s)
    print(_summary(looks, positions))
    if options.out is not None:
        _draw(looks, positions, options.out)


def _watched(operation: Operation, seconds: float, day_s: float) -> list[Look]:
    looks, begun_ns = list[Look](), time.time_ns()
    while (now_ns := time.time_ns()) < begun_ns + seconds * 1e9:
        state = operation.manager.snapshot()
        camera = state.qualities_now["bottom_cam(piff)/image error"]
        (fact,) = state.facts
        units = {view.unit.transformation for view in state.units}
        light = scenario.light(now_ns, day_s)
        by_camera = "ball_localization(piff)" in units
        reviews = state.reviews[-1].number
        looks.append(
            Look(now_ns / 1e9, light, int(fact.value) / 1e6, 0.3 + float(camera.split()[0]), by_camera, reviews)
        )
        time.sleep(LOOK_S)
    return looks


def _summary(looks: Sequence[Look], positions: Positions) -> str:
    switches = [after.at_s for before, after in pairwise(looks) if before.by_camera != after.by_camera]
    crossings = [
        after.at_s for before, after in pairwise(looks) if (before.light < LEAST_LIGHT) != (after.light < LEAST_LIGHT)
    ]
    delays = [min((at - crossing for at in switches if at >= crossing), default=math.nan) for crossing in crossings]
    bad = sum(look.by_camera and look.light < LEAST_LIGHT for look in looks) / len(looks)
    gaps = [(after - before) / 1e9 for before, after in pairwise(positions.at_ns)]
    late = ", ".join(f"{delay:.1f}" for delay in delays)
    return (
        f"{len(crossings)} crossings, {len(switches)} switches, {late} s late; "
        f"{looks[-1].reviews - looks[0].reviews} reviews\n"
        f"{100 * bad:.1f} % of the time the camera is used though its error is over the bound\n"
        f"{len(positions.off_m)} positions, {_rms(positions.off_m):.2f} m off (root mean square); "
        f"the longest time without one {max(gaps):.2f} s, the median {statistics.median(gaps):.3f} s"
    )


def _rms(values: Sequence[float]) -> float:
    return math.sqrt(statistics.fmean(value**2 for value in values))


def _draw(looks: Sequence[Look], positions: Positions, out: Path) -> None:
    import matplotlib

    matplotlib.use("svg")
    matplotlib.rcParams["svg.hashsalt"] = "cfgplan"
    from matplotlib import pyplot

    looks, begun_s = looks[::5], looks[0].at_s
    times = [look.at_s - begun_s for look in looks]
    figure, (above, middle, below) = pyplot.subplots(3, 1, figsize=(10, 5), sharex=True, layout="constrained")
    above.plot(times, [look.light for look in looks], color="0.6", label="light")
    above.plot(times, [look.believed for look in looks], color="C0", label="brightness, as the run has it")
    above.set_ylabel("1 by day")
    middle.plot(times, [look.error_m for look in looks], color="C1", label="error with the camera")
    middle.axhline(BOUND_M, color="0.6", linestyle=":", label="at most")
    middle.set_ylabel("m")
    by_second = defaultdict[int, list[float]](list)
    for at_ns, off_m in zip(positions.at_ns, positions.off_m, strict=True):
        by_second[int(at_ns / 1e9 - begun_s)].append(off_m)
    below.plot([*by_second], [*map(_rms, by_second.values())], color="0.5", label="how far off positions are")
    below.set_ylabel("m")
    below.set_xlabel("s")
    for axis in (above, middle, below):
        label = "the beacon is used" if axis is below else None
        where, across = [not look.by_camera for look in looks], axis.get_xaxis_transform()
        axis.fill_between(times, 0, 1, where=where, transform=across, color="C0", alpha=0.12, label=label)
        axis.legend(loc="center left", bbox_to_anchor=(1, 0.5), fontsize="small")
    figure.savefig(out, metadata={"Date": None})


if __name__ == "__main__":
    main()
