"""NAO at night: plays days with a night, prints how well the run follows the light, and draws a chart.

python experiments/observed/night.py [--looks] [--days 2] [--out models/nao/8-night.svg]

A photometer observes the light; with `--looks` only the camera does, which is looked at during the night.
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
from cfgplan_runtime.lifecycle.reports import Snapshot
from cfgplan_runtime.operating.operation import Operation, Settings

import cfgplan

NAO = Path(__file__).parents[2] / "models" / "nao"
sys.path.insert(0, str(NAO))
from football import scenario  # noqa: E402

SAMPLE_S = 0.1
BOUND_M = 0.5
LEAST_LIGHT = 0.78
"""Below, the error that the file says is more than the bound."""
POSE_ERROR_M, LOCALIZATION_ERROR_M = 0.2, 0.1


@dataclass(frozen=True)
class Sample:
    """A sample of the light and of the run's state; `believed` is the brightness that the run observes, if it does."""

    at_s: float
    light: float
    believed: float | None
    error_m: float
    by_camera: bool
    is_look: bool
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
    parser.add_argument("--looks", action="store_true")
    parser.add_argument("--days", type=float, default=2.0)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    path = NAO / ("8-night-by-looks.yaml" if options.looks else "8-night.yaml")
    loaded = cfgplan.load(path)
    day_s = float(loaded.environment.transformation["bottom_cam(piff)"].params["day_s"])
    world = replace(loaded, environment=replace(loaded.environment, units=()))
    with Operation(world, path, Settings(estimator="declared")) as operation:
        operation.begun.wait()
        positions = Positions(operation.id)
        threading.Thread(target=positions.listen, daemon=True).start()
        samples = _watched(operation, options.days * day_s, day_s)
    print(_summary(samples, positions))
    if options.out is not None:
        _draw(samples, positions, options.out)


def _watched(operation: Operation, seconds: float, day_s: float) -> list[Sample]:
    samples, begun_ns = list[Sample](), time.time_ns()
    while (now_ns := time.time_ns()) < begun_ns + seconds * 1e9:
        state = operation.manager.snapshot()
        (ball,) = (target for target in state.targets if target.label == "ball")
        units = {view.unit.transformation for view in state.units}
        by_camera = (ball.unit or "").startswith("ball_localization")
        samples.append(
            Sample(
                now_ns / 1e9,
                scenario.light(now_ns, day_s),
                next((int(fact.value) / 1e6 for fact in state.facts), None),
                LOCALIZATION_ERROR_M + max(POSE_ERROR_M, _camera_m(state)),
                by_camera,
                not by_camera and "bottom_cam(piff)" in units,
                state.reviews[-1].number,
            )
        )
        time.sleep(SAMPLE_S)
    return samples


def _camera_m(state: Snapshot) -> float:
    """The error of the camera as plans use it, in metres."""
    said = state.qualities_now.get("bottom_cam(piff)/image error", "0 m")
    planned = (view.planned / 1e6 for view in state.qualities)
    return next(planned, 0.0 if said.startswith("as") else float(said.split()[0]))


def _summary(samples: Sequence[Sample], positions: Positions) -> str:
    switches = [after.at_s for before, after in pairwise(samples) if before.by_camera != after.by_camera]
    crossings = [
        after.at_s for before, after in pairwise(samples) if (before.light < LEAST_LIGHT) != (after.light < LEAST_LIGHT)
    ]
    delays = [min((at - crossing for at in switches if at >= crossing), default=math.nan) for crossing in crossings]
    bad = sum(sample.by_camera and sample.light < LEAST_LIGHT for sample in samples) / len(samples)
    looks = sum(after.is_look and not before.is_look for before, after in pairwise(samples))
    gaps = [(after - before) / 1e9 for before, after in pairwise(positions.at_ns)]
    late = ", ".join(f"{delay:.1f}" for delay in delays)
    return (
        f"{len(crossings)} crossings, {len(switches)} switches, {late} s late; "
        f"{looks} looks, {samples[-1].reviews - samples[0].reviews} reviews\n"
        f"{100 * bad:.1f} % of the time the camera is used though its error is over the bound\n"
        f"{len(positions.off_m)} positions, {_rms(positions.off_m):.2f} m off (root mean square); "
        f"the longest time without one {max(gaps):.2f} s, the median {statistics.median(gaps):.3f} s"
    )


def _rms(values: Sequence[float]) -> float:
    return math.sqrt(statistics.fmean(value**2 for value in values))


def _draw(samples: Sequence[Sample], positions: Positions, out: Path) -> None:
    import matplotlib

    matplotlib.use("svg")
    matplotlib.rcParams["svg.hashsalt"] = "cfgplan"
    from matplotlib import pyplot

    samples, begun_s = samples[::5], samples[0].at_s
    times = [sample.at_s - begun_s for sample in samples]
    figure, (above, middle, below) = pyplot.subplots(3, 1, figsize=(10, 5), sharex=True, layout="constrained")
    above.plot(times, [sample.light for sample in samples], color="0.6", label="light")
    believed = [sample.believed for sample in samples]
    if None not in believed:
        above.plot(times, believed, color="C0", label="brightness, as the run has it")
    above.set_ylabel("1 by day")
    middle.plot(times, [sample.error_m for sample in samples], color="C1", label="error with the camera, as planned")
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
        where, across = [not sample.by_camera for sample in samples], axis.get_xaxis_transform()
        axis.fill_between(times, 0, 1, where=where, transform=across, color="C0", alpha=0.12, label=label)
        if any(looks := [sample.is_look for sample in samples]):
            label = "a look at the camera" if axis is below else None
            axis.fill_between(times, 0, 1, where=looks, transform=across, color="C3", alpha=0.5, label=label)
        axis.legend(loc="center left", bbox_to_anchor=(1, 0.5), fontsize="small")
    figure.savefig(out, metadata={"Date": None})


if __name__ == "__main__":
    main()
