"""The commands of an update, one after the other, for what happens meanwhile. No supervisor and no backend."""

from __future__ import annotations

from collections.abc import Set
from dataclasses import dataclass, field, replace

import pytest
from cfgplan_runtime import ApplyError, Patience
from cfgplan_runtime.children.messages import GivenInput
from cfgplan_runtime.errors import AbandonedError
from cfgplan_runtime.supervision.backend import Inlet
from cfgplan_runtime.supervision.commands import (
    ActivateUnit,
    AskPlaces,
    AskState,
    CloseTopic,
    Command,
    Connect,
    CutShort,
    DeactivateUnit,
    Disconnect,
    Doubt,
    Dump,
    EndUnit,
    GiveState,
    HoldUnit,
    OpenTopic,
    SetEnvironment,
    StartUnit,
    StopAgain,
    StopUnit,
    SwitchNow,
    TellOf,
    WaitUntil,
)
from cfgplan_runtime.supervision.events import PlacesTold, StateTold
from cfgplan_runtime.supervision.handover_answers import HandoverAnswers
from cfgplan_runtime.supervision.updates import CarriedOut, carry_out, environment_after
from cfgplan_runtime.supervision.wiring import Wire, wanted_feeds, wanted_topics
from world import RESULT, source, start, unit, worker

from cfgplan.domain import ChangeSet, ComputationUnit, Environment, Host, InputPort, RunOptions, Target

COUNT, WORK = unit("count.1"), unit("work.1", topic="/result", x="count.1/n")
NEW = unit("work.2", topic="/result", x="count.1/n")
SWAP = ChangeSet(started=(NEW,), stopped=("work.1",))
WIRED = "count.1/n > work.1/x, work.1/y > /result"
BESIDE = "start work.2, wait, count.1/n > work.2/x, work.2/y > /result, begin work.2"
PLACE = (7, 0)
"""The moment from which a new unit's inlets get every element."""
IN_VAIN = "wait in vain, stop work.1 again, wait in vain, cut work.1 short"
RUNNING = Environment((COUNT, WORK), (source(), worker()), (RESULT,))


