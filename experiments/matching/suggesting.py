"""Test whether the tag that a person wrote is among the first three proposed tags.

    python experiments/matching/suggesting.py [sosa-common.ttl sosa-observation.ttl sosa-actuation.ttl]

The tags of a world are replaced by `⊤`, all together or one at a time, and proposed from names, message types and
connections. Two tags are the same if they are equal as concepts. Worlds: the paper's case study, and
with SOSA's files the graph of ROS nodes of `sosa_robot.py`, imported as `cfgplan import ros2` does it.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from sosa_robot import THINGS, WRITTEN, robot

from cfgplan import api
from cfgplan.domain import Environment
from cfgplan.matching.syntax import parse_tag
from cfgplan.ros.environments import imported
from cfgplan.ros.guesses import guess_table
from cfgplan.ros.vocabulary import ROS_NAMES

NAO = Path(__file__).parents[2] / "models" / "nao"


def with_tags(environment: Environment, tags: Mapping[str, str]) -> Environment:
    """Return the environment with other tags at the ports and targets that `tags` names."""
    library = tuple(
        replace(
            t,
            inputs=tuple(replace(p, tag=tags.get(f"{t.label}/{p.name}", p.tag)) for p in t.inputs),
            outputs=tuple(replace(p, tag=tags.get(f"{t.label}/{p.name}", p.tag)) for p in t.outputs),
        )
        for t in environment.library
    )
    targets = tuple(replace(each, tag=tags.get(f"target {each.label}", each.tag)) for each in environment.targets)
    return replace(environment, library=library, targets=targets)


def found(world: api.World, written: Mapping[str, str], names: list[str]) -> dict[str, int]:
    """Return the rank, from 1, at which the written tag of each port is proposed; 0 if it is not proposed."""
    places = {}
    for name, suggestions in api.suggested_tags(world, names, foreign=ROS_NAMES, reasoner="el").items():
        wanted = parse_tag(written[name], world.ontology)
        proposed = [parse_tag(each.tag, world.ontology) for each in suggestions]
        places[name] = proposed.index(wanted) + 1 if wanted in proposed else 0
    return places


def shown(what: str, world: api.World, written: Mapping[str, str], left_out: str) -> None:
    """Print the number of written tags that are proposed, with all tags left out and with one left out."""
    names = list(written)
    bare = replace(world, environment=with_tags(world.environment, dict.fromkeys(names, left_out) if left_out else {}))
    places = found(bare, written, names)
    one: dict[str, int] = {}
    for name in names:
        others = {**written, name: left_out or bare_tag(world, name)}
        one |= found(replace(world, environment=with_tags(world.environment, others)), written, [name])
    for how, answers in (("all tags left out", places), ("one tag left out", one)):
        hits = sum(place > 0 for place in answers.values())
        first = sum(place == 1 for place in answers.values())
        print(f"{what}, {how}: {hits} of {len(names)} among the first three ({hits / len(names):.0%}), {first} first")
        print("  not:", ", ".join(name for name, place in answers.items() if not place) or "none")


def bare_tag(world: api.World, name: str) -> str:
    """Return the written tag of a port of the world."""
    return world.environment.outputs.get(name) or world.environment.demands[name]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sosa", type=Path, nargs="*", metavar="sosa.ttl", help="the files of SOSA's ontology")
    chosen = parser.parse_args()
    for name in ("1-piff-registered.yaml", "4-fusion-available.yaml"):
        world = api.load(NAO / name)
        written = {**world.environment.outputs, **world.environment.demands}
        shown(name, world, written, "⊤")
    if not chosen.sosa:
        return
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        graph = imported(robot(), guess_table())
        (folder / "robot.ttl").write_text(graph.ontology)
        (folder / "things.ttl").write_text(THINGS)
        for file in chosen.sosa:
            (folder / file.name).write_bytes(file.read_bytes())
        files = ", ".join(["robot.ttl", "things.ttl", *(file.name for file in chosen.sosa)])
        text = graph.text("robot.ttl").replace("ontology: robot.ttl", f"ontology: [{files}]\nimports: ignore")
        (folder / "robot.yaml").write_text(text)
        world = api.load(folder / "robot.yaml")
        shown("ROS graph with SOSA", world, WRITTEN, "")


if __name__ == "__main__":
    main()
