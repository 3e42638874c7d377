"""SUAVE's problem on real processes: an underwater robot searches for a pipeline and inspects it as the world changes.

    python experiments/observed/suave.py [--missions 3] [--pace 5] [--out models/suave/mission.svg]
    python experiments/observed/suave.py --crossings [--noise 0.2]

A mission takes 300 simulated seconds. After 35 s a thruster fails. Missions are run with the world's library, and, for
comparison without adaptation, with each single altitude. With `--crossings` the search takes 480 s in real time,
without noise: each time the visibility crosses a bound, the run has to switch once. With `--noise` five values come a
second, with this standard deviation as a share of the visibility, and crossings of the true visibility are counted.

Reference: Rezende Silva et al., SUAVE: an exemplar for self-adaptive underwater vehicles, SEAMS 2023.
"""

from __future__ import annotations

import argparse
import queue
import statistics
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

from cfgplan_runtime import subscribe
from cfgplan_runtime.lifecycle.changes import Add, Remove, SetFact
from cfgplan_runtime.operating.operation import Operation, Settings

import cfgplan
from cfgplan.api import World
from cfgplan.domain import Target, Transformation
from cfgplan.noise import Noise
from cfgplan.qualities import MICRO

ENVIRONMENT = Path(__file__).parents[2] / "models" / "suave" / "1-search.yaml"
FOUND = ENVIRONMENT.with_name("4-found.yaml")
sys.path.insert(0, str(ENVIRONMENT.parent))
from auv import visibility_m  # noqa: E402

MISSION_S, THRUSTER_FAILS_S, PERIOD_S = 300.0, 35.0, 80.0
CROSSINGS_S = 480.0
LEAST_M = {"spiral_high": 3.25, "spiral_medium": 2.25, "spiral_low": 1.25}
"""The visibility that each altitude requires."""
PUBLISHED = "SUAVE's published means: found after 188 s without adaptation, 107 s with; 31 and 51 m inspected"
_LOOK_S = 0.05


@dataclass
class Mission:
    """The result of a mission: the time when the pipeline was found, in simulated seconds, and the inspected metres."""

    name: str
    found_s: float | None = None
    inspected_m: float = 0.0
    altitudes: list[tuple[float, float]] = field(default_factory=list)
    """The altitude of each element of the search, with its time."""
    following: list[float] = field(default_factory=list)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--missions", type=int, default=3)
    parser.add_argument("--pace", type=float, default=5.0, help="simulated seconds in a second")
    parser.add_argument("--crossings", action="store_true")
    parser.add_argument("--noise", type=float, default=0.0, help="with --crossings")
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    if options.crossings:
        print(_noisy_crossings(options.noise) if options.noise else _crossings())
        return
    world = at_pace(cfgplan.load(ENVIRONMENT), options.pace)
    last = None
    for name, own in {"all altitudes": world, **{f"{one} alone": alone(world, one) for one in LEAST_M}}.items():
        missions = [mission(name, own, options.pace) for _ in range(options.missions)]
        last = last or missions[-1]
        found = [one.found_s for one in missions if one.found_s is not None]
        when = f"found after {statistics.fmean(found):.0f} s" if found else "not found"
        inspected = statistics.fmean(one.inspected_m for one in missions)
        print(f"{name}: {when} ({len(found)} of {len(missions)}), {inspected:.0f} m inspected", flush=True)
    print(PUBLISHED)
    if options.out is not None and last is not None:
        _draw(last, options.out)


def at_pace(world: World, pace: float) -> World:
    """Return the world with its units at a pace, in simulated seconds per second."""
    library = tuple(
        replace(one, params={**one.params, "pace": pace}) if one.label in ("water", "all_thrusters", "recover") else one
        for one in world.environment.library
    )
    return replace(world, environment=replace(world.environment, library=library))


def alone(world: World, altitude: str) -> World:
    """Return the world with a single altitude of the search, which is allowed at any visibility."""

    def kept(one: Transformation) -> bool:
        return one.label not in LEAST_M or one.label == altitude

    library = tuple(
        replace(one, requires=None) if one.label == altitude else one for one in world.environment.library if kept(one)
    )
    return replace(world, environment=replace(world.environment, library=library))