@dataclass
class Scene:
    """What runs, and how it answers commands: by units that die at the start, are never ready, or give nothing, and by
    those that live on when asked to end."""

    environment: Environment = RUNNING
    dying: Set[str] = frozenset()
    slow: Set[str] = frozenset()
    quiet: Set[str] = frozenset()
    stubborn: Set[str] = frozenset()
    dry: Set[str] = frozenset()
    failing: Set[str] = frozenset()
    limits: dict[str, float] = field(default_factory=dict)
    mute: Set[str] = frozenset()
    """Units that do not answer what a hand-over of a state asks."""
    stateless: Set[str] = frozenset()
    is_abandoned: bool = False
    unfollowed: Set[str] = frozenset()
    """Topics to which not all followers are connected."""
    ends: dict[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.alive = set(self.environment.unit)
        self.ready = set(self.environment.unit)
        self.inactive: set[str] = set()
        self.activating: set[str] = set()
        self.lost_hosts: set[str] = set()
        opened = wanted_topics(self.environment) if self.environment.units else {}
        self.topics = dict(opened)
        wanted = wanted_feeds(self.environment)
        self.feeds = {inlet: Wire(0, stream, inlet, has_switched=True) for inlet, stream in wanted.items()}
        self.said: list[str] = []
        self.answers = HandoverAnswers()
        self.places: list[dict[str, bool]] = []
        """The places that were asked for."""

    def stop_s(self, unit: str) -> float | None:
        return self.limits.get(unit)

    def failure(self, unit: str) -> str | None:
        return "bad luck" if unit in self.failing and unit in self.alive else None

    def dry_units(self) -> Set[str]:
        return self.dry

    def is_followed(self, topics: Set[str]) -> bool:
        return self.unfollowed.isdisjoint(topics)

    def now(self) -> float:
        return float(len(self.said))

    def obey(self, command: Command) -> None:
        match command:
            case OpenTopic(topic, host):
                self.topics[topic] = host
                self.said.append(f"open {topic}")
            case CloseTopic(topic):
                self.topics.pop(topic, None)
                self.said.append(f"close {topic}")
            case StartUnit(started):
                self.said.append(f"start {started.id}")
                if started.id not in self.dying:
                    self.alive.add(started.id)
                if started.id not in self.dying:
                    self.inactive.add(started.id)
                if started.id not in self.dying | self.slow:
                    self.ready.add(started.id)
            case ActivateUnit(name):
                self.inactive.remove(name)
                self.said.append(f"begin {name}")
                if name in self.dying:
                    self._end(name)
            case DeactivateUnit(name):
                self.inactive.add(name)
                self.said.append(f"pause {name}")
            case HoldUnit(name):
                self.said.append(f"hold {name}")
            case AskPlaces(name, inlets):
                self.said.append(" ".join(["places", name, *(inlet for inlet, is_begun in inlets.items() if is_begun)]))
                self.places.append(dict(inlets))
                self.answers.ask(command)
                self._answer(PlacesTold(name, dict.fromkeys(inlets, PLACE)))
            case AskState(name, until, successor):
                self.answers.ask(command)
                assert set(until.values()) <= {PLACE}
                assert successor in self.alive
                self.said.append(" ".join(["ask", name, *until]))
                state = None if name in self.stateless else f"that of {name}".encode()
                inputs = {inlet.port: GivenInput(PLACE) for inlet in self.feeds if inlet.unit == name}
                outputs = {wire.stream.port: PLACE for wire in self.feeds.values() if wire.stream.unit == name}
                self._answer(StateTold(name, state, inputs, outputs))
            case GiveState(name, state, inputs):
                self.said.append(f"give {name} {'what is known' if state is None else state.decode()} {sorted(inputs)}")
            case TellOf(event):
                self.said.append(f"{event.unit} after {event.before}: {event.cause}")
            case Doubt(event, unless):
                self.said.append(f"{event.unit} after {event.before}: {event.cause} unless {dict(unless)}")
            case StopUnit(name):
                self.said.append(f"stop {name}")
                if name not in self.stubborn:
                    self._end(name)
            case StopAgain(name):
                self.said.append(f"stop {name} again")
            case CutShort(name, after_s):
                self.said.append(f"cut {name} short after {after_s:g} s")
                self._end(name)
            case EndUnit(name):
                self.said.append(f"end {name}")
                self._end(name)
            case Dump(name):
                self.said.append(f"dump {name}")
            case Connect(stream, inlet):
                self.said.append(f"{stream} > {inlet}")
                self.feeds[inlet] = Wire(0, stream, inlet, has_switched=stream.unit not in self.quiet)
            case Disconnect(inlet):
                self.said.append(f"cut {inlet}")
                del self.feeds[inlet]
            case SwitchNow(inlet):
                self.said.append(f"go over {inlet}")
            case SetEnvironment(environment):
                self.environment = environment
            case WaitUntil(holds):
                self.said.append("wait" if holds() else "wait in vain")

    def _answer(self, event: PlacesTold | StateTold) -> None:
        if event.unit not in self.mute:
            self.answers.note(event)

    def _end(self, name: str) -> None:
        self.alive.discard(name)
        self.inactive.discard(name)
        for inlet in [inlet for inlet in self.feeds if inlet.unit == name]:
            del self.feeds[inlet]
        for wire in self.feeds.values():
            wire.has_switched = True  # the end of a source is what its standby waits for

    def carry_out(self, change_set: ChangeSet, *, keeps_new: bool = False) -> CarriedOut:
        after = environment_after(self.environment, change_set)
        commands = carry_out(self, change_set, after, Patience(), keeps_new=keeps_new)
        while True:
            try:
                self.obey(next(commands))
            except StopIteration as end:
                assert isinstance(end.value, CarriedOut)
                return end.value


@pytest.mark.parametrize(
    ("scene", "change_set", "said", "unswitched"),
    [
        (
            Scene(replace(RUNNING, units=())),
            start(COUNT, WORK),
            f"open /result, start count.1, start work.1, wait, {WIRED}, begin work.1, begin count.1, wait, wait, wait",
            0,
        ),
        (
            Scene(replace(RUNNING, units=()), unfollowed={"/result"}),
            start(COUNT, WORK),
            (
                f"open /result, start count.1, start work.1, wait, wait in vain, {WIRED}, begin work.1, begin count.1, "
                "wait, wait, wait"
            ),
            0,
        ),
        (
            Scene(unfollowed={"/result"}, is_abandoned=True),
            ChangeSet(started=(unit("work.2", topic="/other", x="count.1/n"),)),
            (
                "open /other, start work.2, wait, count.1/n > work.2/x, work.2/y > /other, begin work.2, wait, wait, "
                "wait"
            ),
            0,
        ),
        (Scene(unfollowed={"/result"}), SWAP, f"{BESIDE}, wait, stop work.1, wait, wait, wait", 0),
        (Scene(), SWAP, f"{BESIDE}, wait, stop work.1, wait, wait, wait", 0),
        (Scene(quiet={"work.2"}), SWAP, f"{BESIDE}, wait in vain, stop work.1, wait, wait, wait", 1),
        (Scene(failing={"work.2"}), SWAP, f"{BESIDE}, wait, stop work.1, wait, wait, wait", 0),
        (
            Scene(quiet={"work.2"}, failing={"work.2"}, dry={"work.1"}),
            SWAP,
            f"{BESIDE}, wait, stop work.1, wait, wait, wait",
            1,
        ),
        (Scene(quiet={"work.2"}, dry={"work.1"}), SWAP, f"{BESIDE}, wait, stop work.1, wait, wait, wait", 1),
        (
            Scene(stubborn={"work.1"}),
            ChangeSet(stopped=("work.1",)),
            f"wait, wait, cut /result, stop work.1, {IN_VAIN} after 2 s, wait, wait",
            0,
        ),
        (
            Scene(stubborn={"work.1"}, limits={"work.1": 0.5}),
            ChangeSet(stopped=("work.1", "count.1")),
            f"wait, wait, cut /result, stop count.1, stop work.1, {IN_VAIN} after 0.5 s, wait, wait, wait",
            0,
        ),
        (
            Scene(),
            ChangeSet(removed_targets=("result",), rewired=(replace(WORK, publications=()),)),
            "wait, wait, cut /result, wait, wait, close /result",
            0,
        ),
        (
            Scene(replace(RUNNING, library=(*RUNNING.library, source("quiet"))), quiet={"quiet.1"}),
            ChangeSet(started=(unit("quiet.1"),), rewired=(unit("work.1", topic="/result", x="quiet.1/n"),)),
            (
                "start quiet.1, wait, quiet.1/n > work.1/x, begin quiet.1, "
                "wait in vain, go over work.1/x, wait, wait in vain"
            ),
            1,
        ),
    ],
    ids=[
        "a start",
        "a start that is not followed",
        "another topic than one that is not followed",
        "a topic that has a source and is not followed",
        "a swap",
        "a quiet one",
        "one that fails and gives",
        "one that fails in the place of a dry one",
        "none to wait for",
        "a stubborn one",
        "one with a limit of its own",
        "a topic less",
        "two that stay",
    ],
)
def test_an_update_gives_its_commands_in_this_order(
    scene: Scene, change_set: ChangeSet, said: str, unswitched: int
) -> None:
    carried = scene.carry_out(change_set)
    assert (", ".join(scene.said), carried.unswitched) == (said, unswitched)
    assert carried.environment == environment_after(scene.environment, change_set)
    assert set(carried.seconds) == {"start", "rewire", "stop"}


@pytest.mark.parametrize(
    ("scene", "cause", "said"),
    [
        (
            Scene(dying={"work.2"}, ends={"work.2": "could not start: no camera"}),
            r"work\.2 could not start: no camera",
            ["wait"],
        ),
        (Scene(slow={"work.2"}), r"work\.2 was not ready within 30 s", ["wait in vain", "dump work.2", "wait in vain"]),
        (Scene(slow={"work.2"}, is_abandoned=True), r"given up while work\.2 was starting", ["wait"]),
    ],
    ids=["dead", "slow", "abandoned"],
)
def test_an_update_whose_unit_does_not_start_is_undone(scene: Scene, cause: str, said: list[str]) -> None:
    feeds = dict(scene.feeds)
    with pytest.raises(ApplyError, match=cause) as caught:
        scene.carry_out(SWAP)
    assert caught.value.units == ("work.2",)
    assert isinstance(caught.value, AbandonedError) is scene.is_abandoned
    assert scene.said[: 1 + len(said)] == ["start work.2", *said]
    assert [line for line in scene.said if " > " in line or line.startswith(("open", "close"))] == []
    assert (scene.feeds, scene.alive) == (feeds, {"count.1", "work.1"})


HIGH, LOW = (worker(label, run=RunOptions(state="altitude")) for label in ("high", "low"))
MODES = Environment((COUNT, unit("high.1", topic="/result", x="count.1/n")), (source(), HIGH, LOW), (RESULT,))
LOWER = ChangeSet(started=(unit("low.1", topic="/result", x="count.1/n"),), stopped=("high.1",))
NEXT = "hold low.1, count.1/n > low.1/x, low.1/y > /result"


@pytest.mark.parametrize(
    ("scene", "said"),
    [
        (Scene(MODES), "places low.1, wait, ask high.1 x, wait, give low.1 that of high.1 ['x'], wait"),
        (
            Scene(MODES, mute={"high.1"}),
            (
                "places low.1, wait, ask high.1 x, wait in vain, give high.1 what is known [], "
                "give low.1 what is known [], wait, low.1 after high.1: high.1 did not tell its state within 1 s"
            ),
        ),
        (
            Scene(MODES, stateless={"high.1"}),
            (
                "places low.1, wait, ask high.1 x, wait, give low.1 what is known [], wait, "
                "low.1 after high.1: the code of high.1 gives no state"
            ),
        ),
        (
            Scene(MODES, mute={"low.1"}),
            (
                "places low.1, wait in vain, ask high.1, wait, give low.1 that of high.1 ['x'], wait, "
                "low.1 after high.1: an input of low.1 got nothing within 0.5 s unless {'x': (7, 0)}"
            ),
        ),
    ],
    ids=["an answer each", "no answer", "no state", "no place"],
)
def test_a_unit_goes_on_with_the_present_state_of_the_one_that_it_replaces(scene: Scene, said: str) -> None:
    scene.carry_out(LOWER)
    assert ", ".join(scene.said).startswith(f"start low.1, wait, {NEXT}, begin low.1, {said}, stop high.1")


@pytest.mark.parametrize(
    ("last", "said"),
    [(HoldUnit, "high.1 died"), (AskPlaces, "high.1 died before it told its state")],
    ids=["before its hand-over", "in its hand-over"],
)
def test_an_update_goes_on_with_the_last_known_state_if_the_unit_that_it_replaces_dies(
    last: type[Command], said: str
) -> None:
    scene = Scene(MODES, mute={"high.1", "low.1"})
    commands = carry_out(scene, LOWER, environment_after(scene.environment, LOWER), Patience())
    while not isinstance(command := next(commands), last):
        scene.obey(command)
    scene.obey(command)
    scene._end("high.1")
    scene.environment = scene.environment.without_unit("high.1")
    with pytest.raises(StopIteration):
        while True:
            scene.obey(next(commands))
    assert "give low.1 what is known []" in scene.said
    assert f"low.1 after high.1: {said}" in scene.said
    assert "wait in vain" not in scene.said, "nothing is awaited from a unit that is gone"


def test_no_later_place_excludes_that_an_element_of_a_new_source_is_missing() -> None:
    """Its place is its first element, which has become a step by then."""
    scene = Scene(MODES, mute={"low.1"})
    new = unit("count.2"), unit("low.1", topic="/result", x="count.2/n")
    scene.carry_out(ChangeSet(started=new, stopped=("count.1", "high.1")))
    assert scene.places == [{"x": True}]
    assert "low.1 after high.1: an input of low.1 got nothing within 0.5 s" in scene.said


def test_no_exception_is_told_of_a_hand_over_that_is_undone() -> None:
    """The old unit continues with its own state."""
    scene = Scene(MODES, mute={"high.1"}, quiet={"low.1"}, failing={"low.1"})
    with pytest.raises(ApplyError):
        scene.carry_out(LOWER)
    assert "give high.1 what is known []" in scene.said
    assert not [said for said in scene.said if said.startswith("low.1 after")]


def test_a_hand_over_asks_for_no_place_that_the_unit_before_can_not_know() -> None:
    """The new mode has one more input, whose source gives nothing yet, for example."""
    high, low = MODES.library[1:]
    wide = replace(low, inputs=(*low.inputs, InputPort("z", "N")))
    scene = Scene(replace(MODES, library=(MODES.library[0], high, wide, MAP)))
    (new,) = LOWER.started
    more = unit(new.id, topic="/result", x="count.1/n", z="map.1/n")
    scene.carry_out(ChangeSet(started=(unit("map.1"), more), stopped=LOWER.stopped))
    assert scene.places == [{"x": False}]


def joined(number: int, **more: str) -> ComputationUnit:
    return unit(f"join.{number}", a="count.1/n", b="map.1/n", **more)


MAP, JOIN = source("map"), worker("join", "add", inputs=("a", "b"))
JOINING = Environment((COUNT, unit("map.1"), joined(1, topic="/result")), (source(), MAP, JOIN), (RESULT,))
JOIN_AGAIN = ChangeSet(started=(joined(2, topic="/result"),), stopped=("join.1",))


@pytest.mark.parametrize(
    ("code", "is_held"),
    [("units.py:Join", True), ("program:./join", False), ("node:package/join", False)],
)
def test_only_python_units_hand_over_the_elements_that_wait_in_them(code: str, *, is_held: bool) -> None:
    scene = Scene(replace(JOINING, library=(source(), MAP, replace(JOIN, source=code))))
    scene.carry_out(JOIN_AGAIN)
    assert [said for said in scene.said if said.startswith(("hold", "places", "ask", "give"))] == (
        ["hold join.2", "places join.2", "ask join.1 a b", "give join.2 that of join.1 ['a', 'b']"] if is_held else []
    )


def test_no_hand_over_waits_for_the_next_element_of_a_source_that_ends_and_gives_none() -> None:
    """The new source gives at once: a map that comes once, for example."""
    scene = Scene(JOINING, dry={"map.1"})
    new = unit("join.2", topic="/result", a="count.1/n", b="map.2/n")
    scene.carry_out(ChangeSet(started=(unit("map.2"), new), stopped=("join.1", "map.1")))
    assert [said for said in scene.said if said.startswith(("places", "ask"))] == ["places join.2", "ask join.1 a"]


def test_units_without_a_state_that_do_not_answer_hold_up_an_update_only_once() -> None:
    """Their inputs come from a source that blocks in its code, for example."""
    numbers = range(1, 21)
    targets = [Target(f"t{number}", "Y", f"/{number}") for number in numbers]
    library = [source(), MAP, *(replace(JOIN, label=f"join{number}") for number in numbers)]

    def units(of: int) -> tuple[ComputationUnit, ...]:
        return tuple(unit(f"join{number}.{of}", topic=f"/{number}", a="count.1/n", b="map.1/n") for number in numbers)

    old, new = units(1), units(2)
    environment = Environment((COUNT, unit("map.1"), *old), tuple(library), tuple(targets))
    scene = Scene(environment, mute={one.id for one in (*old, *new)})
    change_set = ChangeSet(started=new, stopped=tuple(one.id for one in old))
    waited_s = 0.0
    for command in carry_out(scene, change_set, environment_after(environment, change_set), Patience()):
        if isinstance(command, WaitUntil) and not command.holds():
            waited_s += command.patience_s
        scene.obey(command)
    assert len([said for said in scene.said if said.startswith("hold")]) == len(numbers)
    assert waited_s <= 3.0


def test_a_unit_that_an_undone_update_has_kept_is_given_the_state_by_the_next() -> None:
    kept = replace(MODES, units=(*MODES.units, unit("low.1")))
    scene = Scene(kept)
    scene.carry_out(ChangeSet(rewired=LOWER.started, stopped=LOWER.stopped))
    told = "places low.1, wait, ask high.1 x, wait, give low.1 that of high.1 ['x'], wait"
    assert ", ".join(scene.said).startswith(f"wait, {NEXT}, {told}, stop high.1")


def test_after_an_undone_handover_the_old_unit_continues_and_a_kept_new_one_gets_no_second_state() -> None:
    quiet = worker("quiet")
    environment = replace(MODES, library=(*MODES.library, quiet))
    change_set = replace(LOWER, started=(*LOWER.started, unit("quiet.1", x="low.1/y")))
    scene = Scene(environment, quiet={"low.1", "quiet.1"}, failing={"quiet.1"})
    with pytest.raises(ApplyError):
        scene.carry_out(change_set, keeps_new=True)
    given = [said for said in scene.said if said.startswith("give")]
    assert given == ["give low.1 that of high.1 ['x']", "give high.1 what is known []"]
    assert scene.said.index(given[1]) < scene.said.index("cut low.1/x"), (
        "the old unit gives results again before the new one is cut"
    )
    assert {"low.1", "high.1"} <= scene.alive


def test_a_unit_continues_if_its_successor_dies_before_it_has_the_state() -> None:
    scene = Scene(MODES)
    commands = carry_out(scene, LOWER, environment_after(scene.environment, LOWER), Patience())
    while not isinstance(command := next(commands), AskState):
        scene.obey(command)
    scene.obey(command)
    scene.alive.discard("low.1")
    with pytest.raises(ApplyError, match=r"low\.1 died"):
        for command in commands:
            scene.obey(command)
    assert "give high.1 what is known []" in scene.said


def test_a_state_is_not_asked_for_if_a_new_unit_has_died() -> None:
    scene = Scene(MODES, mute={"low.1"})
    commands = carry_out(scene, LOWER, environment_after(scene.environment, LOWER), Patience())
    while not isinstance(command := next(commands), AskPlaces):
        scene.obey(command)
    scene.alive.discard("low.1")
    with pytest.raises(ApplyError, match=r"low\.1 died"):
        for command in commands:
            scene.obey(command)
    assert not [said for said in scene.said if said.startswith(("ask", "low.1 after"))]


def test_a_unit_tells_its_state_after_the_units_without_one_that_take_its_topics_have_begun() -> None:
    """They do not make the steps before their first element."""
    other = worker("other")
    scene = Scene(replace(MODES, library=(*MODES.library, other)))
    (low,) = LOWER.started
    topic = unit("other.1", topic="/result", x="count.1/n")
    scene.carry_out(ChangeSet(started=(replace(low, publications=()), topic), stopped=LOWER.stopped))
    said = ", ".join(scene.said)
    assert "begin other.1, wait, places low.1" in said


def test_a_unit_that_an_undone_update_has_kept_waits_for_no_state_after_the_next_is_undone_too() -> None:
    scene = Scene(replace(MODES, units=(*MODES.units, unit("low.1"))))
    change_set = ChangeSet(rewired=LOWER.started, stopped=LOWER.stopped)
    commands = carry_out(scene, change_set, environment_after(scene.environment, change_set), Patience())
    while not isinstance(command := next(commands), Connect):
        scene.obey(command)
    scene.obey(commands.throw(OSError("no socket")))
    with pytest.raises(ApplyError, match="no socket"):
        for command in commands:
            scene.obey(command)
    assert [said for said in scene.said if said != "wait"] == ["hold low.1", "give low.1 what is known []"]
    assert {"low.1", "high.1"} <= scene.alive


def test_a_unit_that_replaces_none_is_given_no_state() -> None:
    scene = Scene(MODES)
    scene.carry_out(start(unit("low.1", x="count.1/n")))
    assert not [word for word in scene.said if word.startswith(("hold", "ask", "give"))]


def test_states_are_handed_over_from_upstream_to_downstream() -> None:
    """The last element of the unit upstream says where the one downstream stops."""
    first, second = (worker(label, run=RunOptions(state=True)) for label in ("first", "second"))

    def chain(number: int) -> tuple[ComputationUnit, ...]:
        # The one downstream has the lower name.
        return (
            unit(f"first.{number}", topic="/result", x=f"second.{number}/y"),
            unit(f"second.{number}", x="count.1/n"),
        )

    scene = Scene(Environment((COUNT, *chain(1)), (source(), first, second), (RESULT,)))
    scene.carry_out(ChangeSet(started=chain(2), stopped=("first.1", "second.1")))
    asked = [said for said in scene.said if said.startswith(("places", "ask", "give"))]
    assert asked == [
        "places second.2",
        "ask second.1 x",
        "give second.2 that of second.1 ['x']",
        "ask first.1 x",
        "give first.2 that of first.1 ['x']",
    ]


def test_no_switch_waits_for_a_source_that_has_told_its_state() -> None:
    """It gives nothing any more: nothing says which elements of the next source would repeat its own."""
    quiet, other = (source(label) for label in ("count", "other"))
    quiet, other = (replace(one, run=replace(one.run, state="n")) for one in (quiet, other))
    running = Environment((unit("count.1", topic="/result", port="n"),), (quiet, other), (RESULT,))
    scene = Scene(running, quiet={"other.1"})
    scene.carry_out(ChangeSet(started=(unit("other.1", topic="/result", port="n"),), stopped=("count.1",)))
    assert "wait in vain" not in scene.said[: scene.said.index("stop count.1")]


def test_a_new_unit_that_only_fails_does_not_take_over_from_one_that_gives() -> None:
    scene = Scene(quiet={"work.2"}, failing={"work.2"})
    with pytest.raises(ApplyError, match=r"work\.2 gives nothing, since its code fails: bad luck") as caught:
        scene.carry_out(SWAP)
    assert caught.value.units == ("work.2",)
    assert (str(scene.feeds[Inlet("", "/result")].stream), scene.alive) == ("work.1/y", {"count.1", "work.1"})


def test_a_new_unit_is_not_blamed_for_one_before_it_that_fails() -> None:
    library = (*RUNNING.library, source("count2"))
    scene = Scene(replace(RUNNING, library=library), quiet={"work.2", "count2.1"}, failing={"count2.1"})
    change_set = ChangeSet(
        (unit("count2.1"), unit("work.2", topic="/result", x="count2.1/n")), stopped=("count.1", "work.1")
    )
    with pytest.raises(ApplyError, match=r"count2\.1 gives nothing") as caught:
        scene.carry_out(change_set)
    assert caught.value.units == ("count2.1",)


def test_what_has_not_failed_may_stay_unconnected() -> None:
    scene = Scene(replace(RUNNING, library=(*RUNNING.library, worker("bad"))), dying={"bad.1"})
    change_set = start(NEW, unit("bad.1", x="work.2/y"))
    commands = carry_out(
        scene, change_set, environment_after(scene.environment, change_set), Patience(), keeps_new=True
    )
    with pytest.raises(ApplyError, match=r"bad\.1 died"):
        for command in commands:
            scene.obey(command)
    assert scene.said == ["start bad.1", "start work.2", "wait", "wait", "stop bad.1", "end bad.1", "wait", "wait"]
    assert scene.environment.unit["work.2"] == unit("work.2")
    assert set(scene.environment.unit) == {"count.1", "work.1", "work.2"}


@pytest.mark.parametrize(
    ("feed", "is_target", "begins"),
    [("give.1/n", False, False), ("give.1/n", True, True), ("count.1/n", False, True)],
    ids=["its stream is wanted", "a target wants it to run", "nothing is to be connected"],
)
def test_a_unit_that_an_undone_update_keeps_begins_when_the_next_has_connected_it(
    feed: str, is_target: bool, begins: bool
) -> None:
    """A source that begins unconnected would take messages from a broker and lose them."""
    targets = (RESULT, *([Target("runs", run="give")] if is_target else []))
    library = (source(), worker(), source("give"), worker("bad"))
    scene = Scene(replace(RUNNING, library=library, targets=targets), dying={"bad.1"})
    with pytest.raises(ApplyError, match=r"bad\.1 died"):
        scene.carry_out(start(unit("give.1"), unit("bad.1", x=feed)), keeps_new=True)
    assert ("begin give.1" in scene.said) is begins
    scene.said.clear()
    scene.carry_out(ChangeSet(started=(unit("work.2", x="give.1/n"),)))
    said = "start work.2, wait, give.1/n > work.2/x, begin work.2"
    assert ", ".join(scene.said).startswith(f"{said}{'' if begins else ', begin give.1'}, wait")


def test_a_unit_that_has_begun_and_that_an_undone_update_keeps_pauses_until_the_next_has_connected_it() -> None:
    library = (source(), worker(), source("give"), worker("bad"))
    scene = Scene(replace(RUNNING, library=library), quiet={"bad.1"}, failing={"bad.1"})
    started = unit("give.1"), unit("bad.1", topic="/result", x="give.1/n")
    with pytest.raises(ApplyError, match="bad luck"):
        scene.carry_out(ChangeSet(started, rewired=(replace(WORK, publications=()),)), keeps_new=True)
    assert scene.said.index("work.1/y > /result") < scene.said.index("pause give.1"), "it feeds the topic until then"
    assert scene.inactive == {"give.1"}
    scene.carry_out(ChangeSet(started=(unit("work.2", x="give.1/n"),)))
    assert scene.inactive == set()


@pytest.mark.parametrize("keeps_new", [False, True])
def test_a_unit_that_an_undone_update_has_kept_pauses_again_if_the_next_is_undone_too(keeps_new: bool) -> None:
    library = (source(), worker(), source("give"), worker("bad"))
    scene = Scene(replace(RUNNING, units=(*RUNNING.units, unit("give.1")), library=library), failing={"bad.1"})
    scene.quiet, scene.inactive = {"bad.1"}, {"give.1"}
    started = (unit("bad.1", topic="/result", x="give.1/n"),)
    with pytest.raises(ApplyError, match="bad luck"):
        scene.carry_out(ChangeSet(started, rewired=(replace(WORK, publications=()),)), keeps_new=keeps_new)
    assert "begin give.1" in scene.said
    assert scene.inactive == {"give.1"}


def test_an_update_is_undone_if_a_unit_that_an_undone_one_has_kept_dies() -> None:
    scene = Scene(replace(RUNNING, units=(*RUNNING.units, unit("work.2"))), dying={"work.2"})
    scene.inactive = {"work.2"}
    with pytest.raises(ApplyError, match=r"work\.2 died"):
        scene.carry_out(ChangeSet(rewired=(unit("work.2", topic="/result", x="count.1/n"),), stopped=("work.1",)))
    assert "stop work.1" not in scene.said
    assert scene.environment.unit.keys() == {"count.1", "work.1"}


@pytest.mark.parametrize("kept", ["high.0", "high.2"])
def test_a_state_comes_from_the_active_one_of_two_units_that_end(kept: str) -> None:
    """The other one was kept by an undone update: its state is that of its start."""
    scene = Scene(replace(MODES, units=(*MODES.units, unit(kept))))
    scene.inactive = {kept}
    scene.carry_out(replace(LOWER, stopped=("high.1", kept)))
    assert "give low.1 that of high.1 ['x']" in scene.said


def test_what_was_rewired_goes_back_before_the_new_unit_ends() -> None:
    scene = Scene(quiet={"work.2"})
    commands = carry_out(scene, SWAP, environment_after(RUNNING, SWAP), Patience())
    for command in commands:
        if isinstance(command, WaitUntil) and "work.2/y > /result" in scene.said:
            break
        scene.obey(command)
    scene.alive.discard("work.2")
    scene.said.clear()
    with pytest.raises(ApplyError, match=r"work\.2 died"):
        for command in commands:
            scene.obey(command)
    assert scene.said == ["work.1/y > /result", "wait", "stop work.2", "wait", "wait"]
    assert str(scene.feeds[Inlet("", "/result")].stream) == "work.1/y"


def test_a_topic_that_an_undone_update_has_opened_is_closed() -> None:
    scene = Scene(dying={"work.2"})
    with pytest.raises(ApplyError):
        scene.carry_out(start(replace(NEW, publications=unit("work.2", topic="/other").publications)))
    assert (scene.said[0], scene.said[-1], scene.topics.keys()) == ("open /other", "close /other", {"/result"})


def test_what_died_meanwhile_is_not_rewired_and_missing_afterwards() -> None:
    scene = Scene(replace(RUNNING, library=(*RUNNING.library, source("other"))))
    commands = carry_out(
        scene,
        change := ChangeSet((unit("other.1"),), (unit("work.1", topic="/result", x="other.1/n"),)),
        environment_after(scene.environment, change),
        Patience(),
    )
    scene.obey(next(commands))
    scene.obey(EndUnit("work.1"))
    del scene.feeds[Inlet("", "/result")]
    with pytest.raises(StopIteration) as caught:
        while True:
            scene.obey(next(commands))
    assert set(caught.value.value.environment.unit) == {"count.1", "other.1"}
    assert "other.1/n > work.1/x" not in scene.said


def test_a_topic_gets_its_address_on_the_host_of_its_target() -> None:
    hosts = (Host("r1"), Host("r2"))
    wanted = replace(RUNNING, units=(), targets=(replace(RESULT, host="r2"),), hosts=hosts)
    change_set = ChangeSet(started=(replace(COUNT, host="r1"), replace(WORK, host="r2")))
    commands = carry_out(Scene(wanted), change_set, environment_after(wanted, change_set), Patience())
    assert next(commands) == OpenTopic("/result", "r2")
