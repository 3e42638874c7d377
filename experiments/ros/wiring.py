"""How early `cfgplan check` tells the fault of a wrong wiring, on real ROS 1 architectures.

    git clone https://github.com/cmu-rss-lab/rosdiscover-evaluation
    python experiments/ros/wiring.py rosdiscover-evaluation

First the known faults of its architectures. Then faults made here: each input of a sound architecture that has its
topic from a single publisher is renamed. A rank is the position of the first line that names the fault in the output;
`new` is the rank with `--against` the sound one.
"""

from __future__ import annotations

import argparse
import random
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any

import yaml

from cfgplan import answers, api
from cfgplan.errors import InputError
from cfgplan.explaining import Suspicion, WiringFault
from cfgplan.ros.environments import imported
from cfgplan.ros.graph import Role, RosGraph, RosNode, RosPort, resolved
from cfgplan.ros.guesses import guess_table
from cfgplan.ros.types import MessageType

ROLES = {Role.PUBLISHES: "pubs", Role.SUBSCRIBES: "subs", Role.SERVES: "provides", Role.CALLS: "uses"}
WRONG_NAMES: Mapping[str, Callable[[str], str]] = {
    "a word more": lambda name: f"{name}_raw",
    "two letters swapped": lambda name: f"{name[:-2]}{name[-1]}{name[-2]}",
    "another namespace": lambda name: f"/robot1{name}",
    "no namespace": lambda name: f"/{name.rpartition('/')[2]}",
    "another word": lambda name: f"{name.rpartition('/')[0]}/input",
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--most", type=int, default=8, help="faults of each kind to make in one architecture (8)")
    options = parser.parse_args()
    known_faults(options.folder / "experiments" / "detection" / "subjects")
    made_faults(sorted((options.folder / "experiments").rglob("*.architecture.yml")), options.seed, options.most)


def known_faults(folder: Path) -> None:
    print("known fault | told | rank | new")
    for subject in sorted(folder.iterdir()):
        files = [subject / f"{which}.architecture.yml" for which in ("buggy", "fixed")]
        errors = yaml.safe_load((subject / "experiment.yml").read_text()).get("errors") or []
        if errors and all(file.exists() for file in files):
            wrong, sound = (told(graph(file)) for file in files)
            words = [error.rpartition("/")[2] for error in errors]
            ranks = [rank(each, words) for each in (wrong, new(wrong, sound))]
            print(f"{subject.name}: {', '.join(errors)} | {len(wrong)} | {ranks[0] or '-'} | {ranks[1] or '-'}")


def made_faults(files: list[Path], seed: int, most: int) -> None:
    chance = random.Random(seed)
    ranks: dict[str, list[tuple[int | None, int | None]]] = {kind: [] for kind in WRONG_NAMES}
    numbers = []
    for file in files:
        if file.name.startswith("buggy"):
            continue
        sound = graph(file)
        before = told(sound)
        numbers.append(len(before))
        for kind, spoil in WRONG_NAMES.items():
            ends = sorted(fed_by_one(sound))
            for name, topic in chance.sample(ends, min(most, len(ends))):
                if spoil(topic) in sound.topics:
                    continue
                wrong = told(renamed(sound, name, topic, spoil(topic)))
                words = [f"unit {name.strip('/')}.1"]
                ranks[kind].append((rank(wrong, words), rank(new(wrong, before), words)))
    print(f"\n{len(numbers)} architectures, in which {median(numbers)} lines are told at the median")
    print("made fault | number | first | in the first three | median rank | first of what is new")
    for kind, found in ranks.items():
        plain = [one or 10**6 for one, _ in found]
        shares = [sum(each <= limit for each in plain) / len(found) for limit in (1, 3)]
        fresh = sum(other == 1 for _, other in found) / len(found)
        print(f"{kind} | {len(found)} | {shares[0]:.0%} | {shares[1]:.0%} | {median(plain):g} | {fresh:.0%}")


def graph(file: Path) -> RosGraph:
    """An architecture as ROSDiscover writes it."""
    nodes: dict[str, RosNode] = {}
    for told_node in yaml.safe_load(file.read_text()):
        name = resolved(told_node["fullname"].replace(" ", ""), "", "")
        ports = [
            RosPort(role, resolved(end["name"], "", ""), kind(end.get("format") or "", role))
            for role, key in ROLES.items()
            for end in told_node.get(key) or []
        ]
        nodes.setdefault(name, RosNode(name, tuple(ports)))
    return RosGraph(tuple(nodes.values()), (file.name,))


def kind(text: str, role: Role) -> MessageType | None:
    """A type, in the spellings that its authors found in code; None for one that is not told, or only as a pointer."""
    if "shared_ptr" in text:
        return None
    try:
        return MessageType.read(text.removesuffix("_"), "srv" if role.is_service else "msg")
    except InputError:
        return None


def told(whole: RosGraph) -> tuple[WiringFault, ...]:
    """Return the faults that `cfgplan check` finds in an imported graph, except unused streams, which are one line."""
    with TemporaryDirectory() as folder:
        found = imported(whole, guess_table())
        (Path(folder) / "robot.ttl").write_text(found.ontology)
        file = Path(folder) / "robot.yaml"
        file.write_text(found.text("robot.ttl"))
        world = api.load(file)
        faults = answers.wiring_faults(world, api.match(world))
    return tuple(fault for fault in faults if fault.suspicion is not Suspicion.UNTAKEN)


def new(after: tuple[WiringFault, ...], before: tuple[WiringFault, ...]) -> tuple[WiringFault, ...]:
    keys = {fault.key for fault in before}
    return tuple(fault for fault in after if fault.key not in keys)


def rank(faults: tuple[WiringFault, ...], words: list[str]) -> int | None:
    """The place of the first fault that has one of the words, itself or in its nearest stream."""
    texts: Iterator[Any] = (f"{fault.text} {fault.near[0].stream if fault.near else ''}" for fault in faults)
    return next((at for at, text in enumerate(texts, 1) if any(word in text for word in words)), None)


def fed_by_one(whole: RosGraph) -> Iterator[tuple[str, str]]:
    """The inputs, as node and topic, whose topic has one publisher and no other subscriber."""
    for topic in whole.topics:
        publishers, subscribers = (
            [node.name for node in whole.nodes if topic in node.names(role)]
            for role in (Role.PUBLISHES, Role.SUBSCRIBES)
        )
        if len(publishers) == len(subscribers) == 1 and publishers != subscribers:
            yield subscribers[0], topic


def renamed(whole: RosGraph, name: str, topic: str, wrong: str) -> RosGraph:
    def port(each: RosPort) -> RosPort:
        return replace(each, name=wrong) if each.name == topic and each.role is Role.SUBSCRIBES else each

    nodes = (replace(n, ports=tuple(map(port, n.ports))) if n.name == name else n for n in whole.nodes)
    return replace(whole, nodes=tuple(nodes))


if __name__ == "__main__":
    main()
