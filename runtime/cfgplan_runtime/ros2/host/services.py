"""Passes calls of services on to the node that offers each now. A call under way is answered by its old server."""

from __future__ import annotations

from typing import Any

from cfgplan_runtime.ros2.host.endpoints import message_class
from cfgplan_runtime.ros2.host.host import Host


class LedService:
    """A service that callers know as `target`, and that `source` answers. Raises UnknownTypeError."""

    def __init__(self, host: Host, target: str, kind: str) -> None:
        self._host, self._cls = host, message_class(kind)
        self._clients: dict[str, Any] = {}
        self._calls: dict[tuple[str, int], Any] = {}
        self.source = ""
        self._server = host.node.create_service(self._cls, target, lambda _, response: response)
        host.waiting.watch("service", self._server.handle, self._hear_call)

    def lead(self, source: str) -> None:
        """Have another service answer from now on."""
        self.source = source
        if source not in self._clients:
            client = self._clients[source] = self._host.node.create_client(self._cls, source)
            self._host.waiting.watch("client", client.handle, lambda: self._hear_answer(source))

    def close(self) -> None:
        self._host.waiting.unwatch("service", self._server.handle)
        self._host.node.destroy_service(self._server)
        for client in self._clients.values():
            self._host.waiting.unwatch("client", client.handle)
            self._host.node.destroy_client(client)

    def _hear_call(self) -> None:
        request, header = self._server.handle.service_take_request(self._cls.Request)
        if request is not None:
            number = self._clients[self.source].handle.send_request(request)
            self._calls[self.source, number] = header

    def _hear_answer(self, source: str) -> None:
        header, response = self._clients[source].handle.take_response(self._cls.Response)
        if header is None:
            return
        call = self._calls.pop((source, header.request_id.sequence_number), None)
        if call is not None:
            self._server.handle.service_send_response(response, call.request_id)
