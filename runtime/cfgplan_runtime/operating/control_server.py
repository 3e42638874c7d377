"""The control socket: serves up to MOST_CLIENTS clients, each in a thread of its own.

It never calls the supervisor: a slow, silent or broken client harms only itself.
"""

from __future__ import annotations

import os
import queue
import socket
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from cfgplan_runtime.operating.protocol import (
    LONGEST_LINE,
    Record,
    RefusedError,
    greeting,
    line,
    parse_request,
    refusal,
    result,
)
from cfgplan_runtime.streams.closable import Closable
from cfgplan_runtime.streams.run_folder import control_address, name_of

Method = Callable[[Mapping[str, Any]], Record]
"""Carries out a request with these params and returns the result; raises RefusedError."""

MOST_CLIENTS = 32
IDLE_S = 5.0
"""Seconds after which a client that asks for nothing makes room for another, if there are MOST_CLIENTS."""
MOST_WAITING_EVENTS = 1000
_CLIENTS_WAITING = 16
_REQUEST_CHUNK = 1 << 16


class ControlServer(Closable):
    """Serves `methods` at the control socket of the run in `folder` until it is closed; a context manager.

    Each client gets the name of the run's `environment` file as it connects. `subscribe` is a method of the server
    itself: `publish` sends events to the clients that have called it. Events that a client does not read are dropped,
    and it gets their number. Additions `while_connected` are withdrawn when their client's connection ends for any
    reason.
    """

    def __init__(self, folder: Path, methods: Mapping[str, Method], environment: str) -> None:
        self._methods = methods
        self._greeting = line(greeting(folder.name, environment, os.getpid(), name_of(folder)))
        self._path = control_address(folder)
        self._clients: set[_Client] = set()
        self._lock = threading.Lock()
        self._is_closed = False
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._listener.bind(str(self._path))
        self._path.chmod(0o600)
        self._listener.listen(_CLIENTS_WAITING)
        self._thread = threading.Thread(target=self._accept, name="cfgplan-control", daemon=True)
        self._thread.start()

    @property
    def has_subscribers(self) -> bool:
        """Whether anyone has subscribed."""
        with self._lock:
            return any(client.is_subscribed for client in self._clients)

    def publish(self, event: Record) -> None:
        """Send an event to all subscribers; returns at once."""
        with self._lock:
            clients = [client for client in self._clients if client.is_subscribed]
        for client in clients:
            client.publish(event)

    def close(self) -> None:
        """Disconnect every client; requests that are being answered are abandoned."""
        with self._lock:
            self._is_closed = True
            clients = list(self._clients)
        with suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._thread.join()
        self._listener.close()
        self._path.unlink(missing_ok=True)
        for client in clients:
            client.close()

    def _accept(self) -> None:
        while True:
            try:
                end, _ = self._listener.accept()
            except OSError:
                if self._is_closed or self._listener.fileno() == -1:
                    return
                # Out of descriptors, most likely: some may be free again soon.
                threading.Event().wait(0.1)
                continue
            with self._lock:
                if len(self._clients) >= MOST_CLIENTS:
                    self._dismiss_an_idle_one()
                welcome = len(self._clients) < MOST_CLIENTS and not self._is_closed
                if welcome:
                    client = _Client(end, self._methods, self._greeting, self._forget)
                    self._clients.add(client)
            if welcome:
                client.start()
            else:
                busy = RefusedError("busy", f"{MOST_CLIENTS} clients are connected already", "close one of them")
                with suppress(OSError):
                    end.sendall(line(refusal(None, busy)), socket.MSG_DONTWAIT)
                end.close()

    def _dismiss_an_idle_one(self) -> None:
        """Disconnect the client that has asked for nothing for the longest time, at least IDLE_S, if there is one."""
        idle = [client for client in self._clients if client.idle_s() >= IDLE_S]
        if idle:
            longest = max(idle, key=_Client.idle_s)
            self._clients.discard(longest)
            longest.close()

    def _forget(self, client: _Client) -> None:
        with self._lock:
            self._clients.discard(client)


