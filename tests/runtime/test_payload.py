"""Values as bytes and back; channels between two sockets. No process."""

from __future__ import annotations

import math
import tracemalloc
from contextlib import suppress
from typing import Any

import numpy
import pytest
from cfgplan_runtime.errors import EncodingError
from cfgplan_runtime.streams.channel import Receiver, Sender, socket_pair
from cfgplan_runtime.streams.element import Element, Outgoing
from cfgplan_runtime.streams.payload import PayloadEncoder, decode
from hypothesis import given
from hypothesis import strategies as st

MASKED = numpy.ma.masked_array([1.0, 2.0], [False, True])
VALUES = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**63), 2**64 - 1)
    | st.floats(allow_nan=False)
    | st.text(st.characters(exclude_categories=["Cs"]))
    | st.binary(),
    lambda below: st.lists(below, max_size=4) | st.dictionaries(st.text("ab é"), below, max_size=4),
    max_leaves=12,
)


def there_and_back(value: object) -> Any:
    return decode(b"".join(PayloadEncoder().encode(value)))


@given(VALUES)
def test_a_value_comes_back_as_it_was(value: object) -> None:
    assert there_and_back(value) == value


@pytest.mark.parametrize("dtype", ["u1", "<i8", ">f4", "f8", "c16", "?", "M8[ns]", "U3"])
@pytest.mark.parametrize("shape", [(), (0,), (3,), (2, 0, 3), (5, 7)])
def test_an_array_comes_back_as_it_was(dtype: str, shape: tuple[int, ...]) -> None:
    array = numpy.arange(math.prod(shape)).astype("i8").reshape(shape).astype(dtype)
    back = there_and_back({"image": array, "more": [array, 1]})
    for found in (back["image"], back["more"][0]):
        assert found.dtype == array.dtype
        assert found.shape == array.shape
        assert (found == array).all()


def test_an_array_that_is_no_block_of_memory_comes_back_as_it_was() -> None:
    array = numpy.arange(24).reshape(4, 6)[::2, ::-1]
    assert (there_and_back(array) == array).all()


def test_a_received_array_may_be_changed() -> None:
    back = there_and_back(numpy.zeros(3))
    back += 1
    assert back.tolist() == [1, 1, 1]


def test_numpy_numbers_arrive_as_plain_ones() -> None:
    assert there_and_back([numpy.float64(1.5), numpy.int32(3), numpy.bool_(True)]) == [1.5, 3, True]


@pytest.mark.parametrize("value", [object(), 2**70, {1j: 2}, numpy.array([object()]), lambda: 0, MASKED, [MASKED]])
def test_what_can_not_travel_is_refused(value: object) -> None:
    with pytest.raises(EncodingError):
        PayloadEncoder().encode(value)


@given(st.binary(max_size=200))
def test_garbage_is_refused_or_read_but_never_breaks(data: bytes) -> None:
    with suppress(EncodingError):
        decode(data)


def element(time_ns: int, size: int) -> Outgoing:
    return Outgoing(time_ns, 0, [bytes([time_ns % 256]) * size])


def until_the_end(sender: Sender, receiver: Receiver) -> list[Element]:
    """The elements that still arrive after everything is sent and the channel is closed."""
    got: list[Element] = []
    while not sender.flush():
        got += receiver.read()
    sender.socket.close()
    while not receiver.has_ended:
        got += receiver.read()
    receiver.close()
    return got


@given(st.lists(st.integers(0, 200_000), max_size=8))
def test_a_channel_gives_what_was_put_in(sizes: list[int]) -> None:
    ends = socket_pair()
    sender, receiver = Sender(ends[0], queue=100, blocks=False), Receiver(ends[1])
    got: list[Element] = []
    for number, size in enumerate(sizes):
        sender.offer(element(number, size))
        got += receiver.read()
    got += until_the_end(sender, receiver)
    assert [(one.time_ns, one.number, bytes(one.payload)) for one in got] == [
        (number, number, bytes([number]) * size) for number, size in enumerate(sizes)
    ]


@pytest.mark.parametrize("garbage", [b"garbage " * 100, b"\xff" * 100, bytes(100)])
def test_bytes_that_are_no_element_end_a_channel_and_take_no_memory(garbage: bytes) -> None:
    ends = socket_pair()
    sender, receiver = Sender(ends[0], queue=3, blocks=False), Receiver(ends[1])
    sender.offer(Outgoing(1, 0, [b"whole"]))
    sender.socket.sendall(garbage)
    tracemalloc.start()
    assert [bytes(element.payload) for element in receiver.read()] == [b"whole"]
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert receiver.has_ended
    assert peak < 1 << 20
    for end in ends:
        end.close()


def test_a_full_channel_drops_the_oldest_and_the_numbers_tell() -> None:
    ends = socket_pair()
    sender, receiver = Sender(ends[0], queue=3, blocks=False), Receiver(ends[1])
    for number in range(40):
        sender.offer(element(number, 400_000))
    assert sender.depth <= 4
    got = until_the_end(sender, receiver)
    numbers = [one.number for one in got]
    assert numbers == sorted(numbers)
    assert numbers[-3:] == [37, 38, 39]
    assert sender.dropped == 40 - len(numbers) > 0


def test_a_channel_that_blocks_keeps_all_and_says_that_it_is_full() -> None:
    ends = socket_pair()
    sender, receiver = Sender(ends[0], queue=3, blocks=True), Receiver(ends[1])
    number = 0
    while not sender.is_full:
        sender.offer(element(number, 400_000))
        number += 1
    got = until_the_end(sender, receiver)
    assert [one.number for one in got] == list(range(number))


def test_an_array_that_changes_after_it_was_given_arrives_as_it_was() -> None:
    ends = socket_pair()
    sender, receiver = Sender(ends[0], queue=10, blocks=False), Receiver(ends[1])
    image = numpy.zeros(300_000, numpy.uint8)
    for number in range(8):
        image[:] = number
        sender.offer(Outgoing(number, 0, PayloadEncoder().encode(image)))
    got = until_the_end(sender, receiver)
    assert [set(decode(one.payload).tolist()) for one in got] == [{number} for number in range(8)]
