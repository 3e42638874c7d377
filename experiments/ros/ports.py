"""How many nodes of real launch files get ports, and from where.

python experiments/ros/ports.py FOLDER...

A folder holds checkouts of repositories, or is one. Each launch file is read alone, as `cfgplan import` does; arguments
and environment variables without a value are given the word `false`. Nodes of files that can't be read don't count.
"""

from __future__ import annotations

import argparse
import os
import re
from collections import Counter
from pathlib import Path

from cfgplan.errors import InputError
from cfgplan.ros.code.package_sources import ports_of_sources
from cfgplan.ros.graph import RosGraph, RosNode
from cfgplan.ros.guesses import GuessTable, guess_table
from cfgplan.ros.launch_files import launch_graph
from cfgplan.ros.ros2_launch_files import ros2_launch_graph

ROS1, ROS2 = ("*.launch", "*.launch.xml"), ("*.launch.xml", "*.launch.yaml", "*.launch.yml")
ORIGINS = ("the table", "its sources", "its package's sources")
_ARGUMENT = re.compile(r"the argument `(.+?)` has no value")
_VARIABLE = re.compile(r"the environment variable `(.+?)` is not set")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", type=Path, nargs="+")
    parser.add_argument("--show", action="store_true", help="each port of sources with its place, and who has none")
    options = parser.parse_args()
    table = guess_table()
    total = Counter[str]()
    print(f"repository | launch files | not read | nodes | {' | '.join(ORIGINS)} | with ports")
    for repository in [each for folder in options.folders for each in repositories(folder)]:
        found = counted(repository, table, show=options.show)
        total += found
        print(row(repository.name, found))
    print(row("all", total))


def repositories(folder: Path) -> list[Path]:
    """The checkouts in a folder, or the folder itself if it has packages or launch files of its own."""
    inside = sorted(each for each in folder.iterdir() if each.is_dir() and not each.name.startswith("."))
    own = (folder / "package.xml").is_file() or (folder / ".git").exists()
    return [folder] if own or not inside else inside


def row(name: str, found: Counter[str]) -> str:
    nodes, ported = found["nodes"], sum(found[origin] for origin in ORIGINS)
    counts = " | ".join(str(found[key]) for key in ("files", "unread", "nodes", *ORIGINS))
    return f"{name} | {counts} | {ported} ({ported / nodes:.0%})" if nodes else f"{name} | {counts} | -"


def counted(repository: Path, table: GuessTable, *, show: bool) -> Counter[str]:
    found = Counter[str]()
    for path in sorted({path for pattern in (*ROS1, *ROS2) for path in repository.rglob(pattern)}):
        found["files"] += 1
        graph = graph_of(path)
        if graph is None:
            found["unread"] += 1
            continue
        for node in graph.nodes:
            found["nodes"] += 1
            origin, lines = told(node, graph, table)
            found[origin] += 1
            if show:
                print(f"# {path.name}: {node.name} ({node.plugin or f'{node.package}/{node.executable}'}): {origin}")
                print("".join(f"#   {line}\n" for line in lines), end="")
    return found


def told(node: RosNode, graph: RosGraph, table: GuessTable) -> tuple[str, list[str]]:
    """Where a node's ports come from, and what its sources tell."""
    if table.ports_of(node) is not None:
        return ORIGINS[0], []
    sources = ports_of_sources(node, graph.parameters)
    lines = [f"{port.role.value} {port.own} {port.type} {place}" for port, place in sources.places.items()]
    lines += [f"computed: {each}" for each in sources.unclear]
    return (ORIGINS[1 + sources.is_whole_package] if sources.places else "none"), lines


def graph_of(path: Path) -> RosGraph | None:
    """Return the nodes that a launch file starts; None if it can't be read."""
    arguments = dict[str, str]()
    for _ in range(50):
        try:
            return reading(path, arguments)
        except InputError as error:
            said = error.faults[0].message
            if argument := _ARGUMENT.search(said):
                arguments[argument[1]] = "false"
            elif variable := _VARIABLE.search(said):
                os.environ[variable[1]] = "false"
            else:
                return None
    return None


def reading(path: Path, arguments: dict[str, str]) -> RosGraph:
    """Return the nodes that a file starts, read as ROS 1 or ROS 2 by its keywords."""
    words = re.search(r"<node\b[^>]*\bexec=|\$\(var ", path.read_text("utf-8", "replace"))
    is_ros2 = words is not None or path.suffix in (".yaml", ".yml")
    return ros2_launch_graph(path, arguments) if is_ros2 else launch_graph(path, arguments)


if __name__ == "__main__":
    main()