def mission(name: str, world: World, pace: float) -> Mission:
    """Run a mission; it starts at the beginning of a period of the visibility."""
    idle = tuple(one for one in world.environment.targets if not one.quality)
    with begun(replace(world, environment=replace(world.environment, targets=idle))) as operation:
        now_s = time.time() * pace
        start_s = now_s - now_s % PERIOD_S + PERIOD_S
        time.sleep((start_s - now_s) / pace)
        done, events = Mission(name), queue.SimpleQueue[Callable[[], object]]()
        request = operation.manager.request
        found = threading.Event()

        def search(value: dict[str, Any], time_s: float) -> None:
            done.altitudes.append((time_s * pace - start_s, value["altitude"]))
            if value["found"] and not found.is_set():
                found.set()
                done.found_s = time_s * pace - start_s
                events.put(lambda: [request(Remove(targets=("search",))), request(Add(targets=(_target(FOUND),)))])

        def inspect(value: dict[str, Any], time_s: float) -> None:
            done.inspected_m = value["inspected_m"]
            done.following.append(time_s * pace - start_s)

        request(Add(targets=(_target(ENVIRONMENT),)))
        for topic, hear in (("/search", search), ("/inspection", inspect)):
            threading.Thread(target=_listen, args=(operation.id, topic, hear), daemon=True).start()
        has_failed = False
        while (at_s := time.time() * pace - start_s) < MISSION_S:
            if at_s >= THRUSTER_FAILS_S and not has_failed:
                has_failed = True
                request(SetFact("thruster_1", "false"))
            while not events.empty():
                events.get()()
            time.sleep(_LOOK_S)
    return done


def _target(file: Path) -> Target:
    """The target that the file names; others observe facts."""
    (target,) = (one for one in cfgplan.load(file).environment.targets if one.quality)
    return target


@contextmanager
def begun(world: World) -> Iterator[Operation]:
    """Yield a run of the world after its first review."""
    with Operation(world, ENVIRONMENT, Settings(estimator="declared", adjust=lambda _: world)) as operation:
        operation.begun.wait()
        yield operation


def _listen(run: str, topic: str, hear: Callable[[dict[str, Any], float], None]) -> None:
    with subscribe(topic, run=run, wait_s=600) as subscription:
        for received in subscription:
            hear(received.value, received.time_ns / 1e9)


def _crossings() -> str:
    """Search on for 480 s: crossings, switches, and the time from a message to the first element that follows it."""
    searched, seen = list[tuple[float, float]](), list[tuple[float, float]]()
    with begun(_endless(cfgplan.load(ENVIRONMENT))) as operation:
        for topic, hear in (
            ("/search", lambda value, at_s: searched.append((at_s, value["altitude"]))),
            ("/facts/visibility", lambda value, at_s: seen.append((at_s, value["range_m"]))),
        ):
            threading.Thread(target=_listen, args=(operation.id, topic, hear), daemon=True).start()
        time.sleep(CROSSINGS_S)
    wanted = [(at_s, _best(range_m)) for at_s, range_m in seen]
    crossed = [(at_s, altitude) for (_, before), (at_s, altitude) in pairwise(wanted) if before != altitude]
    switches = [(at_s, after) for (_, before), (at_s, after) in pairwise(searched) if before != after]
    delays = [
        min(s - at_s for s, to in switches if to == altitude and s >= at_s)
        for at_s, altitude in crossed
        if any(to == altitude and s >= at_s for s, to in switches)
    ]
    gaps = [after - before for (before, _), (after, _) in pairwise(searched)]
    return (
        f"{len(crossed)} crossings, {len(switches)} switches; from the message to the first element that follows it "
        f"{statistics.median(delays) * 1e3:.0f} ms at the median, {max(delays) * 1e3:.0f} ms at most; "
        f"the longest time without an element {max(gaps) * 1e3:.0f} ms, "
        f"the median {statistics.median(gaps) * 1e3:.0f} ms"
    )


