"""The checks of a run before it plans: names and places, unit code, and nodes and topics of ROS."""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from cfgplan.cli import options as shared
from cfgplan.cli.run_middleware import OF_ROS, ROS1, ROS2, fleet_of, folder_of, ros_unit_of, source_check_of
from cfgplan.errors import Fault, InputError
from cfgplan.onward import grouped
from cfgplan.qualities import Teller
from cfgplan.summary import some

if TYPE_CHECKING:
    from cfgplan.api import World

_MOST_NAMED = 4


def check_places(options: argparse.Namespace) -> None:
    """Raise InputError if the options name a place or a name that the run can't have, before anything is planned."""
    from cfgplan_runtime.streams.run_folder import base_folder, is_called, live_runs

    if options.record is not None and not Path(options.record).absolute().parent.is_dir():
        mend = "make the folder, or name a file in another one"
        raise InputError.of("the recording can't be written: its folder does not exist", file=options.record, mend=mend)
    shared.check_port("--metrics-port", options.metrics_port, "metrics")
    shared.check_port("--page", options.page, "the page")
    if options.name is not None:
        for other in live_runs(base_folder()):
            if is_called(other, options.name):
                mend = "choose another name, or stop that run with `cfgplan ctl --name NAME stop`"
                raise InputError.of(f"--name: a live run is called {options.name!r} already ({other.name})", mend=mend)


def check_can_start(options: argparse.Namespace, world: World) -> None:
    """Raise InputError if no transformation of the library could be started."""
    library = world.environment.library
    if not (world.environment.targets and library):
        return
    coded = [one for one in library if one.source]
    if not coded:
        labels = some((transformation.label for transformation in library), _MOST_NAMED)
        message = f"nothing can be started: no transformation names its unit code ({labels})"
        mend = "add `source: units.py:Class` to them, or plan with `solve`"
        raise InputError.of(message, file=str(world.file.path) if world.file else None, mend=mend)
    check, folder = source_check_of(options), folder_of(options)
    if options.dry_run or check is None or options.middleware in OF_ROS:
        return
    faults = grouped((check(one, folder), one.label) for one in coded)
    if None not in faults:
        raise InputError(
            shared.placed_fault(world.file, fault, labels, partial(shared.unstartable, labels))
            for fault, labels in faults.items()
            if fault is not None and world.file is not None
        )


def refuse_nodes(options: argparse.Namespace, world: World) -> None:
    from cfgplan.ros.sources import NodeSource

    nodes = [one for one in world.environment.library if NodeSource.read(one.source) is not None]
    if nodes:
        mend = "add --middleware ros1 or --middleware ros2"
        what = f"{nodes[0].label} is a node of ROS (`{nodes[0].source}`)"
        raise InputError.of(what, file=options.env, mend=mend)


def check_ros_nodes(options: argparse.Namespace, world: World) -> None:
    """Raise all faults of ROS nodes before the first start, in a dry run too."""
    from cfgplan_runtime.nodes.unit_checks import check_nodes

    ros, bag = OF_ROS[options.middleware], "rosbag record" if options.middleware == ROS1 else "ros2 bag record"
    if options.record is not None:
        raise InputError.of(f"--record can't record messages of {ros}", mend=f"use `{bag}` on the targets' topics")
    if options.ros2:
        mend = "leave it out" if options.middleware == ROS2 else "leave it out, and use a bridge"
        raise InputError.of(f"--ros2 is for units that are processes, not for nodes of {ros}", mend=mend)
    if options.mqtt is not None:
        raise InputError.of(
            f"--mqtt is for units that are processes, not for nodes of {ros}", mend="leave it out, and use a bridge"
        )
    if fleet_of(options) is not None:
        raise InputError.of(f"{ros} nodes are started on this computer only", mend="leave out --local and --connect")
    for statement, told in world.environment.told.items():
        if options.middleware == ROS1 and told.teller is Teller.STATISTICS:
            mend = "observe `/diagnostics`, a field of its messages, or what the run measures"
            raise InputError.of(f"ROS 1 nodes publish no topic statistics ({statement})", file=options.env, mend=mend)
    facts = [fact for fact in world.environment.facts if fact.observed_on and not fact.type]
    if facts:
        name = facts[0].name
        mend = f"name the message `type` of its `topic`, or set the fact by `cfgplan ctl fact {name}=VALUE` alone"
        what = f"a run of {ros} nodes can't observe facts without a message type ({name})"
        raise InputError.of(what, file=options.env, mend=mend)
    check_nodes(world.environment, options.env, ros_unit_of(options).node_source, ros)


def check_ros2_topics(options: argparse.Namespace, world: World) -> None:
    """Report all faults of ROS 2 topics before any unit starts; other hosts check their own units."""
    library = () if options.dry_run or fleet_of(options) is not None else world.environment.library
    units = [one for one in library if (one.source or "").startswith("cfgplan_runtime.ros2:")]
    if not units and not options.ros2:
        return
    from cfgplan_runtime.ros2.targets import check_targets
    from cfgplan_runtime.ros2.units import check_unit

    folder = folder_of(options)
    checks: list[Callable[[], object]] = [partial(check_unit, each, folder) for each in units]
    checks += [partial(check_targets, world.environment, folder)] if options.ros2 else []
    raise_all(checks, options.env)
    from cfgplan_runtime.ros2.ros_python import VARIABLE, ros_python

    os.environ[VARIABLE] = ros_python(options.ros_python).program  # units use it, too, and need not look for it


def raise_all(checks: list[Callable[[], object]], file: str) -> None:
    """Raise InputError with the faults of all checks. Faults without a file get this `file`."""
    faults = list[Fault]()
    for check in checks:
        try:
            check()
        except InputError as error:
            faults += (fault if fault.file else replace(fault, file=file) for fault in error.faults)
    if faults:
        raise InputError(faults)
