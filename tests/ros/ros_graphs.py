"""Graphs of ROS nodes in few words, and what the judge says of the environments made of them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from cfgplan import answers, api
from cfgplan.api import World
from cfgplan.explaining import WiringFault
from cfgplan.ros.environments import Imported, imported
from cfgplan.ros.graph import Role, RosGraph, RosNode, RosPort
from cfgplan.ros.guesses import guess_table
from cfgplan.ros.types import MessageType
from cfgplan.validity import Violation, violations

Ports = Mapping[str, str | None]


def node(name: str, gives: Ports = {}, takes: Ports = {}, serves: Ports = {}, calls: Ports = {}) -> RosNode:  # noqa: B006
    """A node that publishes, subscribes, serves and calls: names to types."""
    said = {Role.PUBLISHES: gives, Role.SUBSCRIBES: takes, Role.SERVES: serves, Role.CALLS: calls}
    ports = (
        RosPort(role, topic, kind and MessageType.read(kind, "srv" if role.is_service else "msg"))
        for role, ends in said.items()
        for topic, kind in ends.items()
    )
    return RosNode(name, tuple(ports))


def graph(*nodes: RosNode) -> RosGraph:
    return RosGraph(nodes, ("a test",))


def written(found: Imported, folder: Path) -> Path:
    """The environment file and its ontology's in a folder."""
    (folder / "robot.ttl").write_text(found.ontology)
    env = folder / "robot.yaml"
    env.write_text(found.text("robot.ttl"))
    return env


def read_back(whole: RosGraph, folder: Path, guesses: str | None = None) -> World:
    """The environment that a graph becomes, once it was written and read again."""
    files = []
    if guesses is not None:
        files = [folder / "guesses.yaml"]
        files[0].write_text(guesses)
    return api.load(written(imported(whole, guess_table(files)), folder))


def judged(whole: RosGraph, folder: Path, guesses: str | None = None) -> list[Violation]:
    """What is wrong with that environment."""
    problem = api.match(read_back(whole, folder, guesses))
    return violations(problem.environment, problem.similarity)


def faults(whole: RosGraph, folder: Path) -> tuple[WiringFault, ...]:
    """What is wrong or odd with it, the probable fault first."""
    world = read_back(whole, folder)
    return answers.wiring_faults(world, api.match(world))
