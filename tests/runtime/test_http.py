"""The unit that polls a resource, against a server on this computer."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import pytest
from cfgplan_runtime.http import Poller

from cfgplan.errors import InputError


class Server:
    """A server whose answers a test sets by path, and the headers of what it was asked."""

    def __init__(self) -> None:
        self.answers: dict[str, tuple[int, bytes]] = {}
        self.moved: dict[str, str] = {}
        self.asked: list[dict[str, str]] = []
        outer = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                outer.asked.append(dict(self.headers))
                code, body = outer.answers.get(self.path, (404, b"none"))
                if self.path in outer.moved:
                    code, body = 302, b""
                self.send_response(code)
                if self.path in outer.moved:
                    self.send_header("Location", outer.moved[self.path])
                self.end_headers()
                self.wfile.write(body)

            def log_message(self, *_: Any) -> None:
                pass

        self.server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.url = f"http://127.0.0.1:{self.server.server_port}"
        self._thread = threading.Thread(target=self.server.serve_forever, args=[0.02])
        self._thread.start()

    def close(self) -> None:
        self.server.shutdown()
        self.server.server_close()
        self._thread.join()


@pytest.fixture
def server() -> Iterator[Server]:
    server = Server()
    yield server
    server.close()


@pytest.mark.parametrize(
    ("params", "body", "value"),
    [
        ({}, b'{"a": 1}', {"a": 1}),
        ({"field": ["a", 0]}, b'{"a": [7]}', 7),
        ({"payload": "number"}, b" 20.5\n", 20.5),
        ({"payload": "text"}, b"open", "open"),
        ({"payload": "bytes"}, b"\xff\0", b"\xff\0"),
    ],
)
def test_an_answer_is_the_value_that_it_holds(
    params: dict[str, Any], body: bytes, value: object, server: Server
) -> None:
    server.answers["/x"] = 200, body
    assert Poller(f"{server.url}/x", **params)() == value


def test_a_resource_that_can_not_be_had_is_told_once_and_again_when_it_is_there(
    server: Server, capsys: pytest.CaptureFixture[str]
) -> None:
    poller = Poller(f"{server.url}/x")
    assert [poller() for _ in range(3)] == [None, None, None]
    assert capsys.readouterr().out == f"{server.url}/x answers 404 Not Found; it is tried again\n"
    server.answers["/x"] = 200, b"7"
    assert [poller(), poller()] == [7, 7]
    assert capsys.readouterr().out == f"{server.url}/x answers again\n"
    server.close()
    assert [poller(), poller()] == [None, None]
    told = capsys.readouterr().out
    assert (told.count("does not answer"), "Connection refused" in told) == (1, True)


def test_what_is_no_value_is_told_once(server: Server, capsys: pytest.CaptureFixture[str]) -> None:
    server.answers["/x"] = 200, b"{"
    poller = Poller(f"{server.url}/x")
    assert [poller(), poller()] == [None, None]
    assert capsys.readouterr().out.count("a message can't be read as json, and is left out") == 1


def test_a_password_goes_to_the_resource_and_not_to_where_it_leads(
    server: Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PASSWORD", "sesame")
    monkeypatch.setenv("TOKEN", "abc")
    other = Server()
    try:
        server.moved["/x"] = f"{other.url}/y"
        other.answers["/y"] = 200, b"7"
        assert Poller(f"{server.url}/x", username="bob", password_env="PASSWORD")() == 7
        assert server.asked[0]["Authorization"] == "Basic Ym9iOnNlc2FtZQ=="
        assert "Authorization" not in other.asked[0]
        Poller(f"{server.url}/x", token_env="TOKEN")()
        assert server.asked[1]["Authorization"] == "Bearer abc"
    finally:
        other.close()


REFUSED_AT_ONCE: list[tuple[dict[str, Any], str]] = [
    ({"url": "file:///etc/passwd"}, "is not the URL of a resource"),
    ({"url": "http://bob:secret@house"}, "a URL can't hold the name"),
    ({"payload": "yaml"}, "is not a form of payload"),
    ({"password": "secret"}, "an environment file can't hold a password"),
    ({"usrname": "bob"}, "did you mean `username`"),
    ({"password_env": "NO_SUCH"}, "a password without a name"),
]


@pytest.mark.parametrize(
    ("params", "message"),
    [
        *REFUSED_AT_ONCE,
        ({"token_env": "NO_SUCH"}, "the variable NO_SUCH is not set"),
        ({"ca": "/absent"}, "the authority of TLS can't be read"),
    ],
)
def test_parameters_that_can_not_be_meant_are_refused(params: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message) as refused:
        Poller(**{"url": "http://127.0.0.1/x", **params})
    assert "secret" not in str(refused.value)


@pytest.mark.parametrize(("params", "message"), REFUSED_AT_ONCE)
def test_they_are_refused_before_a_run_if_the_machine_does_not_matter(params: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        Poller.check_params({"url": "http://127.0.0.1/x", **params})
