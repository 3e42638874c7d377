"""Units of Zenoh on this computer: with one another, with sessions of a test's own, and through a router."""

from __future__ import annotations

import json
import queue
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from cfgplan_runtime.zenoh import Publisher, Subscriber
from operated_world import PATIENCE_S, await_event, eventually, running

from cfgplan.cli import main
from cfgplan.errors import InputError

pytest.importorskip("zenoh", reason="eclipse-zenoh is not installed (extra fleet)")


ROUTER = """
import sys, zenoh
session = zenoh.open(zenoh.Config.from_json5(sys.argv[1]))
print("there", flush=True)
sys.stdin.read()
"""


def free_endpoint(protocol: str = "tcp") -> str:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return f"{protocol}/127.0.0.1:{free.getsockname()[1]}"


@contextmanager
def router(endpoint: str, **more: Any) -> Iterator[subprocess.Popen[str]]:
    """A router of Zenoh in a process of its own."""
    scouting = {"multicast": {"enabled": False}}
    config = {"mode": "router", "listen": {"endpoints": [endpoint]}, "scouting": scouting, **more}
    line = [sys.executable, "-c", ROUTER, json.dumps(config)]
    with subprocess.Popen(line, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "there\n"
            yield process
        finally:
            process.kill()


class Heard:
    """The values of a subscriber, taken by a thread."""

    def __init__(self, subscriber: Subscriber) -> None:
        self.values: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._take, args=[subscriber])
        self._thread.start()

    def next(self) -> Any:
        return self.values.get(timeout=PATIENCE_S)

    def close(self) -> None:
        self._over.set()
        self._thread.join(PATIENCE_S)

    def _take(self, subscriber: Subscriber) -> None:
        elements = iter(subscriber)
        for value in elements:
            if value is not None:
                self.values.put(value)
            if self._over.is_set():
                break
        elements.close()


Units = Callable[..., Any]


@pytest.fixture
def hear() -> Iterator[Units]:
    there: list[Heard] = []

    def begin(key_expr: str, **params: Any) -> Heard:
        there.append(Heard(Subscriber(key_expr, **params)))
        return there[-1]

    yield begin
    for heard in there:
        heard.close()


@pytest.fixture
def publish() -> Iterator[Units]:
    there: list[Publisher] = []

    def begin(key_expr: str, **params: Any) -> Publisher:
        there.append(Publisher(key_expr, **params))
        return there[-1]

    yield begin
    for publisher in there:
        publisher.close()


def until_heard(publisher: Publisher, heard: Heard, value: object) -> Any:
    """What is heard first of a value that is put again and again: links and subscriptions take a moment."""
    eventually(lambda: publisher(x=value) or not heard.values.empty())
    return heard.next()


def test_wildcards_give_each_value_with_its_key(hear: Units, publish: Units) -> None:
    endpoint = free_endpoint()
    heard = hear("house/*/temperature", listen=endpoint)
    kitchen, hall = (publish(f"house/{room}/temperature", connect=[endpoint]) for room in ("kitchen", "hall"))
    assert until_heard(kitchen, heard, {"t": 20.5}) == {"key": "house/kitchen/temperature", "value": {"t": 20.5}}
    eventually(lambda: hall(x=1) or heard.next() == {"key": "house/hall/temperature", "value": 1})


@pytest.mark.parametrize(
    ("payload", "given", "told"),
    [("text", "on", "on"), ("number", 3, 3.0), ("bytes", b"\0a", b"\0a"), ("json", [1], [1])],
)
def test_a_payload_has_the_form_that_is_said(
    payload: str, given: object, told: object, hear: Units, publish: Units
) -> None:
    endpoint = free_endpoint()
    heard = hear("x", listen=endpoint, payload=payload)
    assert until_heard(publish("x", connect=endpoint, payload=payload), heard, given) == told


def test_a_field_is_given_and_what_is_no_value_is_told_once(
    hear: Units, publish: Units, capsys: pytest.CaptureFixture[str]
) -> None:
    endpoint = free_endpoint()
    heard = hear("x", listen=endpoint, field=["air", "co2"])
    words = publish("x", connect=endpoint, payload="text")
    assert until_heard(words, heard, '{"air": {"co2": 600}}') == 600
    for word in ("{", "{", "[1]", '{"air": {"co2": 700}}'):
        words(x=word)
    while (value := heard.next()) == 600:
        pass
    assert value == 700
    assert capsys.readouterr().out.count("x: a message") == 1


def test_a_deletion_is_no_value(hear: Units, publish: Units) -> None:
    endpoint = free_endpoint()
    heard = hear("x", listen=endpoint, payload="text")
    publisher = publish("x", connect=endpoint, payload="text")
    until_heard(publisher, heard, "before")
    publisher._publisher.delete()
    publisher(x="after")
    while (value := heard.next()) == "before":
        pass
    assert value == "after"


def test_a_router_that_is_away_or_dies_is_told_once_and_linked_again(
    hear: Units, publish: Units, capsys: pytest.CaptureFixture[str]
) -> None:
    endpoint = free_endpoint()
    told: list[str] = []

    def is_told(text: str) -> bool:
        told.extend(capsys.readouterr().out.splitlines())
        return any(text in line for line in told)

    heard = hear("count", connect=endpoint)
    eventually(lambda: is_told(f"the Zenoh peer at {endpoint} does not answer"))
    with router(endpoint) as process:
        eventually(lambda: is_told("is linked again"))
        publisher = publish("count", connect=endpoint)
        assert until_heard(publisher, heard, 1) == 1
        process.kill()
        eventually(lambda: is_told(f"the Zenoh peer at {endpoint} is lost"))
    publisher(x=2)
    with router(endpoint):
        eventually(lambda: publisher(x=3) or not heard.values.empty())
        while (value := heard.next()) == 1:
            pass
        assert value == 3, "nobody keeps what is put while no one is linked"
        eventually(lambda: is_told("never") or len([line for line in told if "linked again" in line]) == 3)
    assert len([line for line in told if "does not answer" in line]) == 1
    assert len([line for line in told if "is lost" in line]) == 2, "by each of the two units"