def _noisy_crossings(noise: float) -> str:
    """Search on for 480 s with noisy values: crossings of the true visibility, switches, reviews and delays."""
    world = cfgplan.load(ENVIRONMENT)
    library = tuple(
        replace(one, params={**one.params, "noise": noise}) if one.label == "water" else one
        for one in world.environment.library
    )
    facts = tuple(
        replace(fact, noise=Noise(round(noise * MICRO), is_share=True)) if fact.name == "visibility" else fact
        for fact in world.environment.facts
    )
    searched = list[tuple[float, float]]()
    hear = lambda value, at_s: searched.append((at_s, value["altitude"]))  # noqa: E731
    with begun(replace(world, environment=replace(world.environment, library=library, facts=facts))) as operation:
        threading.Thread(target=_listen, args=(operation.id, "/search", hear), daemon=True).start()
        begun_s = time.time()
        time.sleep(CROSSINGS_S)
        reviews = operation.manager.snapshot().reviews
    times = [begun_s + step / 100 for step in range(int(CROSSINGS_S * 100))]
    true = [(at_s, _best(visibility_m(at_s, PERIOD_S))) for at_s in times]
    crossed = [(at_s, altitude) for (_, before), (at_s, altitude) in pairwise(true) if before != altitude]
    switches = [(at_s, after) for (_, before), (at_s, after) in pairwise(searched) if before != after]
    delays = [
        next((s - at_s for s, to in switches if at_s <= s < until_s and to == altitude), None)
        for (at_s, altitude), (until_s, _) in pairwise([*crossed, (begun_s + CROSSINGS_S, 0.0)])
    ]
    known = sorted(each for each in delays if each is not None)
    return (
        f"{len(crossed)} crossings of the truth, {len(switches)} switches, {len(reviews)} reviews; "
        f"{len(delays) - len(known)} crossings without a switch before the next one; from a crossing to the first "
        f"element that follows it {statistics.median(known):.1f} s at the median, {known[-1]:.1f} s at most"
    )


def _endless(world: World) -> World:
    """The world with water that is observed once a second, as SUAVE has it."""
    library = tuple(
        replace(one, run=replace(one.run, rate_hz=1.0)) if one.label == "water" else one
        for one in world.environment.library
    )
    return replace(world, environment=replace(world.environment, library=library))


def _best(range_m: float) -> float:
    altitudes = {"spiral_high": 3.0, "spiral_medium": 2.0, "spiral_low": 1.0}
    return next((altitudes[label] for label, least_m in LEAST_M.items() if range_m >= least_m), 1.0)


def _draw(one: Mission, out: Path) -> None:
    import matplotlib

    matplotlib.use("svg")
    matplotlib.rcParams["svg.hashsalt"] = "cfgplan"
    from matplotlib import pyplot

    figure, (above, below) = pyplot.subplots(2, 1, figsize=(9, 4), sharex=True, layout="constrained")
    times = range(int(MISSION_S))
    above.plot(times, [visibility_m(at_s, PERIOD_S) for at_s in times], color="0.6", label="visibility")
    for label, least_m in LEAST_M.items():
        above.axhline(least_m, color="0.8", linestyle=":")
        above.text(MISSION_S, least_m, f" {label}", va="center", fontsize="small", color="0.4")
    above.set_ylabel("m")
    above.set_xlim(0, MISSION_S)
    below.step(*_thinned(one.altitudes), where="post", color="C0", label="altitude of the search")
    if one.following:
        below.axvspan(one.following[0], one.following[-1], color="C2", alpha=0.15, label="the pipeline is followed")
    below.axvline(THRUSTER_FAILS_S, color="C3", linestyle=":", label="a thruster fails")
    below.set_ylabel("m")
    below.set_xlabel("simulated seconds")
    below.set_ylim(0, 3.5)
    below.legend(loc="center left", bbox_to_anchor=(1, 0.5), fontsize="small")
    figure.savefig(out, metadata={"Date": None})


def _thinned(altitudes: Sequence[tuple[float, float]]) -> tuple[list[float], list[float]]:
    """The first and last element of each altitude."""
    kept = [
        now
        for before, now, after in zip([(0, 0), *altitudes], altitudes, [*altitudes[1:], (0, 0)], strict=False)
        if now[1] not in (before[1],) or now[1] != after[1]
    ]
    return [at_s for at_s, _ in kept], [altitude for _, altitude in kept]


if __name__ == "__main__":
    main()
