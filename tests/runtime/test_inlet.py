"""An inlet that changes its source: nothing lost, repeated or reordered. No process."""

from __future__ import annotations

from itertools import pairwise

from cfgplan_runtime.streams.element import Element
from cfgplan_runtime.streams.inlet import InputQueue
from hypothesis import given
from hypothesis import strategies as st


def element(time_ns: int, number: int = 0, turn: int = 0) -> Element:
    return Element(time_ns, turn, number, b"")


def times(elements: list[Element]) -> list[int]:
    return [one.time_ns for one in elements]


@given(
    st.integers(1, 40),
    st.integers(0, 39),
    st.lists(st.booleans(), min_size=80, max_size=80),
)
def test_a_handover_gives_each_element_once_and_in_order(length: int, joins_at: int, turns: list[bool]) -> None:
    """Both sources give the same stream; the standby from some element on; they come interleaved in any way."""
    inlet = InputQueue(limit=100)
    inlet.attach(1)
    waiting = {1: list(range(length)), 2: list(range(min(joins_at, length), length))}
    first = {1: 0, 2: min(joins_at, length)}
    handed_on: list[Element] = []
    is_joined = False
    for takes_standby in turns:
        wire = 2 if takes_standby else 1
        if wire == 2 and not is_joined:
            inlet.attach(2)
            is_joined = True
        if waiting[wire]:
            time_ns = waiting[wire].pop(0)
            handed_on += inlet.accept(wire, element(time_ns, time_ns - first[wire]))
    for wire in (1, 2):
        for time_ns in waiting[wire]:
            handed_on += inlet.accept(wire, element(time_ns, time_ns - first[wire]))
    assert times(handed_on) == list(range(length))
    assert inlet.dropped == 0


def test_the_first_source_is_active_at_once() -> None:
    assert InputQueue(limit=10).attach(1)


def test_the_standby_takes_over_when_the_active_source_dies() -> None:
    inlet = InputQueue(limit=10)
    inlet.attach(1)
    inlet.accept(1, element(1))
    inlet.attach(2)
    assert inlet.accept(2, element(3)) == []
    assert times(inlet.end(1)) == [3]
    assert (inlet.active, inlet.standby) == (2, None)


def test_an_inlet_whose_only_source_ends_is_free_for_the_next() -> None:
    inlet = InputQueue(limit=10)
    inlet.attach(1)
    inlet.end(1)
    assert inlet.attach(2)


def test_a_standby_that_is_taken_back_leaves_the_active_source() -> None:
    inlet = InputQueue(limit=10)
    inlet.attach(1)
    inlet.attach(2)
    inlet.accept(2, element(5))
    inlet.end(2)
    assert times(inlet.accept(1, element(5, 0))) == [5]
    assert inlet.active == 1


def test_a_standby_far_ahead_takes_over_before_it_fills_the_memory() -> None:
    inlet = InputQueue(limit=3)
    inlet.attach(1)
    inlet.attach(2)
    given_out = [inlet.accept(2, element(10 + i, i)) for i in range(3)]
    assert list(map(times, given_out)) == [[], [], [10, 11, 12]], "as many as have room where they are handed on"


@given(st.integers(0, 20), st.integers(21, 40), st.booleans(), st.booleans())
def test_what_a_source_that_was_left_too_early_gives_late_is_counted(
    came: int, joined_at: int, ends: bool, is_asked: bool
) -> None:
    """A link is cut after `came` elements; another source has the stream from `joined_at` on."""
    inlet = InputQueue(limit=10 if is_asked else 3)
    inlet.attach(1)
    handed_on = [one for time_ns in range(came) for one in inlet.accept(1, element(time_ns, time_ns))]
    inlet.attach(2)
    for number in range(4):
        handed_on += inlet.accept(2, element(joined_at + number, number))
    handed_on += inlet.switch() if is_asked else []
    for time_ns in range(came, joined_at + (0 if ends else 3)):
        assert inlet.accept(1, element(time_ns, time_ns)) == []
    inlet.end(1)
    assert times(handed_on) == [*range(came), *range(joined_at, joined_at + 4)]
    assert inlet.dropped == joined_at - came
    assert inlet.sources == {2}