def test_links_are_spoken_by_tls(
    tmp_path: Path, hear: Units, publish: Units, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["certificates", str(tmp_path), "hub=127.0.0.1"]) == 0
    names = {each.name: str(each) for each in (tmp_path / "hub").iterdir()}
    endpoint = free_endpoint("tls")
    heard = hear("x", listen=endpoint, certificate=names["host.pem"], key=names["host.key"])
    publisher = publish("x", connect=endpoint, ca=names["authority.pem"])
    assert until_heard(publisher, heard, "safe") == "safe"
    publish("x", connect=endpoint)
    eventually(lambda: "does not let this session in" in capsys.readouterr().out)


def test_a_router_with_names_lets_in_who_knows_a_password(
    tmp_path: Path,
    hear: Units,
    publish: Units,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setenv("ZENOH_PASSWORD", "sesame")
    (tmp_path / "users").write_text("bob:sesame\n")
    endpoint = free_endpoint()
    auth = {"usrpwd": {"dictionary_file": str(tmp_path / "users")}}
    login = {"connect": endpoint, "username": "bob", "password_env": "ZENOH_PASSWORD"}
    with router(endpoint, transport={"auth": auth}):
        heard, publisher = hear("x", **login), publish("x", **login)
        assert until_heard(publisher, heard, 1) == 1
        publish("x", connect=endpoint)
        eventually(lambda: "does not let this session in" in capsys.readouterr().out)


def test_a_run_takes_from_zenoh_and_gives_to_it(tmp_path: Path, hear: Units, publish: Units) -> None:
    into, out = free_endpoint(), free_endpoint()
    env = tmp_path / "env.yaml"
    env.write_text(
        "format: cfgplan/1\n"
        "transformations:\n"
        "  - label: sensor\n"
        "    source: cfgplan_runtime.zenoh:Subscriber\n"
        f"    params: {{key_expr: in/*, with_key: false, listen: {into}}}\n"
        "    outputs: {state: State}\n"
        "  - label: lamp\n"
        "    source: cfgplan_runtime.zenoh:Publisher\n"
        f"    params: {{key_expr: out, connect: [{out}]}}\n"
        "    inputs: {state: State}\n"
        "targets:\n"
        "  - {label: light, run: lamp}\n"
    )
    heard = hear("out", listen=out)
    with running(env) as process:
        await_event(process, "Running")
        assert until_heard(publish("in/1", connect=into), heard, {"on": True}) == {"on": True}
        process.terminate()
        process.communicate(timeout=PATIENCE_S)
        assert process.returncode == 0


REFUSED_AT_ONCE: list[tuple[dict[str, Any], str]] = [
    ({"connect": None}, "needs an endpoint"),
    ({"connect": "127.0.0.1:7447"}, "`127.0.0.1:7447` is not an endpoint of Zenoh"),
    ({"connect": 7447}, "`7447` is not an endpoint of Zenoh"),
    ({"key_expr": "a//b"}, "`a//b` is not a key expression: .*empty chunks are forbidden"),
    ({"payload": "yaml"}, "`yaml` is not a form of payload"),
    ({"field": "a", "payload": "number"}, "has no fields"),
    ({"conect": "tcp/a:1"}, "did you mean `connect`"),
    ({"password": "secret"}, "an environment file can't hold a password"),
    ({"password_env": "NO_SUCH_VARIABLE"}, "a password without a name"),
]


@pytest.mark.parametrize(
    ("params", "message"),
    [
        *REFUSED_AT_ONCE,
        ({"username": "bob", "password_env": "NO_SUCH_VARIABLE"}, "NO_SUCH_VARIABLE is not set"),
    ],
)
def test_parameters_that_can_not_be_meant_are_refused(params: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message) as refused:
        Subscriber(**{"key_expr": "x", "connect": "tcp/127.0.0.1:1", **params})
    assert "secret" not in str(refused.value)


@pytest.mark.parametrize(("params", "message"), REFUSED_AT_ONCE)
def test_they_are_refused_before_a_run_if_the_machine_does_not_matter(params: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        Subscriber.check_params({"key_expr": "x", "connect": "tcp/127.0.0.1:1", **params})


@pytest.mark.parametrize(
    ("params", "message"),
    [
        ({"key_expr": "a/**"}, "`a/\\*\\*` can't be published to"),
        ({"when_full": "wait"}, "`when_full` can't be `wait`"),
        ({"connect": None, "listen": "tcp/203.0.113.1:1"}, "no session of Zenoh can be opened with tcp/203.0.113.1:1"),
        ({"connect": "tcpp/127.0.0.1:1"}, "`tcpp/127.0.0.1:1` is not an endpoint of Zenoh"),
        ({"connect": "tcp/127.0.0.1:1", "ca": "/absent"}, "the file of TLS can't be read"),
    ],
)
def test_a_publisher_refuses_what_it_can_not_use(params: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        Publisher(**{"key_expr": "x", "connect": "tcp/127.0.0.1:1", **params})


def test_a_unit_says_what_it_needs_where_the_library_lacks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cfgplan.extras.is_there", lambda _: False)
    with pytest.raises(InputError, match=r"cfgplan\[fleet\]"):
        Subscriber("x", connect="tcp/127.0.0.1:1")
