"""Crossings: streams from one computer to another, in order and without repeats, over links that may lose or repeat
frames.

The sender cuts segments into numbered frames, and keeps each frame until the receiver has acknowledged it. The number
of unacknowledged frames is limited, also by the receiver's room. Segments that wait meanwhile are bounded, too: beyond
the bound they are dropped, or the producer waits. So a cut, a full link and a slow receiver have the same effect, and
each crossing is independent of the others. The bytes in flight follow the measured rate of the link, since data that
waits in a slow link delays all other streams of the link.
"""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from math import inf
from typing import NamedTuple, TypeAlias
from urllib.parse import quote

from cfgplan_runtime.streams.channel import MOST_WAITING_BYTES
from cfgplan_runtime.streams.element import Buffer

KEYS = "cfgplan"
"""The prefix of all keys of a fleet."""
FRAMES_UNDER_WAY = 1024
"""The most frames in flight: 5 s at 200 Hz. With 256, a link that loses packets and stands still for a second at a time
carried half as many small elements.
"""
BYTES_UNDER_WAY, _FIRST_BYTES_UNDER_WAY = 1 << 20, 1 << 17
"""The most bytes in flight, and the number before a rate is known. Two frames are always allowed, and one while the
delay of an empty link is measured.
"""
_AHEAD_S, _AHEAD_SMALL_S = 0.02, 0.08
"""Seconds of the link's rate that may be in flight beyond its delay; more for small frames, which are acknowledged
later.
"""
SMALL_FRAME = 2048
"""Frames of more bytes are acknowledged sooner."""
LARGEST_FRAME, _LEAST_FRAME, _FIRST_FRAME = 60_000, 4096, 16_384
"""The size of a frame in bytes: the most, which fit into one of Zenoh's batches; the least; and before a
rate is known.
"""
_FRAME_S = 0.02
"""The most seconds that a link needs for a frame larger than the least: no other frame overtakes one that is being
sent.
"""
_LEAST_S = 0.1
"""The least seconds over which a rate is measured on a link that was not full."""
_BURST_BYTES = 1 << 16
"""The bytes after a pause that say nothing of a link's rate: shapers and radios pass the first ones at once."""
_RATE_S, _DELAY_S = 3.0, 10.0
"""The seconds for which a highest rate and a least delay count. Then the delay of an empty link is measured again."""
_STARTUP_GAIN, _GROWTH, _ROUNDS_ALIKE = 2, 1.25, 3
"""At first the window is larger by the first factor, until the rate has not grown by the second one in the given number
of rounds.
"""
_WAITING_S, _LEAST_WAITING = 2.0, 1 << 22
"""The seconds (a lease) of a full link's rate that may wait for it, and the least number of bytes."""
MOST_PIECES = 4096
"""The most segments that wait to be sent: two seconds (a lease) at 2,000 Hz."""
_TOLD_EVERY, _TOLD_EVERY_BYTES = FRAMES_UNDER_WAY // 32, BYTES_UNDER_WAY // 8
_LATEST_CREDIT_S, _SOON_CREDIT_S = 0.05, 0.01
"""The most seconds until a frame is acknowledged, and those for a large frame."""
_RESEND_S, _MOST_RESEND_S = 0.25, 0.5
"""Seconds without an acknowledgement before a frame is sent again, doubled each time up to the second value, or up to
some of the usual delays.
"""
_FIRST_ASK_S = 0.01
"""Seconds until a sender asks for its first credit, doubled each time: credits sent before it started are lost."""
_ASK_AGAIN_S = 0.1
_MOST_USUAL_S = 0.5
"""Longer delays count as this one: an acknowledgement also waits for earlier frames that were lost."""
_USUAL_SHARE, _USUAL_DELAYS, _MOST_DOUBLED = 0.125, 2, 2
"""The share of a new delay in the usual one; the usual delays after which a frame may be sent once more, and how often
this time doubles. On a slow link a receiver asks for a missing frame several times before it can come.
"""
_MOST_MISSING = 64

Put: TypeAlias = Callable[[bytes, bytes], None]
"""Puts a head and a payload into the network."""

