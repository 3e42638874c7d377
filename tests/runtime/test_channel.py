"""Channels: both ends of a subscription in one process."""

from __future__ import annotations

import numpy
from cfgplan_runtime.streams.channel import Buffers, Receiver, Sender, socket_pair
from cfgplan_runtime.streams.element import Outgoing
from cfgplan_runtime.streams.payload import PayloadEncoder, decode

LARGE = 300_000


def test_a_buffer_is_used_again_when_nobody_looks_at_it() -> None:
    buffers = Buffers()
    first = buffers.take(LARGE)
    first[:3] = b"abc"
    first.release()
    assert bytes(buffers.take(LARGE)[:3]) == b"abc"


def test_a_buffer_that_somebody_looks_at_is_left_alone() -> None:
    buffers = Buffers()
    views = [buffers.take(LARGE) for _ in range(100)]
    for number, view in enumerate(views):
        view[:] = bytes([number]) * LARGE
    assert [view[-1] for view in views] == list(range(100))


def test_buffers_follow_a_change_of_size() -> None:
    buffers = Buffers()
    assert [len(buffers.take(length)) for length in (LARGE, LARGE, 10, LARGE, 10, 10)] == [
        *(LARGE, LARGE, 10, LARGE, 10, 10)
    ]


def test_elements_of_any_size_arrive_as_they_were_sent() -> None:
    sending, receiving = socket_pair()
    sender, receiver = Sender(sending, queue=1000, blocks=True), Receiver(receiving)
    sent = [
        bytes([size % 251]) * size for size in (1, 5000, 3, *range(4000, 4200, 7), 70_000, 10, LARGE, 8192, 65_536, 2)
    ]
    came = []
    for number, payload in enumerate(sent):
        sender.offer(Outgoing(number, 0, [payload]))
        came += [bytes(element.payload) for element in receiver.read()]
    while not sender.flush():
        came += [bytes(element.payload) for element in receiver.read()]
    sending.close()
    while not receiver.has_ended:
        came += [bytes(element.payload) for element in receiver.read()]
    assert came == sent


def test_a_pause_comes_after_the_elements_that_wait_and_lasts_until_the_next_element() -> None:
    sending, receiving = socket_pair()
    sender, receiver = Sender(sending, queue=1000, blocks=False), Receiver(receiving)
    for number in range(20):
        sender.offer(Outgoing(number, 0, [bytes(LARGE)]))
    assert sender.depth > 0
    sender.pause()
    came = list[int]()
    while len(came) < 20:
        assert not receiver.is_paused
        sender.flush()
        came += [element.time_ns for element in receiver.read()]
    sender.flush()
    assert (list(receiver.read()), receiver.is_paused) == ([], True)
    sender.offer(Outgoing(20, 0, [b""]))
    assert ([element.number for element in receiver.read()], receiver.is_paused) == ([20], False)
    for end in (sending, receiving):
        end.close()


def test_an_element_that_is_given_before_a_pause_was_told_ends_it() -> None:
    sending, receiving = socket_pair()
    sender, receiver = Sender(sending, queue=1000, blocks=False), Receiver(receiving)
    for number in range(20):
        sender.offer(Outgoing(number, 0, [bytes(LARGE)]))
    sender.pause()
    sender.offer(Outgoing(20, 0, [b""]))
    came = list[int]()
    while len(came) < 21:
        sender.flush()
        came += [element.time_ns for element in receiver.read()]
        assert not receiver.is_paused
    for end in (sending, receiving):
        end.close()


def test_a_received_array_stays_as_it_is_however_much_comes_after_it() -> None:
    encoder = PayloadEncoder()
    sending, receiving = socket_pair()
    sender, receiver = Sender(sending, queue=8, blocks=True), Receiver(receiving)
    kept = []
    for number in range(100):
        value = [number, numpy.full(LARGE if number % 3 else 50, number, numpy.uint8)]
        sender.offer(Outgoing(number, 0, encoder.encode(value)))
        while not sender.flush():
            kept += [decode(element.payload) for element in receiver.read()]
    sending.close()
    while not receiver.has_ended:
        kept += [decode(element.payload) for element in receiver.read()]
    assert [number for number, _ in kept] == list(range(100))
    assert all((array == number).all() for number, array in kept)
