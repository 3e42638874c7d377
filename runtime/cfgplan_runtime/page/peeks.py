"""Peeks: the last elements of one stream for a viewer, at a bounded rate, as long as the viewer looks."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress

from cfgplan_runtime.errors import ControlError, EncodingError, NoSuchTopicError
from cfgplan_runtime.operating.protocol import Record, RefusedError
from cfgplan_runtime.page.shown_values import shown
from cfgplan_runtime.streams.element import Element
from cfgplan_runtime.streams.payload import decode
from cfgplan_runtime.streams.subscription import SubscriptionToTopic

PERIOD_S = 0.2
"""Seconds from one shown element to the next, at least."""
_RENEW_S = 2.0
_RATE_OVER_S = 5.0
_CLOSE_S = 2.0

Subscribe = Callable[..., SubscriptionToTopic]
"""`cfgplan_runtime.subscribe`, or that of a fleet."""


class Peek:
    """Gives records of a stream's last elements until it is closed, from a thread of its own.

    `topic_of` returns a topic that has the stream, and is asked again every two seconds. A record has `stream`, and
    `numbers`, `text` and `images` of the last element with `age_s`, `rate_hz` and `elements`, or the reason why there
    is none as `failed`.
    """

    def __init__(
        self, stream: str, topic_of: Callable[[str], str], subscribe: Subscribe, give: Callable[[Record], None]
    ) -> None:
        self._stream = stream
        self._topic_of = topic_of
        self._subscribe = subscribe
        self._give = give
        self._is_closed = threading.Event()
        self._arrived: deque[tuple[float, int]] = deque(maxlen=1000)
        """When elements came, and how many the stream had given by then."""
        self._elements = 0
        """How many elements the stream has given since the peek began, also those that did not come here."""
        self._thread = threading.Thread(target=self._work, name=f"cfgplan-peek {stream}", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop looking."""
        self._is_closed.set()
        self._thread.join(_CLOSE_S)

    def _work(self) -> None:
        while not self._is_closed.is_set():
            try:
                self._look(self._topic_of(self._stream))
            except RefusedError as error:
                self._fail(str(error))
            except (ControlError, NoSuchTopicError) as error:
                self._fail(str(error))
            self._is_closed.wait(PERIOD_S)

    def _fail(self, reason: str) -> None:
        self._give({"stream": self._stream, "failed": reason})
        self._is_closed.wait(_RENEW_S)

    def _look(self, topic: str) -> None:
        """Show elements for a while: until it is time to ask for the topic again."""
        until_s = time.monotonic() + _RENEW_S
        given_s, last, dropped = 0.0, None, 0
        with self._subscribe(topic, timeout_s=PERIOD_S) as subscription:
            while not self._is_closed.is_set() and subscription.is_connected:
                with suppress(TimeoutError):
                    for element in subscription.elements():
                        last = element
                        self._elements += 1 + subscription.dropped - dropped
                        dropped = subscription.dropped
                        self._arrived.append((time.monotonic(), self._elements))
                        if time.monotonic() - given_s >= PERIOD_S or self._is_closed.is_set():
                            break
                now_s = time.monotonic()
                if last is not None and now_s - given_s >= PERIOD_S:
                    self._show(last, subscription.now_ns())
                    given_s, last = now_s, None
                if now_s >= until_s:
                    until_s = now_s + _RENEW_S
                    if self._topic_of(self._stream) != topic:
                        return

    def _show(self, element: Element, now_ns: int) -> None:
        recent = [one for one in self._arrived if one[0] > time.monotonic() - _RATE_OVER_S]
        over_s, more = (recent[-1][at] - recent[0][at] if len(recent) > 1 else 0 for at in (0, 1))
        try:
            value = shown(decode(element.payload))
        except EncodingError as error:
            value = {"failed": str(error)}
        self._give(
            {
                "stream": self._stream,
                "elements": self._elements,
                "rate_hz": round(more / over_s, 2) if over_s else None,
                "age_s": round((now_ns - element.time_ns) / 1e9, 3),
                **value,
            }
        )