_HEAD = struct.Struct("<QQqIB")
_CREDIT = struct.Struct("<QQ")
_MISSING_NUMBER = struct.Struct("<Q")


class Segment(NamedTuple):
    """An element on its way between hosts; with `is_last`, the end of its stream, which has no payload.

    With `is_mark` it reports to the run named in it that all earlier segments have arrived; with `is_pause`, that the
    stream pauses until its next element.
    """

    time_ns: int
    turn: int
    payload: Buffer
    is_last: bool = False
    is_mark: bool = False
    is_pause: bool = False

    @property
    def is_element(self) -> bool:
        return not (self.is_last or self.is_mark or self.is_pause)

    @property
    def kind(self) -> int:
        """The kind of the frame that has the end of this segment."""
        if self.is_element:
            return _ELEMENT
        return _LAST if self.is_last else _MARKER if self.is_mark else _PAUSE


LAST_SEGMENT, PAUSE_SEGMENT = Segment(0, 0, b"", is_last=True), Segment(0, 0, b"", is_pause=True)
_ELEMENT, _LAST, _QUESTION, _MARKER, _PART, _PAUSE = range(6)
"""Kinds of frames."""


class Frame(NamedTuple):
    """A segment with its number; `dropped` counts all earlier segments that had no room. Without a segment, the frame
    asks for a credit.

    With `has_more` it is a part of an element that continues in the next frame.
    """

    number: int
    dropped: int
    segment: Segment | None
    has_more: bool = False

    def head(self) -> bytes:
        """The frame without its payload, as bytes."""
        segment = self.segment
        if segment is None:
            return _HEAD.pack(self.number, self.dropped, 0, 0, _QUESTION)
        kind = _PART if self.has_more else segment.kind
        return _HEAD.pack(self.number, self.dropped, segment.time_ns, segment.turn, kind)


def read_frame(head: bytes, payload: bytes) -> Frame | None:
    """The frame of a head and a payload; None if the bytes are no frame."""
    if len(head) != _HEAD.size:
        return None
    number, dropped, time_ns, turn, kind = _HEAD.unpack(head)
    segment = Segment(time_ns, turn, payload, kind == _LAST, kind == _MARKER, kind == _PAUSE)
    return Frame(number, dropped, None if kind == _QUESTION else segment, kind == _PART)


@dataclass(frozen=True, slots=True)
class Credit:
    """A receiver's acknowledgement: all frames before `expected` have come, numbers below `limit` have room, and some
    are `missing`.
    """

    expected: int
    limit: int
    missing: tuple[int, ...] = ()

    def packed(self) -> bytes:
        return _CREDIT.pack(self.expected, self.limit) + b"".join(map(_MISSING_NUMBER.pack, self.missing))


def read_credit(data: bytes) -> Credit | None:
    """The credit of received bytes; None if they are no credit."""
    if len(data) < _CREDIT.size or (len(data) - _CREDIT.size) % _MISSING_NUMBER.size:
        return None
    expected, limit = _CREDIT.unpack_from(data)
    return Credit(expected, limit, tuple(number for (number,) in _MISSING_NUMBER.iter_unpack(data[_CREDIT.size :])))


def host_key(host: str | None) -> str:
    """The prefix of the keys under which a host writes; None means any host."""
    return f"{KEYS}/{_named(host)}"


def crossing_key(sender: str | None, kind: str, receiver: str, crossing: str) -> str:
    """The key of messages from `sender` to `receiver`; None means any host, and the crossing "*" any crossing."""
    return f"{host_key(sender)}/{kind}/{_named(receiver)}/{crossing}"


def _named(host: str | None) -> str:
    return "*" if host is None else quote(host, safe="")