def test_a_source_that_was_left_for_one_that_gives_nothing_is_taken_up_to_then() -> None:
    """A link is cut after the element 2; the new source begins at 6, and was switched to at 5."""
    inlet = InputQueue(limit=10)
    inlet.attach(1)
    handed_on = [one for time_ns in range(3) for one in inlet.accept(1, element(time_ns, time_ns))]
    inlet.attach(2)
    assert inlet.switch((5, 0)) == []
    handed_on += inlet.accept(1, element(3, 3))
    handed_on += inlet.accept(2, element(6, 0))
    handed_on += inlet.accept(1, element(4, 4))
    handed_on += inlet.accept(1, element(5, 5))
    assert times(handed_on) == [0, 1, 2, 3, 6]
    assert (inlet.dropped, inlet.sources) == (1, {2}), "4 was lost; 5 was given after the switch"


@given(st.permutations([1, 1, 1, 1, 2, 2, 2, 2]))
def test_what_is_late_from_two_sources_that_were_left_one_after_the_other_is_counted(late: list[int]) -> None:
    """1 gives 0 to 8 and is left at 4 for 2, which gives 4 to 10 and is left at 8 for 3; 1 to 3 and 5 to 7 are late."""
    inlet = InputQueue(limit=10)
    handed_on = []
    waiting = {1: [1, 2, 3, 4], 2: [5, 6, 7, 8]}
    for wire, time_ns in ((1, 0), (2, 4), (3, 8)):
        inlet.attach(wire)
        handed_on += inlet.accept(wire, element(time_ns))
        handed_on += inlet.switch()
    for wire in late:
        time_ns = waiting[wire].pop(0)
        handed_on += inlet.accept(wire, element(time_ns, time_ns - {1: 0, 2: 4}[wire]))
    assert times(handed_on) == [0, 4, 8]
    assert (inlet.dropped, inlet.sources) == (6, {3})


def test_gaps_in_the_numbers_are_counted_as_drops() -> None:
    inlet = InputQueue(limit=10)
    inlet.attach(1)
    for time_ns, number in ((1, 0), (2, 3), (3, 4)):
        inlet.accept(1, element(time_ns, number))
    assert inlet.dropped == 2


def test_elements_of_one_time_are_told_apart_by_their_turn() -> None:
    inlet = InputQueue(limit=10)
    inlet.attach(1)
    assert len(inlet.accept(1, element(1, 0, 0)) + inlet.accept(1, element(1, 1, 1))) == 2
    assert inlet.accept(1, element(1, 2, 1)) == []
    assert inlet.stale == 1


@given(st.data())
def test_no_order_of_deeds_reverses_elements_or_loses_one_uncounted(data: st.DataObject) -> None:
    """Units come, each with the same stream from some element on. All but the latest may pause, and continue after a
    while, or end behind their last element.
    """
    limit = data.draw(st.integers(2, 6), "limit")
    inlet, handed_on = InputQueue(limit), list[Element]()
    wires: dict[int, list[Element | None]] = {}
    """What was sent over each wire and has not come; None for a pause."""
    given_by, ended = dict[int, int](), set[int]()
    """The number of elements that each unit has given, and the units that have ended."""
    pauses: dict[int, int] = {}
    """The number of elements that were made before each unit paused."""
    begun = made = 0

    def give(wire: int, numbers: range) -> None:
        for number in numbers:
            wires[wire].append(element(number, given_by[wire]))
            given_by[wire] += 1

    for _ in range(data.draw(st.integers(1, 60), "deeds")):
        come = [wire for wire, sent in wires.items() if sent]
        gone = [wire for wire, sent in wires.items() if wire in ended and not sent]
        deeds = ["begin", "make", "switch", *["come"] * 4 * bool(come), *["gone"] * bool(gone)]
        replaced = sorted(wires.keys() - ended)[:-1]
        deeds += ["end", "pause"] * bool(replaced) + ["resume"] * bool(pauses.keys() & replaced)
        match data.draw(st.sampled_from(deeds)):
            case "begin":
                begun += 1
                wires[begun], given_by[begun] = [], 0
                inlet.attach(begun)
            case "end":
                ended.add(data.draw(st.sampled_from(replaced)))
            case "make":
                for wire in wires.keys() - ended - pauses.keys():
                    give(wire, range(made, made + 1))
                made += bool(wires)
            case "pause":
                wire = data.draw(st.sampled_from(replaced))
                pauses[wire] = pauses.get(wire, made)
                wires[wire].append(None)
            case "resume":
                wire = data.draw(st.sampled_from(sorted(pauses.keys() & replaced)))
                give(wire, range(pauses.pop(wire), made))
            case "come":
                wire = data.draw(st.sampled_from(come))
                first = wires[wire].pop(0)
                handed_on += inlet.pause(wire) if first is None else inlet.accept(wire, first)
            case "gone":
                wire = data.draw(st.sampled_from(gone))
                del wires[wire]
                handed_on += inlet.end(wire)
            case "switch":
                handed_on += inlet.switch((made, 0))
        for wire in wires.keys() - inlet.sources:
            del wires[wire]  # its socket is closed
    came = times(handed_on)
    assert came == sorted(set(came))
    missing = sum(after - before - 1 for before, after in pairwise(came))
    late = sum(
        sum(one is not None for one in sent)
        for wire, sent in wires.items()
        if wire not in (inlet.active, inlet.standby)
    )
    assert missing <= inlet.dropped + late


