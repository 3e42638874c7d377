"""The middleware and the hosts of a run, as its options name them."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

from cfgplan.cli.screen import Screen
from cfgplan.errors import InputError

if TYPE_CHECKING:
    from cfgplan_runtime.fleet.fleet_runtime import Fleet
    from cfgplan_runtime.operating.operation import Operation
    from cfgplan_runtime.operating.outside_topics import TopicReader
    from cfgplan_runtime.operating.sources import SourceCheck
    from cfgplan_runtime.runtime import Runtime

    from cfgplan.domain import Environment

ROS1, ROS2 = "ros1", "ros2"
OF_ROS = {ROS1: "ROS 1", ROS2: "ROS 2"}


def folder_of(options: argparse.Namespace) -> Path:
    """The folder that file names in the environment are relative to."""
    env = Path(options.env)
    return env if env.is_dir() else env.parent


@contextmanager
def qualities_of_ros(options: argparse.Namespace, operation: Operation) -> Iterator[None]:
    """Read the topics of ROS that tell qualities of streams, if outputs are observed there. Raises InputError."""
    if not operation.manager.world.environment.told:
        yield
        return
    from cfgplan_runtime.operating.told_qualities import ToldQualities

    mend = "let its publisher use another topic, or that type"
    with ToldQualities(_reader(options, "qualities", mend, operation), operation.manager, operation.show):
        yield


@contextmanager
def facts_of_ros(options: argparse.Namespace, operation: Operation) -> Iterator[None]:
    """Follow the topics of ROS that observe facts, if there are any. Raises InputError."""
    facts = tuple(fact for fact in operation.manager.world.environment.facts if fact.type is not None)
    if not facts:
        yield
        return
    from cfgplan_runtime.operating.outside_topics import OutsideFacts

    mend = "correct the `type` of its fact"
    with OutsideFacts(_reader(options, "facts", mend, operation), operation.manager, operation.show):
        yield


def _reader(options: argparse.Namespace, purpose: str, mend: str, operation: Operation) -> TopicReader:
    """Return the reader of topics of the ROS whose nodes run, of ROS 2 if no nodes run. Raises InputError.

    In ROS 1, only reading a topic shows that it has another type; the reader then reports it with this `mend`.
    """
    if options.middleware == ROS1:
        from cfgplan_runtime.ros1.topic_reader import Ros1Reader

        return Ros1Reader(purpose, mend, operation.id, operation.show)
    from cfgplan_runtime.ros2.facts import Ros2Reader

    return Ros2Reader(purpose, operation.id, folder_of(options), operation.show)


def source_check_of(options: argparse.Namespace) -> SourceCheck | None:
    """Return the check of code before its start; None if the code is on other computers."""
    from cfgplan_runtime.children.source_faults import fault_of, source_fault

    if options.middleware in OF_ROS:
        check_start = ros_unit_of(options).check_start
        return lambda transformation, folder: fault_of(lambda: check_start(transformation, folder), folder)
    return None if options.connect else source_fault


def ros_unit_of(options: argparse.Namespace) -> ModuleType:
    """Return the module for nodes of the ROS that the options name."""
    from importlib import import_module

    return import_module(f"cfgplan_runtime.{'ros1.ros_unit' if options.middleware == ROS1 else 'ros2.ros2_unit'}")


def fleet_of(options: argparse.Namespace) -> Fleet | None:
    """Return the access to the fleet's hosts; None without an option for it."""
    if not (options.local or options.connect):
        if options.take_over or options.certificates is not None:
            mend = "name one of its agents by --connect"
            raise InputError.of("--take-over and --certificates need a fleet", mend=mend)
        return None
    from cfgplan_runtime.fleet.fleet_runtime import Fleet

    certificates = None if options.certificates is None else Path(options.certificates)
    return Fleet(tuple(options.connect), certificates, options.local, options.take_over)


def runtime_of(
    options: argparse.Namespace, screen: Screen
) -> Callable[[Environment, Path], AbstractContextManager[Runtime]] | None:
    """Return a factory of the runtime; None if units are processes of this computer."""
    fleet = fleet_of(options)
    if options.middleware == ROS1:
        from cfgplan_runtime.ros1.ros1_backend import Ros1Backend
        from cfgplan_runtime.runtime import Runtime

        return lambda _, folder: Runtime(backend=lambda: Ros1Backend(folder=folder, file=options.env))
    if options.middleware == ROS2:
        from cfgplan_runtime.ros2.ros2_backend import Ros2Backend
        from cfgplan_runtime.ros2.ros_python import ros_python
        from cfgplan_runtime.runtime import Runtime

        python = ros_python(options.ros_python)
        return lambda _, folder: Runtime(backend=lambda: Ros2Backend(folder=folder, python=python, file=options.env))
    if fleet is None:
        return None
    from cfgplan_runtime.fleet.fleet_runtime import fleet_runtime

    return lambda environment, folder: fleet_runtime(fleet, environment, folder, options.preload, screen.note)