class Pace:
    """Measures the arrival of frames, and sets how many should be in flight; times in seconds, rates in bytes per
    second.

    Reference: delivery rate, startup and probing of the delay as in BBR (Cardwell et al., ACM Queue 2016).
    """

    def __init__(self) -> None:
        self._sent: dict[int, tuple[float, int, bool]] = {}
        """By frame: the time of its sending, the bytes that had arrived by then, and whether more waited."""
        self._paused, self._has_more = 0, False
        """The bytes that had arrived when no frame was in flight or waited last, and whether frames waited then."""
        self._last = self._round_ends = 0
        """The last frame that was sent, and the one whose arrival ends a round."""
        self._arrived = 0
        self._rates: deque[tuple[float, float]] = deque()
        self._delay = inf, 0.0
        """The least delay, and the time of its measurement."""
        self._probes_from: int | None = None
        """While the delay is being measured again: the first frame that finds an empty link."""
        self.usual_s = 0.0
        """The smoothed time from sending a frame to its acknowledgement, in seconds."""
        self._grown_rate, self._rounds_alike = 0.0, 0
        self._has_been_full = False
        self._ahead_s = _AHEAD_S

    @property
    def most_waiting(self) -> int:
        """The number of bytes that may wait; on a full link newer elements are worth more than older ones."""
        if not self._has_been_full or self.rate is None or self._rounds_alike < _ROUNDS_ALIKE:
            return MOST_WAITING_BYTES
        return min(MOST_WAITING_BYTES, max(_LEAST_WAITING, round(self.rate * _WAITING_S)))

    @property
    def rate(self) -> float | None:
        """The highest rate of the last seconds in which the link was full; None if unknown."""
        return max((rate for _, rate in self._rates), default=None)

    @property
    def delay_s(self) -> float:
        """The least time from sending a frame to its acknowledgement, in seconds."""
        return 0.0 if self._delay[0] == inf else self._delay[0]

    @property
    def window(self) -> int:
        """The number of bytes that should be in flight; 0 while the delay of an empty link is measured."""
        if self.rate is None:
            return _FIRST_BYTES_UNDER_WAY
        if self._probes_from is not None:
            return 0
        gain = 1 if self._rounds_alike >= _ROUNDS_ALIKE else _STARTUP_GAIN
        return min(BYTES_UNDER_WAY, max(_FIRST_FRAME, round(self.rate * (gain * self.delay_s + self._ahead_s))))

    @property
    def frame(self) -> int:
        """The largest size of a frame, in bytes."""
        if self.rate is None:
            return _FIRST_FRAME
        return max(_LEAST_FRAME, min(LARGEST_FRAME, round(self.rate * _FRAME_S)))

    def note_sent(self, number: int, now_s: float, *, is_small: bool, is_full: bool) -> None:
        """Record the first sending of a frame. With `is_full`, more frames waited for room in the window. A frame that
        `is_small` is acknowledged later.
        """
        self._ahead_s = _AHEAD_SMALL_S if is_small else _AHEAD_S
        if not (self._sent or self._has_more):
            self._paused = self._arrived
        self._has_more = is_full
        self._sent[number], self._last = (now_s, self._arrived, is_full), number
        if is_full and self._probes_from is None and now_s - self._delay[1] > _DELAY_S and self._delay[0] < inf:
            self._probes_from = number + 1

    def forget(self, number: int, now_s: float) -> None:
        """Record that a frame is sent again: its arrival then measures nothing, and the known delay counts on."""
        self._sent.pop(number, None)
        if self._probes_from is not None and number >= self._probes_from:
            self._delay, self._probes_from = (self._delay[0], now_s), None

    def note_arrived(self, number: int, size: int, now_s: float) -> None:
        """Record the acknowledgement of a frame."""
        self._arrived += size
        sent_s, before, is_full = self._sent.pop(number, (now_s, 0, False))
        if now_s <= sent_s:
            return
        delay_s, is_probe = now_s - sent_s, self._probes_from is not None and number >= self._probes_from
        usual_s = min(delay_s, _MOST_USUAL_S)
        self.usual_s += (_USUAL_SHARE if self.usual_s else 1) * (usual_s - self.usual_s)
        if delay_s <= self._delay[0] or is_probe:
            self._delay, self._probes_from = (delay_s, now_s), None if is_probe else self._probes_from
        beyond = self._arrived - max(before, self._paused + _BURST_BYTES)
        has_waited = delay_s > self.delay_s + 2 * _AHEAD_S
        is_full = (is_full or has_waited) and beyond > 0
        rate = beyond / max(delay_s, _AHEAD_S) if is_full else (self._arrived - before) / max(delay_s, _LEAST_S)
        self._has_been_full = self._has_been_full or is_full
        if (is_full and self._probes_from is None) or self.rate is None or rate > self.rate:
            self._rates.append((now_s, rate))
            while self._rates[0][0] < now_s - _RATE_S:
                self._rates.popleft()
        if number >= self._round_ends:
            self._round_ends = self._last + 1
            if is_full:
                self._end_round()

    def _end_round(self) -> None:
        """Count the rounds in which the rate did not grow any more."""
        rate = self.rate or 0.0
        if rate > _GROWTH * self._grown_rate:
            self._grown_rate, self._rounds_alike = rate, min(self._rounds_alike, 0)
        else:
            self._rounds_alike += 1