def test_an_inlet_switches_from_a_source_that_pauses_at_the_first_element_of_the_next() -> None:
    inlet = InputQueue(limit=10)
    inlet.attach(1)
    inlet.attach(2)
    assert times(inlet.accept(1, element(1))) == [1]
    assert (inlet.pause(1), inlet.active, inlet.is_paused) == ([], 1, True)
    assert times(inlet.accept(2, element(2))) == [2]
    assert (inlet.active, inlet.is_paused) == (2, False)


def test_an_inlet_switches_when_a_source_pauses_of_whose_successor_an_element_waits() -> None:
    inlet = InputQueue(limit=10)
    inlet.attach(1)
    inlet.attach(2)
    assert inlet.accept(2, element(2)) == []
    assert times(inlet.accept(1, element(1)) + inlet.pause(1)) == [1, 2]
    assert inlet.active == 2


def test_after_a_pause_the_earliest_standby_is_next_unless_it_pauses_too() -> None:
    inlet = InputQueue(limit=10)
    for wire in (1, 2, 3):
        inlet.attach(wire)
    handed_on = inlet.accept(1, element(1)) + inlet.pause(1) + inlet.accept(3, element(3))
    assert times(handed_on) == [1], "an element of 2 may come before that of 3"
    assert times(inlet.pause(2)) == [3]
    assert inlet.active == 3


def test_an_inlet_keeps_nothing_of_a_source_that_has_paused_and_is_not_read_any_more() -> None:
    inlet = InputQueue(limit=10)
    inlet.attach(1)
    inlet.attach(2)
    inlet.accept(1, element(1))
    inlet.pause(1)
    inlet.accept(2, element(1))
    assert (inlet.sources, inlet._paused) == ({2}, set())


def test_a_source_that_gives_again_pauses_no_longer() -> None:
    inlet = InputQueue(limit=10)
    inlet.attach(1)
    inlet.attach(2)
    assert times(inlet.accept(1, element(1)) + inlet.pause(1) + inlet.accept(1, element(2))) == [1, 2]
    assert inlet.accept(2, element(3)) == []
    assert inlet.active == 1


def test_a_source_between_two_others_is_read_where_the_first_one_ended() -> None:
    """1 ends behind the element 1; 2 begins at 2, and is replaced by 3, which begins at 4, before the end is read."""
    inlet = InputQueue(limit=10)
    inlet.attach(1)
    handed_on = inlet.accept(1, element(0, 0))
    inlet.attach(2)
    inlet.attach(3)
    for time_ns in (2, 3, 4):
        handed_on += inlet.accept(2, element(time_ns, time_ns - 2))
    inlet.end(2)
    handed_on += inlet.accept(3, element(4, 0))
    handed_on += inlet.accept(1, element(1, 1))
    handed_on += inlet.end(1)
    assert times(handed_on) == [0, 1, 2, 3, 4]
    assert (inlet.active, inlet.dropped, inlet.sources) == (3, 0, {3})
