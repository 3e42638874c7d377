"""States are handed over in any order of events: each step is made once, and each element comes once. No process."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass
from itertools import pairwise
from random import Random

import pytest
from cfgplan_runtime.errors import ApplyError
from cfgplan_runtime.supervision.commands import ActivateUnit, GiveState
from one_process import House, slow_clock
from world import start, unit, worker

from cfgplan.domain import ChangeSet, ComputationUnit, InputPort, OutputPort, RunOptions, Transformation

CAMERAS = ("cam", "other")


@dataclass(frozen=True)
class Place:
    """A place in a network, at which one unit replaces the other. `feeds` has cameras in small letters, places in
    capitals.
    """

    feeds: Mapping[str, str]
    start: str = "all"
    has_state: bool = True
    every: int = 1
    loose: str = ""


ONE = Place({"x": "cam"})
ALL_STARTS = ("all", "any", "a")
NETWORKS: Mapping[str, Mapping[str, Place]] = {
    "one": {"A": ONE},
    "chain": {"A": ONE, "B": Place({"x": "A"})},
    "no state at the end": {"A": ONE, "B": Place({"x": "A"}, has_state=False)},
    "no state between": {"A": ONE, "B": Place({"x": "A"}, has_state=False), "C": Place({"x": "B"})},
    "seldom": {"A": Place({"x": "cam"}, every=5), "B": Place({"x": "A"})},
    "optional": {"A": ONE, "B": Place({"x": "cam", "z": "A"}, "any", loose="optional")},
    "service": {"A": ONE, "B": Place({"x": "cam", "z": "A"}, loose="service")},
    **{f"diamond {start}": {"A": ONE, "B": Place({"a": "A", "b": "cam"}, start)} for start in (*ALL_STARTS, "aligned")},
    **{f"two {start}": {"A": Place({"a": "cam", "b": "other"}, start), "B": Place({"x": "A"})} for start in ALL_STARTS},
    "wide": {"A": ONE, "B": Place({"x": "A"}), "C": Place({"x": "A"}), "D": Place({"a": "B", "b": "C"})},
}


@pytest.fixture(autouse=True)
def each_turn_has_one_step(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cfgplan_runtime.children.unit_child.time", slow_clock())


def library(places: Mapping[str, Place], run: RunOptions, size: int) -> Iterator[Transformation]:
    """Two modes for each place, and the cameras."""
    for label in CAMERAS:
        yield Transformation(label, (), (OutputPort("y", "Y"),), source="running_units.py:count")
    for name, place in places.items():
        ports = tuple(
            InputPort(port, "Y", optional=place.loose == "optional", service=place.loose == "service")
            if port == "z"
            else InputPort(port, "Y")
            for port in place.feeds
        )
        for mode in "01":
            one = worker(name + mode, "Numbered", every=place.every, size=size)
            state = name if place.has_state else False
            yield Transformation(
                one.label,
                ports,
                one.outputs,
                source=one.source,
                params=one.params,
                run=RunOptions(state=state, start=place.start, queue=run.queue, blocks=run.blocks),
            )


def made(places: Mapping[str, Place], numbers: Mapping[str, int]) -> dict[str, ComputationUnit]:
    """The unit at each place, of which `numbers` has the number."""
    names = {camera: f"{camera}.1" for camera in CAMERAS}
    names |= {name: f"{name}{number % 2}.{number}" for name, number in numbers.items()}
    return {
        name: unit(names[name], topic=f"/{name}", **{port: f"{names[of]}/y" for port, of in place.feeds.items()})
        for name, place in places.items()
    }


@pytest.mark.parametrize("network", NETWORKS)
@pytest.mark.parametrize("seed", range(12))
def test_each_step_is_made_once_and_each_element_comes_once(network: str, seed: int) -> None:
    draw, places = Random(f"{network} {seed}"), NETWORKS[network]
    blocks = draw.random() < 0.4
    run = RunOptions(blocks=blocks, queue=draw.choice([1, 2, 8]) if blocks else 100_000)
    size = draw.choice([0, 0, 100_000])
    house = House([*library(places, run, size)], CAMERAS, draw.randrange)
    with closing(house):
        for camera in house.cameras.values():
            camera.size = size
        numbers = dict.fromkeys(places, 0)
        house.apply(start(*map(unit, house.cameras), *made(places, numbers).values()))
        for _ in range(draw.randint(1, 3)):
            house.go_on(draw.randrange(200))
            replaced = {name for name in places if draw.random() < 0.75}
            before, after = numbers, {name: number + (name in replaced) for name, number in numbers.items()}
            old, new = made(places, before), made(places, after)
            change_set = ChangeSet(
                started=tuple(new[name] for name in sorted(replaced)),
                rewired=tuple(new[name] for name in places if name not in replaced and new[name] != old[name]),
                stopped=tuple(old[name].id for name in sorted(replaced)),
            )
            if replaced and draw.random() < 0.2:
                doomed = new[max(replaced)].id
                house.doomed[doomed] = (
                    draw.choice([ActivateUnit, GiveState]) if places[max(replaced)].has_state else ActivateUnit
                )
                with pytest.raises(ApplyError, match="died"):
                    house.apply(change_set)
                house.doomed.clear()
            else:
                assert house.apply(change_set).unswitched == 0
                numbers = after
        assert (house.inexact, house.timed_out) == ([], [])
        house.go_on(300)
        house.settle()
        for name, place in places.items():
            came = house.outlets.came[f"/{name}"]
            if place.has_state:
                assert rises([step for step, _, _ in came]) == {place.every}
            for port, of in place.feeds.items():
                numbered = of in CAMERAS or (places[of].has_state and places[of].every == 1)
                if numbered and place.every == 1 and place.start in ("any", "all", "aligned", port) and port != "z":
                    is_alone = place.start in ("all", "aligned") or len(place.feeds) == 1
                    assert rises([inputs[port] for _, inputs, _ in came]) <= ({1} if is_alone else {0, 1})


@pytest.mark.parametrize("network", ["one", "chain"])
@pytest.mark.parametrize("is_lost", [False, True])
@pytest.mark.parametrize("seed", range(6))
def test_a_state_counts_as_not_exact_only_if_an_element_is_missing(network: str, seed: int, *, is_lost: bool) -> None:
    """The source blocks in its code until the update is over. It may then give an element before it hears of the next
    unit. In a chain, only the first unit waits for it.
    """
    places = NETWORKS[network]
    house = House([*library(places, RunOptions(), 0)], CAMERAS, Random(seed).randrange)
    with closing(house):
        old, new = (made(places, dict.fromkeys(places, number)) for number in (0, 1))
        house.apply(start(*map(unit, house.cameras), *old.values()))
        house.go_on(200)
        house.blocked = {"cam.1"}
        house.apply(ChangeSet(started=tuple(new.values()), stopped=tuple(one.id for one in old.values())))
        assert house.timed_out.count(0.5) == 1
        if is_lost:
            house.cameras["cam.1"].give()
        house.cameras["cam.1"].turn()
        house.blocked = set()
        house.go_on(300)
        house.settle()
        assert [(one.unit, one.before) for one in house.inexact] == [("A1.1", "A0.0")] * is_lost
        numbers = [inputs["x"] for _, inputs, _ in house.outlets.came["/A"]]
        assert rises(numbers) == ({1, 2} if is_lost else {1})


@pytest.mark.parametrize("seed", range(6))
def test_elements_that_wait_in_a_unit_are_handed_over_though_their_source_blocks(seed: int) -> None:
    """They wait for those of another source. Since both block, it is unknown from where on the next unit gets all."""
    places = NETWORKS["two all"]
    house = House([*library(places, RunOptions(queue=100_000), 0)], CAMERAS, Random(seed).randrange)
    with closing(house):
        old, new = (made({"A": places["A"]}, {"A": number})["A"] for number in (0, 1))
        house.apply(start(*map(unit, house.cameras), old))
        house.go_on(200)
        house.blocked = {"other.1"}
        house.go_on(200)
        house.blocked = {*house.cameras}
        house.apply(ChangeSet(started=(new,), stopped=(old.id,)))
        assert 0.5 in house.timed_out
        for camera in house.cameras.values():
            camera.turn()
        house.blocked = set()
        house.go_on(600)
        house.settle()
        assert house.inexact == []
        came = house.outlets.came["/A"]
        assert rises([step for step, _, _ in came]) == {1}
        for port in "ab":
            assert rises([inputs[port] for _, inputs, _ in came]) == {1}


def rises(numbers: list[int]) -> set[int]:
    assert len(numbers) > 2
    return {after - before for before, after in pairwise(numbers)}