class Sending:
    """The sender's end. With `blocks`, `is_full` tells the producer to wait; otherwise the oldest segments are dropped.

    `granted` frames may be sent before the receiver's first credit.
    """

    def __init__(self, *, blocks: bool = False, most: int = MOST_PIECES, granted: int = 0) -> None:
        self.dropped = 0
        self.crowded = 0
        """The number of segments dropped for lack of room in the link; the other drops lacked room at the receiver."""
        self.offered_bytes = self.arrived_bytes = 0
        self._blocks = blocks
        self._most = most
        self._waiting: deque[Segment] = deque()
        self._waiting_bytes = 0
        self._begun = 0
        """The bytes of the first waiting segment that were sent."""
        self._is_within = False
        """Whether the last frame was a part of an element that is not over."""
        self._under_way: dict[int, Frame] = {}
        self._under_way_bytes = 0
        self._pace = Pace()
        self._next = 0
        self._dropped_before = 0
        """The number of drops before the last segment that arrived: the receiver knows of them."""
        self._limit = granted
        self._missing: set[int] = set()
        self._repeated: dict[int, tuple[float, int]] = {}
        """For each frame in flight that was sent again: until when a request for it is ignored, and how often it was
        sent again.
        """
        self._again_s: float | None = None
        """The time to send again without an acknowledgement; None if no frame waits for one."""
        self._patience_s = _RESEND_S if granted else _FIRST_ASK_S

    @property
    def depth(self) -> int:
        """The number of segments that have not arrived, as far as known."""
        return len(self._waiting) + sum(not frame.has_more for frame in self._under_way.values())

    @property
    def lost(self) -> int:
        """The number of elements lost if no more is sent: those that have not arrived, and drops after the last
        arrival.
        """
        last_ones = (frame.segment for frame in self._under_way.values() if not frame.has_more)
        segments = [*self._waiting, *(segment for segment in last_ones if segment is not None)]
        return sum(segment.is_element for segment in segments) + self.dropped - self._dropped_before

    @property
    def is_full(self) -> bool:
        return self._blocks and (len(self._waiting) >= self._most or self._waiting_bytes > MOST_WAITING_BYTES)

    def offer(self, segment: Segment) -> None:
        """Queue a segment. An element is sent whole or dropped whole."""
        self._waiting.append(segment)
        self._waiting_bytes += len(segment.payload)
        self.offered_bytes += len(segment.payload)
        while not self._blocks and len(self._waiting) > 1 and self._has_too_many:
            first = 1 if self._begun else 0
            elements = (number for number, one in enumerate(self._waiting) if number >= first and one.is_element)
            oldest, newer = next(elements, None), next(elements, None)
            if oldest is None or newer is None:
                return
            self._waiting_bytes -= len(self._waiting[oldest].payload)
            del self._waiting[oldest]
            self.dropped += 1
            self.crowded += self._next < self._limit

    def hear(self, credit: Credit, now_s: float) -> None:
        """Process a credit; credits may come out of order."""
        arrived = [number for number in self._under_way if number < credit.expected]
        for number in arrived:
            frame = self._under_way.pop(number)
            self._repeated.pop(number, None)
            self._under_way_bytes -= self._size(frame)
            self.arrived_bytes += self._size(frame)
            self._dropped_before = frame.dropped
            self._pace.note_arrived(number, self._size(frame), now_s)
        if arrived or credit.limit > self._limit:
            self._patience_s, self._again_s = max(_RESEND_S, 3 * self._pace.delay_s), None
        self._limit = max(self._limit, credit.limit)
        self._missing.update(credit.missing)

    def due(self, now_s: float) -> list[Frame]:
        """The frames to send now."""
        asked = [number for number in sorted(self._missing) if number in self._under_way]
        frames = [self._under_way[number] for number in asked if self._repeat(number, now_s)]
        self._missing.clear()
        first = self._next
        while self._waiting and self._next < self._limit and self._has_window:
            frame = self._under_way[self._next] = self._cut()
            self._under_way_bytes += self._size(frame)
            self._next += 1
        new = [self._under_way[number] for number in range(first, self._next)]
        for frame in new:
            is_small = self._size(frame) <= SMALL_FRAME and not (frame.has_more or self._is_within)
            self._is_within = frame.has_more
            self._pace.note_sent(frame.number, now_s, is_small=is_small, is_full=bool(self._waiting))
        is_open = bool(self._waiting or self._under_way)
        if is_open and self._again_s is not None and now_s >= self._again_s:
            # By the last one the receiver sees what else is missing.
            known = list(self._under_way.values())[: len(self._under_way) - len(new)]
            frames += known[:1] + known[1:][-1:] or [Frame(self._next, self.dropped, None)]
            most_s = max(_MOST_RESEND_S, _USUAL_DELAYS * self._pace.usual_s)
            self._patience_s, self._again_s = min(2 * self._patience_s, most_s), None
        for frame in frames:
            self._pace.forget(frame.number, now_s)
        if not is_open:
            self._again_s = None
        elif self._again_s is None:
            self._again_s = now_s + self._patience_s
        return frames + new

    @property
    def due_s(self) -> float | None:
        """The time of the next repetition, if no answer comes before."""
        return self._again_s

    def _repeat(self, number: int, now_s: float) -> bool:
        """Whether to send a missing frame again now; if so, note it. The time until the next repetition doubles."""
        until_s, times = self._repeated.get(number, (0.0, 0))
        if now_s < until_s:
            return False
        patience_s = max(_ASK_AGAIN_S, _USUAL_DELAYS * self._pace.usual_s) * 2 ** min(times, _MOST_DOUBLED)
        self._repeated[number] = now_s + patience_s, times + 1
        return True

    def _cut(self) -> Frame:
        """The next frame of the waiting segments: a segment, or a part of one that is larger than a frame."""
        segment = self._waiting[0]
        end = min(len(segment.payload), self._begun + self._pace.frame)
        part = segment.payload if end - self._begun == len(segment.payload) else segment.payload[self._begun : end]
        has_more = end < len(segment.payload)
        self._waiting_bytes -= end - self._begun
        self._begun = end if has_more else 0
        if not has_more:
            self._waiting.popleft()
        return Frame(self._next, self.dropped, segment._replace(payload=part), has_more)

    @property
    def _has_window(self) -> bool:
        window = self._pace.window
        return self._under_way_bytes < window or len(self._under_way) < (2 if window else 1)

    @property
    def _has_too_many(self) -> bool:
        return len(self._waiting) > self._most or self._waiting_bytes > self._pace.most_waiting

    @staticmethod
    def _size(frame: Frame) -> int:
        return 0 if frame.segment is None else len(frame.segment.payload)


