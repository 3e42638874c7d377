"""Crossings over links that lose, repeat and reorder what they carry."""

from __future__ import annotations

from random import Random

import pytest
from cfgplan_runtime.streams.crossing import (
    BYTES_UNDER_WAY,
    LAST_PIECE,
    MOST_PIECES,
    PIECES_UNDER_WAY,
    Credit,
    Frame,
    Piece,
    Receiving,
    Sending,
    read_credit,
    read_frame,
)
from hypothesis import given, settings
from hypothesis import strategies as st

MARK = Piece(0, 0, b"work.1", is_mark=True)


def piece(number: int, size: int = 8) -> Piece:
    return Piece(number, 0, number.to_bytes(8, "little") + bytes(size - 8))


def carry(sending: Sending, receiving: Receiving, random: Random, *, loss: float, until_s: float) -> list[Piece]:
    """Let time pass over a link that loses, repeats and reorders; returns what was handed on."""
    came: list[Piece] = []
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
            sending.hear(told_credits.pop())
        now_s += 0.01
    return came


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32), st.integers(0, 600), st.sampled_from((0.0, 0.1, 0.5)), st.sampled_from((8, 100_000)))
def test_every_piece_comes_once_and_in_order(seed: int, count: int, loss: float, size: int) -> None:
    sending, receiving = Sending(), Receiving()
    count = min(count, 20_000_000 // size)
    for number in range(count):
        sending.offer(piece(number, size))
    sending.offer(LAST_PIECE)
    came = carry(sending, receiving, Random(seed), loss=loss, until_s=300.0 if loss else 30.0)
    assert [one.time_ns for one in came[:-1]] == list(range(count))
    assert came[-1].is_last
    assert (sending.dropped, receiving.dropped, sending.depth) == (0, 0, 0)


def test_what_has_no_room_during_a_cut_is_dropped_oldest_first_and_told() -> None:
    sending, receiving = Sending(), Receiving()
    lost = 10
    for number in range(MOST_PIECES + lost):
        sending.offer(piece(number))
    came = carry(sending, receiving, Random(1), loss=0.0, until_s=5.0)
    assert [one.time_ns for one in came] == list(range(lost, MOST_PIECES + lost))
    assert (sending.dropped, receiving.dropped) == (lost, lost)


def test_what_is_lost_if_no_more_is_sent_is_known_to_the_element() -> None:
    sending, receiving = Sending(), Receiving()
    for number in range(MOST_PIECES + 10):
        sending.offer(piece(number))
    assert sending.lost == MOST_PIECES + 10
    carry(sending, receiving, Random(1), loss=0.0, until_s=5.0)
    assert (sending.dropped, sending.lost) == (10, 0)
    for number in range(MOST_PIECES + 5):
        sending.offer(piece(number))
    assert (sending.dropped, sending.lost) == (15, MOST_PIECES + 5)


def test_ends_and_marks_are_neither_dropped_nor_counted_as_lost() -> None:
    sending, receiving = Sending(), Receiving()
    sending.offer(MARK)
    for number in range(MOST_PIECES + 5):
        sending.offer(piece(number))
    sending.offer(LAST_PIECE)
    assert sending.lost == MOST_PIECES + 5
    came = carry(sending, receiving, Random(1), loss=0.0, until_s=5.0)
    assert came[0].is_mark and came[-1].is_last
    assert len(came) == MOST_PIECES + 5 - sending.dropped + 2
    assert (receiving.dropped, sending.lost) == (sending.dropped, 0)


def test_the_end_of_a_stream_that_was_lost_in_a_cut_comes_at_once_when_the_link_is_there_again() -> None:
    sending, receiving = Sending(granted=PIECES_UNDER_WAY), Receiving()
    for number in range(200):
        sending.offer(piece(number))
    sending.due(0.0)  # lost
    came = carry(sending, receiving, Random(1), loss=0.0, until_s=2.0)
    assert [one.time_ns for one in came] == list(range(200))


def test_a_blocking_crossing_drops_nothing_and_is_full_at_its_queue() -> None:
    sending = Sending(blocks=True, most=5)
    for number in range(5):
        assert not sending.is_full
        sending.offer(piece(number))
    assert sending.is_full
    assert sending.dropped == 0


def test_no_more_is_under_way_than_the_receiver_has_room_for() -> None:
    sending, receiving = Sending(blocks=True, most=1000), Receiving()
    for number in range(1000):
        sending.offer(piece(number))
    first = receiving.credit(0.0)
    assert first is not None
    sending.hear(first)
    frames = sending.due(0.0)
    assert len(frames) == PIECES_UNDER_WAY
    for frame in frames:
        receiving.take(frame, 0.0)
    told = receiving.credit(0.0, has_room=False)
    assert told is not None
    sending.hear(told)
    assert sending.due(0.0) == []
    room = receiving.credit(0.1)
    assert room is not None
    sending.hear(room)
    assert len(sending.due(0.1)) == PIECES_UNDER_WAY


def test_large_pieces_do_not_fill_a_slow_link() -> None:
    sending = Sending(granted=PIECES_UNDER_WAY)
    for number in range(20):
        sending.offer(piece(number, BYTES_UNDER_WAY // 2))
    assert len(sending.due(0.0)) == 2


def test_what_is_newly_missing_is_asked_for_at_once_and_again_after_a_while() -> None:
    receiving = Receiving()

    def asked(number: int, at_s: float) -> tuple[int, ...]:
        receiving.take(Frame(number, 0, piece(number)), at_s)
        told = receiving.credit(at_s)
        return () if told is None else told.missing

    assert asked(1, 10.0) == (0,)
    assert asked(3, 10.01) == (2,)
    assert asked(4, 10.02) == ()
    assert asked(5, 10.11) == (0, 2)


def test_a_sender_without_any_credit_asks_for_one() -> None:
    sending = Sending()
    sending.offer(piece(0))
    assert sending.due(0.0) == []
    due_s = sending.due_s
    assert due_s is not None
    assert due_s <= 0.01, "a stream does not wait long for a credit that was told before its sender was there"
    (asked,) = sending.due(due_s)
    assert asked.piece is None
    receiving = Receiving()
    first = receiving.credit(0.0)
    assert receiving.credit(0.0) is None, "told once"
    receiving.take(asked, due_s)
    assert receiving.credit(due_s) == first, "told again, as it was lost"


def test_frames_and_told_credits_are_read_as_they_were_written() -> None:
    for frame in (Frame(7, 3, piece(5)), Frame(8, 3, LAST_PIECE), Frame(9, 3, MARK), Frame(9, 0, None)):
        assert read_frame(frame.head(), b"" if frame.piece is None else bytes(frame.piece.payload)) == frame
    for credit in (Credit(5, 261), Credit(5, 261, (6, 9))):
        assert read_credit(credit.packed()) == credit


@pytest.mark.parametrize("garbage", [b"", b"x", bytes(100), bytes(17)])
def test_garbage_is_neither_frame_nor_credit(garbage: bytes) -> None:
    assert read_frame(garbage, b"") is None
    assert read_credit(garbage) is None
