"""Runs of a building as the page sees them, of any number of units, and how they look when something is wrong."""

from __future__ import annotations

from dataclasses import replace

from cfgplan_runtime.lifecycle.perturbations import ReviewRequested, UnitGone
from cfgplan_runtime.lifecycle.reports import Decision, QualityView, Review, Snapshot, TargetView, UnitView
from cfgplan_runtime.supervision.observation import Observation
from fake_manager import SNAPSHOT

from cfgplan.domain import (
    ChangeSet,
    ComputationUnit,
    Environment,
    Host,
    OutputPort,
    Publication,
    Stream,
    Subscription,
    Transformation,
)

HOSTS = ("cellar", "ground-floor-cabinet", "roof")


def observed(unit: ComputationUnit, number: int, second: int = 0) -> Observation:
    """Figures that differ from unit to unit and from second to second."""
    wave = (number * 7 + second * 3) % 11
    return Observation(
        unit.id, unit.transformation, 300_000, 2_000 * (1 + wave), 900_000, (20 + wave) << 20, 100 * second + number,
        0.5 + wave * 9.7, 0, None, {}, {},
    )  # fmt: skip


def building(units: int, second: int = 0) -> Snapshot:
    """A run of so many units (3 or more) in its `second`th second: for each room a thermometer and a comfort unit, one
    logger, and a target for each comfort unit.
    """
    rooms = (units - 1) // 2
    logger = ComputationUnit(
        "logger.1",
        "logger",
        tuple(Subscription("comfort", Stream(f"comfort(room{room}).1", "index")) for room in range(rooms)),
        (Publication("log", "/log"),),
        host=HOSTS[0],
    )
    running = [logger]
    for room in range(rooms):
        host = HOSTS[room % 3]
        thermometer = ComputationUnit(f"thermometer(room{room}).1", f"thermometer(room{room})", host=host)
        fed = (Subscription("celsius", Stream(thermometer.id, "celsius")),)
        shown = (Publication("index", f"/comfort/{room}"),)
        running += [
            thermometer,
            ComputationUnit(f"comfort(room{room}).1", f"comfort(room{room})", fed, shown, host=host),
        ]
    running += [ComputationUnit(f"spare.{n}", "spare", host=HOSTS[2]) for n in range(units - len(running))]
    outputs = {"logger": "log", "thermometer": "celsius", "comfort": "index", "spare": "out"}
    library = tuple(
        Transformation(label, outputs=(OutputPort(outputs[label.partition("(")[0]], "T"),))
        for label in sorted({unit.transformation for unit in running})
    )
    targets = [TargetView("everything that was measured", "Log", "/log", 1, Stream("logger.1", "log"), unit="logger.1")]
    targets += [
        TargetView(
            f"comfort of room{room}",
            "Comfort",
            f"/comfort/{room}",
            0,
            Stream(f"comfort(room{room}).1", "index"),
            unit=f"comfort(room{room}).1",
        )
        for room in range(rooms)
    ]
    views = [UnitView(unit, unit.host, observed(unit, n, second)) for n, unit in enumerate(running)]
    begun = Review(
        1, 10.0, 1_700_000_000.5, (ReviewRequested(),), Decision.APPLIED, 600, 1_000_000, 2_000_000, 2_000_000, True,
        ChangeSet(started=tuple(running)), tuple(target.label for target in targets),
        seconds={"plan": 0.02, "apply": 0.1},
    )  # fmt: skip
    learned = QualityView(
        "comfort(room0)", "index", "error", None, 200_000, 510_000, 500_000 + 1000 * second, 20_000, 0.4
    )
    return replace(
        SNAPSHOT,
        environment=Environment(tuple(running), library, hosts=tuple(map(Host, HOSTS))),
        targets=tuple(targets),
        units=tuple(views),
        reviews=(begun,),
        backing_off=(),
        declared=("robot2",),
        horizon_s=600,
        horizon_left_s=480.0 - second,
        qualities=(learned,),
    )


def with_a_kill(snapshot: Snapshot) -> Snapshot:
    """The same after the death of the first comfort unit: its target is not met, and a review found no plan."""
    dead = "comfort(room0).1"
    gone = UnitGone(dead, "comfort(room0)", "died", "killed by signal 9")
    reason = "nothing that may start now gives Comfort and of some Room and of value room0, as comfort(room0) backs off"
    review = replace(
        snapshot.reviews[-1], number=2, time_s=1_700_000_060.5, perturbations=(gone,), decision=Decision.KEPT,
        change_set=ChangeSet(), unmet={"comfort of room0": reason},
    )  # fmt: skip
    units = tuple(
        replace(view, observation=replace(view.observation, errors=3, last_error="ValueError: five"))
        if view.unit.id == "thermometer(room0).1" and view.observation
        else view
        for view in snapshot.units
        if view.unit.id != dead
    )
    targets = tuple(
        replace(target, stream=None, unit=None, reason=reason) if target.label == "comfort of room0" else target
        for target in snapshot.targets
    )
    return replace(snapshot, units=units, targets=targets, reviews=(*snapshot.reviews, review))