class _Client:
    """One connection: a thread that answers requests and, once subscribed, one that sends events."""

    def __init__(
        self,
        end: socket.socket,
        methods: Mapping[str, Method],
        hello: bytes,
        forget: Callable[[_Client], None],
    ) -> None:
        self.is_subscribed = False
        self._end = end
        self._methods = methods
        self._hello = hello
        self._forget = forget
        self._sending = threading.Lock()
        self._events: queue.Queue[Record | None] = queue.Queue(MOST_WAITING_EVENTS)
        self._dropped = 0
        self._brought: list[str] = []
        """Names of what was added only for the time of this connection."""
        self._is_answering = False
        self._asked_s = time.monotonic()
        """When it last got an answer, or connected."""
        self._answerer = threading.Thread(target=self._answer, name="cfgplan-control-client", daemon=True)
        self._teller = threading.Thread(target=self._tell, name="cfgplan-control-events", daemon=True)

    def start(self) -> None:
        self._answerer.start()

    def idle_s(self) -> float:
        """Seconds since its last request; 0 during one, and if it waits for events or has added something."""
        if self._is_answering or self.is_subscribed or self._brought:
            return 0.0
        return time.monotonic() - self._asked_s

    def publish(self, event: Record) -> None:
        try:
            self._events.put_nowait(event)
        except queue.Full:
            self._dropped += 1

    def close(self) -> None:
        """Disconnect. Each thread ends after its present request."""
        with suppress(OSError):
            self._end.shutdown(socket.SHUT_RDWR)

    def _answer(self) -> None:
        try:
            self._send(self._hello)
            for data in self._lines():
                self._is_answering = True
                self._send(self._reply(data))
                self._is_answering, self._asked_s = False, time.monotonic()
        except OSError:
            pass
        finally:
            self._forget(self)
            self.close()
            if self.is_subscribed:
                self.is_subscribed = False
                with suppress(queue.Empty):
                    while True:
                        self._events.get_nowait()
                self._events.put(None)
                self._teller.join()
            self._end.close()
            for name in self._brought:
                with suppress(RefusedError):  # it is gone already, or the run is
                    self._methods["withdraw"]({"name": name, "wait_s": 0})

    def _lines(self) -> Any:
        pending = bytearray()
        while chunk := self._end.recv(_REQUEST_CHUNK):
            pending += chunk
            if len(pending) > LONGEST_LINE:
                error = RefusedError("too_long", f"a request has at most {LONGEST_LINE} bytes", "send it in parts")
                self._send(line(refusal(None, error)))
                return
            if b"\n" in chunk:
                *lines, rest = pending.split(b"\n")
                pending = bytearray(rest)
                for data in lines:
                    if data.strip():
                        yield bytes(data)

    def _reply(self, data: bytes) -> bytes:
        request_id = None
        try:
            request = parse_request(data)
            request_id = request.id
            return line(result(request_id, self._do(request.method, request.params)))
        except RefusedError as error:
            return line(refusal(request_id, error))
        except Exception as error:
            bug = RefusedError("internal", f"{type(error).__name__}: {error}", "this is a bug in cfgplan: report it")
            return line(refusal(request_id, bug))

    def _do(self, method: str, params: Mapping[str, Any]) -> Record:
        if method == "subscribe":
            if not self.is_subscribed:
                self.is_subscribed = True
                self._teller.start()
            return {}
        if method not in self._methods:
            known = ", ".join(sorted([*self._methods, "subscribe"]))
            raise RefusedError("unknown_method", f"there is no method {method!r}", f"use one of {known}")
        given = self._methods[method](params)
        if method == "add" and params.get("while_connected"):
            self._brought.append(given["name"])
        return given

    def _tell(self) -> None:
        while (event := self._events.get()) is not None:
            dropped, self._dropped = self._dropped, 0
            try:
                self._send(line({"event": event, **({"dropped": dropped} if dropped else {})}))
            except OSError:
                self.close()

    def _send(self, data: bytes) -> None:
        with self._sending:
            self._end.sendall(data)
