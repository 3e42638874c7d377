"""Crossings over links that lose, repeat and reorder what they carry."""

from __future__ import annotations

from collections import deque
from random import Random

import pytest
from cfgplan_runtime.streams.crossing import (
    _FIRST_FRAME,
    BYTES_UNDER_WAY,
    FRAMES_UNDER_WAY,
    LAST_SEGMENT,
    MOST_PIECES,
    PAUSE_SEGMENT,
    Credit,
    Frame,
    Receiving,
    Segment,
    Sending,
    read_credit,
    read_frame,
)
from hypothesis import given, settings
from hypothesis import strategies as st

MARK = Segment(0, 0, b"work.1", is_mark=True)


def segment(number: int, size: int = 8) -> Segment:
    return Segment(number, 0, number.to_bytes(8, "little") + bytes(size - 8))


def carry(sending: Sending, receiving: Receiving, random: Random, *, loss: float, until_s: float) -> list[Segment]:
    """Let time pass over a link that loses, repeats and reorders; returns what was handed on."""
    came: list[Segment] = []
    frames: list[Frame] = []
    told_credits: list[Credit] = []
    now_s = 0.0
    while now_s < until_s:
        for frame in sending.due(now_s):
            frames += [frame] * random.choice((1, 1, 2)) if random.random() >= loss else []
        random.shuffle(frames)
        for _ in range(random.randrange(len(frames) + 1)):
            came += receiving.take(frames.pop(), now_s)
        told = receiving.credit(now_s)
        if told is not None and random.random() >= loss:
            told_credits.append(told)
        random.shuffle(told_credits)
        for _ in range(random.randrange(len(told_credits) + 1)):
            sending.hear(told_credits.pop(), now_s)
        now_s += 0.01
    return came


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32), st.integers(0, 600), st.sampled_from((0.0, 0.1, 0.5)), st.sampled_from((8, 100_000)))
def test_every_piece_comes_once_and_in_order(seed: int, count: int, loss: float, size: int) -> None:
    sending, receiving = Sending(), Receiving()
    count = min(count, 4_000_000 // size)
    for number in range(count):
        sending.offer(segment(number, size))
    sending.offer(LAST_SEGMENT)
    came = carry(sending, receiving, Random(seed), loss=loss, until_s=300.0 if loss else 30.0)
    assert [one.time_ns for one in came[:-1]] == list(range(count))
    assert came[-1].is_last
    assert (sending.dropped, receiving.dropped, sending.depth) == (0, 0, 0)


def test_what_has_no_room_during_a_cut_is_dropped_oldest_first_and_told() -> None:
    sending, receiving = Sending(), Receiving()
    lost = 10
    for number in range(MOST_PIECES + lost):
        sending.offer(segment(number))
    came = carry(sending, receiving, Random(1), loss=0.0, until_s=5.0)
    assert [one.time_ns for one in came] == list(range(lost, MOST_PIECES + lost))
    assert (sending.dropped, receiving.dropped) == (lost, lost)


def test_what_is_lost_if_no_more_is_sent_is_known_to_the_element() -> None:
    sending, receiving = Sending(), Receiving()
    for number in range(MOST_PIECES + 10):
        sending.offer(segment(number))
    assert sending.lost == MOST_PIECES + 10
    carry(sending, receiving, Random(1), loss=0.0, until_s=5.0)
    assert (sending.dropped, sending.lost) == (10, 0)
    for number in range(MOST_PIECES + 5):
        sending.offer(segment(number))
    assert (sending.dropped, sending.lost) == (15, MOST_PIECES + 5)


def test_ends_marks_and_pauses_are_neither_dropped_nor_counted_as_lost() -> None:
    sending, receiving = Sending(), Receiving()
    sending.offer(MARK)
    for number in range(MOST_PIECES + 5):
        sending.offer(segment(number))
    sending.offer(PAUSE_SEGMENT)
    sending.offer(LAST_SEGMENT)
    assert sending.lost == MOST_PIECES + 5
    came = carry(sending, receiving, Random(1), loss=0.0, until_s=5.0)
    assert came[0].is_mark and came[-2].is_pause and came[-1].is_last
    assert len(came) == MOST_PIECES + 5 - sending.dropped + 3
    assert (receiving.dropped, sending.lost) == (sending.dropped, 0)


def test_the_end_of_a_stream_that_was_lost_in_a_cut_comes_at_once_when_the_link_is_there_again() -> None:
    sending, receiving = Sending(granted=FRAMES_UNDER_WAY), Receiving()
    for number in range(200):
        sending.offer(segment(number))
    sending.due(0.0)  # lost
    came = carry(sending, receiving, Random(1), loss=0.0, until_s=2.0)
    assert [one.time_ns for one in came] == list(range(200))


def test_a_blocking_crossing_drops_nothing_and_is_full_at_its_queue() -> None:
    sending = Sending(blocks=True, most=5)
    for number in range(5):
        assert not sending.is_full
        sending.offer(segment(number))
    assert sending.is_full
    assert sending.dropped == 0


def test_no_more_is_under_way_than_the_receiver_has_room_for() -> None:
    sending, receiving = Sending(blocks=True), Receiving()
    for number in range(3 * FRAMES_UNDER_WAY):
        sending.offer(segment(number))
    first = receiving.credit(0.0)
    assert first is not None
    sending.hear(first, 0.0)
    frames = sending.due(0.0)
    assert len(frames) == FRAMES_UNDER_WAY
    for frame in frames:
        receiving.take(frame, 0.0)
    told = receiving.credit(0.0, has_room=False)
    assert told is not None
    sending.hear(told, 0.0)
    assert sending.due(0.0) == []
    room = receiving.credit(0.1)
    assert room is not None
    sending.hear(room, 0.1)
    assert len(sending.due(0.1)) == FRAMES_UNDER_WAY


def over_a_link(
    size: int,
    every_s: float,
    rate: float,
    delay_s: float,
    until_s: float,
    fast_until_s: float = 0.0,
    burst: int = 0,
    growth: int = 0,
) -> tuple[Sending, int, float]:
    """Elements over a link that carries `rate` bytes per second, at first a thousand times as much.

    After a pause it carries up to `burst` bytes at once. Each element has `growth` bytes more than the one before.
    Returns the sender, how many came, and how long at most a frame waited in the link in the second half of the time.
    """
    sending, receiving = Sending(granted=FRAMES_UNDER_WAY), Receiving()
    in_link: deque[tuple[float, Frame]] = deque()
    told: deque[tuple[float, Credit]] = deque()
    came, number, longest_s, free_s = 0, 0, 0.0, 0.0
    for tick in range(round(until_s * 1000)):
        now_s = tick / 1000
        while number * every_s <= now_s:
            sending.offer(segment(number, size + number * growth))
            number += 1
        while told and told[0][0] <= now_s:
            sending.hear(told.popleft()[1], now_s)
        for frame in sending.due(now_s):
            payload = b"" if frame.segment is None else frame.segment.payload
            begin_s = max(now_s - burst / rate, free_s)
            free_s = begin_s + (len(payload) + 100) / (rate if now_s >= fast_until_s else 1000 * rate)
            in_link.append((max(now_s, free_s) + delay_s, frame))
            if now_s > until_s / 2:
                longest_s = max(longest_s, free_s - now_s)
        while in_link and in_link[0][0] <= now_s:
            came += len(receiving.take(in_link.popleft()[1], now_s))
        credit = receiving.credit(now_s)
        if credit is not None:
            told.append((now_s + delay_s, credit))
    return sending, came, longest_s


@pytest.mark.parametrize(
    ("mbit", "delay_s"), [(5, 0.0), (5, 0.05), (20, 0.001), (20, 0.3), (50, 0.0), (50, 0.05), (1000, 0.001)]
)
def test_a_link_is_used_and_what_is_under_way_delays_others_little(mbit: int, delay_s: float) -> None:
    """Three times as much is offered as the link carries: elements that do not fit are dropped whole."""
    rate, size, until_s = mbit * 125_000, 500_000, 20.0 if mbit < 1000 else 2.0
    sending, came, longest_s = over_a_link(size, size / (3 * rate), rate, delay_s, until_s)
    limit = BYTES_UNDER_WAY / max(1e-9, 2 * delay_s)  # where the most that may be under way is the limit
    assert came * size >= 0.75 * min(rate, limit) * until_s
    assert longest_s <= 0.2
    assert sending.dropped > 0


def test_bursts_that_were_under_way_at_once_teach_the_rate_of_a_link_that_has_become_slow() -> None:
    _, came, longest_s = over_a_link(500_000, 1.7, 5 * 125_000, 0.001, 30.0, fast_until_s=5.0)
    assert came >= 16
    assert longest_s <= 0.2


@pytest.mark.parametrize("mbit", [5, 10, 20])
def test_bytes_that_a_link_passes_at_once_after_a_pause_are_not_taken_for_its_rate(mbit: int) -> None:
    rate = mbit * 125_000
    sending, came, longest_s = over_a_link(500_000, 1_000_000 / rate, rate, 0.001, 30.0, burst=32_000)
    assert (sending.dropped, came) == (0, pytest.approx(30 * rate / 1_000_000, abs=2))
    assert longest_s <= 0.08


def test_a_small_rest_of_an_element_lets_no_more_of_the_next_one_into_the_link() -> None:
    """A frame has about 50 kB, so that some elements of the second half leave a rest that counts as small."""
    _, _, longest_s = over_a_link(400_000, 0.5, 2_500_000, 0.001, 40.0, growth=1_500)
    assert longest_s <= 0.08


@pytest.mark.parametrize("seed", range(2))
def test_a_link_that_stands_still_for_a_second_at_a_time_carries_small_elements_at_200_hz(seed: int) -> None:
    """In order, as TCP delivers on a radio that loses packets: 0.1 s each way, and half of the time nothing moves."""
    randoms, sending, receiving = Random(seed), Sending(granted=FRAMES_UNDER_WAY), Receiving()
    there: deque[tuple[float, Frame]] = deque()
    back: deque[tuple[float, Credit]] = deque()
    there_s = back_s = 0.0
    came = 0
    for tick in range(60_000):
        now_s = tick / 1000
        there_s, back_s = (
            max(at_s, now_s) + (randoms.uniform(0.3, 1.2) if randoms.random() < 0.001 else 0.0)
            for at_s in (there_s, back_s)
        )
        if tick % 5 == 0:
            sending.offer(segment(tick // 5, 8))
        while back and back[0][0] <= now_s:
            sending.hear(back.popleft()[1], now_s)
        there += [(there_s + 0.1, frame) for frame in sending.due(now_s)]
        while there and there[0][0] <= now_s:
            came += len(receiving.take(there.popleft()[1], now_s))
        credit = receiving.credit(now_s)
        if credit is not None:
            back.append((back_s + 0.1, credit))
    assert sending.dropped == 0
    assert came > 10_500


@pytest.mark.parametrize(("size", "every_s", "mbit"), [(2_000_000, 0.5, 50), (500_000, 1.0, 5), (10_000_000, 2.0, 50)])
def test_what_fits_a_slow_link_arrives(size: int, every_s: float, mbit: int) -> None:
    sending, came, _ = over_a_link(size, every_s, mbit * 125_000, 0.001, 30.0)
    assert (sending.dropped, came) == (0, pytest.approx(30 / every_s, abs=2))


STREAMS = [
    (size, hz, delay_s)
    for size in (8, 1000, 2048, 2100, 4096, 10_000, 100_000)
    for hz in (20, 200, 1000)
    for delay_s in (0.0, 0.05)
    if size * hz * 2 * (delay_s + 0.05) <= BYTES_UNDER_WAY
]
"""Streams of which no more is offered than may be under way."""


@pytest.mark.parametrize(("size", "hz", "delay_s"), STREAMS)
def test_a_link_with_room_delays_no_stream(size: int, hz: int, delay_s: float) -> None:
    sending, came, _ = over_a_link(size, 1 / hz, 125_000_000, delay_s, 5.0)
    assert sending.dropped == 0
    assert came >= (5.0 - delay_s - 0.1) * hz - 1


def test_a_large_piece_goes_in_frames_and_comes_whole() -> None:
    sending, receiving = Sending(granted=FRAMES_UNDER_WAY), Receiving()
    sending.offer(segment(3, 200_000))
    sending.offer(MARK)
    frames = sending.due(0.0)
    assert {len(frame.segment.payload) for frame in frames if frame.segment is not None} == {_FIRST_FRAME}
    came: list[Segment] = []
    for step in range(1, 20):
        for frame in frames:
            came += receiving.take(frame, step * 0.06)
        credit = receiving.credit(step * 0.06)
        if credit is not None:
            sending.hear(credit, step * 0.06)
        frames = sending.due(step * 0.06)
    assert came == [segment(3, 200_000), MARK]
    assert (sending.depth, sending.lost) == (0, 0)


def test_an_element_that_was_begun_is_not_dropped() -> None:
    sending, receiving = Sending(), Receiving()
    room = receiving.credit(0.0)
    assert room is not None
    sending.hear(room, 0.0)
    sending.offer(segment(0, 30_000_000))
    frames = sending.due(0.0)
    for number in range(1, 4):
        sending.offer(segment(number, 20_000_000))
    assert (sending.dropped, sending.lost) == (2, 4)
    came: list[Segment] = []
    for step in range(1, 100_000):
        for frame in frames:
            came += receiving.take(frame, step * 0.01)
        credit = receiving.credit(step * 0.01)
        if credit is not None:
            sending.hear(credit, step * 0.01)
        frames = sending.due(step * 0.01)
        if not sending.depth:
            break
    assert [one.time_ns for one in came] == [0, 3]


def test_what_is_newly_missing_is_asked_for_at_once_and_again_after_a_while() -> None:
    receiving = Receiving()

    def asked(number: int, at_s: float) -> tuple[int, ...]:
        receiving.take(Frame(number, 0, segment(number)), at_s)
        told = receiving.credit(at_s)
        return () if told is None else told.missing

    assert asked(1, 10.0) == (0,)
    assert asked(3, 10.01) == (2,)
    assert asked(4, 10.02) == ()
    assert asked(5, 10.11) == (0, 2)


def test_a_sender_without_any_credit_asks_for_one() -> None:
    sending = Sending()
    sending.offer(segment(0))
    assert sending.due(0.0) == []
    due_s = sending.due_s
    assert due_s is not None
    assert due_s <= 0.01, "a stream does not wait long for a credit that was told before its sender was there"
    (asked,) = sending.due(due_s)
    assert asked.segment is None
    receiving = Receiving()
    first = receiving.credit(0.0)
    assert receiving.credit(0.0) is None, "told once"
    receiving.take(asked, due_s)
    assert receiving.credit(due_s) == first, "told again, as it was lost"


def test_frames_and_told_credits_are_read_as_they_were_written() -> None:
    part = Frame(4, 1, segment(2), has_more=True)
    segments = (segment(5), LAST_SEGMENT, MARK, PAUSE_SEGMENT, None)
    for frame in (*(Frame(number, 3, one) for number, one in enumerate(segments)), part):
        assert read_frame(frame.head(), b"" if frame.segment is None else bytes(frame.segment.payload)) == frame
    for credit in (Credit(5, 261), Credit(5, 261, (6, 9))):
        assert read_credit(credit.packed()) == credit


@pytest.mark.parametrize("garbage", [b"", b"x", bytes(100), bytes(17)])
def test_garbage_is_neither_frame_nor_credit(garbage: bytes) -> None:
    assert read_frame(garbage, b"") is None
    assert read_credit(garbage) is None


def test_what_is_dropped_for_want_of_room_in_the_link_is_told_from_what_the_receiver_had_no_room_for() -> None:
    crowded, shut = Sending(granted=FRAMES_UNDER_WAY), Sending(granted=0)
    for sending in (crowded, shut):
        for turn in range(40):
            sending.offer(segment(turn, size=1_000_000))
            sending.due(0.0)
        assert sending.dropped > 0
        assert sending.offered_bytes == 40_000_000
        assert sending.arrived_bytes == 0
    assert (crowded.crowded, shut.crowded) == (crowded.dropped, 0)
    crowded.hear(Credit(2, FRAMES_UNDER_WAY), 0.1)
    assert 0 < crowded.arrived_bytes < crowded.offered_bytes


def test_a_missing_frame_is_not_sent_again_at_every_request_but_ever_more_rarely() -> None:
    sending = Sending(granted=FRAMES_UNDER_WAY)
    for number in range(3):
        sending.offer(segment(number))
    sending.due(0.0)
    sending.hear(Credit(1, FRAMES_UNDER_WAY), 1.0)  # the link's usual delay is a second
    sent = list[int]()
    for tick in range(400):
        now_s = 1.1 + 0.1 * tick
        sending.hear(Credit(1, FRAMES_UNDER_WAY, (1,)), now_s)
        sent += [frame.number for frame in sending.due(now_s)]
    assert 5 <= sent.count(1) <= 60, "some after ever longer waits, the others since no answer comes"
