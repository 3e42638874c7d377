"""Passes calls of services on to the node that offers each now. A call under way is answered by its old server."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from cfgplan_runtime.ros2.host.host import Host

_READY_S = 0.02
"""Seconds from one look to the next whether a server can be reached, as long as calls wait for it."""


class LedService:
    """A service of class `kind` that callers know as `target`, and that `source` answers.

    `route` says which service answers a request, where it is not the present source; `answered` is called with the
    service, the request and the response of each call.
    """

    def __init__(
        self,
        host: Host,
        target: str,
        kind: Any,
        route: Callable[[Any], str | None] = lambda _: None,
        answered: Callable[[str, Any, Any], None] = lambda *_: None,
    ) -> None:
        self._host, self._cls, self._route, self._answered = host, kind, route, answered
        self._clients: dict[str, Any] = {}
        self._calls: dict[tuple[str, int], tuple[Any, Any]] = {}
        """The header and the request of each call that is under way."""
        self._waiting: list[tuple[str | None, Any, Any]] = []
        """Calls whose server is not connected yet: the service that `route` says, header and request."""
        self.source = ""
        self._server = host.node.create_service(kind, target, lambda _, response: response)
        host.waiting.watch("service", self._server.handle, self._hear_call)

    def lead(self, source: str) -> None:
        """Have another service answer from now on."""
        self.source = source
        if source not in self._clients:
            client = self._clients[source] = self._host.node.create_client(self._cls, source)
            self._host.waiting.watch("client", client.handle, partial(self._hear_answer, source))

    def is_ready(self, source: str) -> bool:
        """Whether a service that it has been led to can be called."""
        return bool(self._clients[source].service_is_ready())

    def answer_all(self, source: str, response: Any) -> None:
        """Answer all calls that a service has not answered."""
        for key in [key for key in self._calls if key[0] == source]:
            header, _ = self._calls.pop(key)
            self._server.handle.service_send_response(response, header.request_id)

    def close(self) -> None:
        self._host.waiting.unwatch("service", self._server.handle)
        self._host.node.destroy_service(self._server)
        for client in self._clients.values():
            self._host.waiting.unwatch("client", client.handle)
            self._host.node.destroy_client(client)
        self._clients.clear()
        self._waiting.clear()

    def _hear_call(self) -> None:
        request, header = self._server.handle.service_take_request(self._cls.Request)
        if request is not None:
            self._waiting.append((self._route(request), header, request))
            self._send()

    def _send(self) -> None:
        """Pass on the calls whose server is connected; any other would be lost."""
        waiting, self._waiting = self._waiting, []
        for routed, header, request in waiting:
            source = routed or self.source  # the present one: the one at its arrival may have died
            if self.is_ready(source):
                number = self._clients[source].handle.send_request(request)
                self._calls[source, number] = header, request
            else:
                self._waiting.append((routed, header, request))
        if self._waiting:
            self._host.waiting.later(_READY_S, self._send)

    def _hear_answer(self, source: str) -> None:
        header, response = self._clients[source].handle.take_response(self._cls.Response)
        if header is None:
            return
        call = self._calls.pop((source, header.request_id.sequence_number), None)
        if call is not None:
            self._answered(source, call[1], response)
            self._server.handle.service_send_response(response, call[0].request_id)