class Receiving:
    """The receiver's end: puts frames in order and acknowledges them."""

    def __init__(self) -> None:
        self.dropped = 0
        """The number of dropped segments before the last one that was delivered."""
        self._expected = 0
        self._held: dict[int, Frame] = {}
        self._parts: list[Buffer] = []
        """The parts of an element whose last part has not come."""
        self._untold = self._untold_bytes = 0
        self._tell_s: float | None = None
        self._asked_s = 0.0
        self._asked_to = 0
        """Missing numbers before this one have been asked for."""
        self._limit = 0

    def take(self, frame: Frame, now_s: float) -> list[Segment]:
        """Take a frame. Returns the segments to deliver now, in order."""
        if frame.segment is None or frame.number < self._expected or frame.number in self._held:
            self._tell_s = now_s  # the sender does not know what has come
            return []
        if frame.number >= self._expected + 2 * FRAMES_UNDER_WAY:
            return []
        self._held[frame.number] = frame
        is_large = len(frame.segment.payload) > SMALL_FRAME or frame.has_more or bool(self._parts)
        segments, before = [], self._expected
        while (next_one := self._held.pop(self._expected, None)) is not None:
            self._expected += 1
            segment = next_one.segment
            assert segment is not None
            self._untold_bytes += len(segment.payload)
            if next_one.has_more or self._parts:
                self._parts.append(segment.payload)
            if next_one.has_more:
                continue
            self.dropped = next_one.dropped
            segments.append(segment._replace(payload=b"".join(self._parts)) if self._parts else segment)
            self._parts = []
        self._untold += self._expected - before
        is_much = self._untold >= _TOLD_EVERY or self._untold_bytes >= _TOLD_EVERY_BYTES
        due_s = now_s if is_much or self._held else now_s + (_SOON_CREDIT_S if is_large else _LATEST_CREDIT_S)
        self._tell_s = due_s if self._tell_s is None else min(self._tell_s, due_s)
        return segments

    def credit(self, now_s: float, *, has_room: bool = True) -> Credit | None:
        """The credit to send now; None if it would say nothing new, or one was sent just now."""
        limit = self._expected + FRAMES_UNDER_WAY if has_room else self._limit
        has_new_room = limit - self._limit >= FRAMES_UNDER_WAY // 2
        is_due = self._tell_s is not None and now_s >= self._tell_s
        if not (is_due or has_new_room):
            return None
        self._limit = max(self._limit, limit)
        self._untold = self._untold_bytes = 0
        self._tell_s = now_s + _ASK_AGAIN_S if self._held else None
        missing: tuple[int, ...] = ()
        if self._held:
            first = max(self._expected, self._asked_to)
            if now_s - self._asked_s >= _ASK_AGAIN_S:
                first, self._asked_s = self._expected, now_s
            missing = tuple(n for n in range(first, max(self._held)) if n not in self._held)[:_MOST_MISSING]
            self._asked_to = max(missing, default=self._asked_to - 1) + 1
        return Credit(self._expected, self._limit, missing)

    @property
    def due_s(self) -> float | None:
        """The time at which a credit is due; None if none is."""
        return self._tell_s


