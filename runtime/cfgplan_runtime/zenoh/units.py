"""Unit code for Zenoh: a source that subscribes to key expressions, and a sink that puts its input."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, Final, Literal, get_args

from cfgplan.errors import InputError
from cfgplan.extras import needed
from cfgplan_runtime.outside.mailbox import Mailbox
from cfgplan_runtime.outside.once import Once
from cfgplan_runtime.outside.payload_forms import PayloadForm, PayloadReader, check_form, encoded
from cfgplan_runtime.outside.units import ORDERS_LOOK_S, check_call, only_value, say
from cfgplan_runtime.zenoh.session import (
    FIRST_S,
    ZenohUnitSession,
    check_endpoints,
    check_parameters,
    key_expression,
    parameters,
)

if TYPE_CHECKING:
    import zenoh

WhenFull = Literal["drop", "block"]
_MOST_WAITING: Final = 10_000


class Subscriber:
    """A source: gives the values put at `key_expr`, which may have the wildcards `*` and `**`.

    `payload` is the form of values (json, text, number or bytes). An element is a value, or its `field`: a key of JSON,
    or a list of keys that lead further in. With wildcards, or if `with_key` is true, an element is a mapping with `key`
    and `value`. Deletions are ignored. For the other parameters see `ZenohUnitSession`. Raises InputError.
    """

    def __init__(
        self,
        key_expr: str,
        payload: PayloadForm = "json",
        field: str | list[str | int] | None = None,
        with_key: bool | None = None,
        **session: Any,
    ) -> None:
        needed("Zenoh units", "zenoh")
        check_parameters(session)
        self._key_expr = key_expression(key_expr)
        self._reader = PayloadReader(payload, field, say)
        self._with_key = "*" in self._key_expr if with_key is None else with_key
        self._session = ZenohUnitSession(say, **session)

    @classmethod
    def check_params(cls, params: Mapping[str, Any]) -> None:
        """Raise InputError for params with which no unit can be constructed. Opens no session."""
        _check_params(cls, params, is_plain=False)

    def __iter__(self) -> Iterator[Any]:
        import zenoh

        mailbox: Mailbox[tuple[str, bytes]] = Mailbox(_MOST_WAITING)

        def take(sample: zenoh.Sample) -> None:
            if sample.kind == zenoh.SampleKind.PUT:
                mailbox.put((str(sample.key_expr), sample.payload.to_bytes()))

        declared: list[object] = []
        self._session.on_open = lambda session: declared.append(session.declare_subscriber(self._key_expr, take))
        try:
            self._session.open()
            yield from self._values(mailbox)
        finally:
            self._session.close()

    def _values(self, mailbox: Mailbox[tuple[str, bytes]]) -> Iterator[Any]:
        once = Once(say)
        while True:
            letter = mailbox.take(ORDERS_LOOK_S)
            self._session.check()
            if mailbox.dropped:
                once.tell(
                    "dropped", f"{self._key_expr}: values come faster than they are taken, and the oldest are dropped"
                )
            if letter is None:
                yield None
                continue
            key, payload = letter
            for value in self._reader.values(key, payload):
                yield {"key": key, "value": value} if self._with_key else value


class Publisher:
    """A sink: puts each value that comes at its one input at `key_expr`, in the form that `payload` says.

    If the link is full, a value is dropped, or waits for room if `when_full` is `block`. A value that is put
    without a link is lost. For the other parameters see `ZenohUnitSession`. Raises InputError.
    """

    def __init__(
        self, key_expr: str, payload: PayloadForm = "json", when_full: WhenFull = "drop", **session: Any
    ) -> None:
        needed("Zenoh units", "zenoh")
        import zenoh

        check_parameters(session)
        check_form(payload)
        _check_when_full(when_full)
        self._payload = payload
        self._key_expr = key_expression(key_expr, is_plain=True)
        self._session = ZenohUnitSession(say, **session)
        congestion = zenoh.CongestionControl
        self._congestion = congestion.BLOCK if when_full == "block" else congestion.DROP
        self._publisher: zenoh.Publisher | None = None
        """None until the session is open."""
        self._session.on_open = self._declare
        self._session.open()
        self._session.wait(FIRST_S)

    @classmethod
    def check_params(cls, params: Mapping[str, Any]) -> None:
        """Raise InputError for params with which no unit can be constructed. Opens no session."""
        _check_params(cls, params, is_plain=True)
        _check_when_full(params.get("when_full", "drop"))

    def __call__(self, **inputs: object) -> None:
        payload = encoded(only_value(inputs), self._payload)
        self._session.check()
        if self._publisher is not None:
            self._publisher.put(payload)

    def _declare(self, session: zenoh.Session) -> None:
        self._publisher = session.declare_publisher(self._key_expr, congestion_control=self._congestion)

    def close(self) -> None:
        """End the session once everything that was put has left."""
        self._session.close()


def _check_params(kind: type[Subscriber | Publisher], params: Mapping[str, Any], *, is_plain: bool) -> None:
    check_call(kind, "Zenoh", parameters(), params)
    check_endpoints(params)
    key_expression(params["key_expr"], is_plain=is_plain)


def _check_when_full(when_full: object) -> None:
    """Raise InputError for any value but `drop` and `block`."""
    if when_full not in get_args(WhenFull):
        raise InputError.of(f"`when_full` can't be `{when_full}`", mend="write drop or block")