class DuplexChannel:
    """One end of a two-way channel: offered segments are sent until they have arrived, and received ones are
    acknowledged.
    """

    def __init__(self, sending: Sending) -> None:
        self.sending = sending
        self.receiving = Receiving()

    def take(self, is_credit: bool, head: bytes, payload: bytes, now_s: float) -> list[Segment]:
        """Take a credit or a frame. Returns the segments to deliver now, in order."""
        if is_credit:
            credit = read_credit(payload)
            if credit is not None:
                self.sending.hear(credit, now_s)
            return []
        frame = read_frame(head, payload)
        return [] if frame is None else self.receiving.take(frame, now_s)

    def pump(self, put: Put, put_credit: Put, now_s: float, *, has_room: bool = True) -> None:
        """Send the frames that are due. Without room, the other end is told to pause."""
        for frame in self.sending.due(now_s):
            put(frame.head(), b"" if frame.segment is None else bytes(frame.segment.payload))
        credit = self.receiving.credit(now_s, has_room=has_room)
        if credit is not None:
            put_credit(b"", credit.packed())

    @property
    def due_s(self) -> float:
        """The time at which `pump` is due if nothing arrives before; infinite if it is not."""
        times = [due_s for due_s in (self.sending.due_s, self.receiving.due_s) if due_s is not None]
        return min(times, default=inf)
