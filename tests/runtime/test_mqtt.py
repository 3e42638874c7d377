"""Units of MQTT against a real broker on this computer: mosquitto, which Debian has."""

from __future__ import annotations

import queue
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest
from cfgplan_runtime import mqtt
from cfgplan_runtime.mqtt import Publisher, Subscriber
from cfgplan_runtime.mqtt.connection import MqttRefusedError
from cfgplan_runtime.outside.payload_forms import PayloadReader
from mosquitto import NEEDS_MOSQUITTO, PATIENCE_S, Broker, make_certificate, running
from watching import StartRuntime
from world import eventually, start, unit

from cfgplan.domain import InputPort, OutputPort, Transformation
from cfgplan.errors import InputError

pytestmark = [NEEDS_MOSQUITTO, pytest.mark.xdist_group("mqtt")]


@pytest.fixture(autouse=True)
def paho() -> None:
    pytest.importorskip("paho", reason="paho-mqtt is not installed (extra mqtt)")


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[Broker]:
    with running(tmp_path) as broker:
        yield broker


class Heard:
    """What a subscriber gives, taken by a thread."""

    def __init__(self, subscriber: Subscriber) -> None:
        self.values: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self.raised: list[Exception] = []
        self._over = threading.Event()
        self.begun = threading.Event()
        subscriber._connection.on_subscribe = lambda *_: self.begun.set()
        self._thread = threading.Thread(target=self._take, args=[subscriber])
        self._thread.start()

    def next(self) -> Any:
        return self.values.get(timeout=PATIENCE_S)

    def close(self) -> None:
        self._over.set()
        self._thread.join(PATIENCE_S)

    def _take(self, subscriber: Subscriber) -> None:
        elements = iter(subscriber)
        try:
            for value in elements:
                if value is not None:
                    self.values.put(value)
                if self._over.is_set():
                    return
        except MqttRefusedError as error:
            self.raised.append(error)
        finally:
            elements.close()


Hear = Callable[..., Heard]


@pytest.fixture
def hear() -> Iterator[Hear]:
    """Hear what a subscriber with these parameters gives."""
    there: list[Heard] = []

    def begin(broker: str, topic: str, *, waits: bool = True, **params: Any) -> Heard:
        there.append(Heard(Subscriber(broker, topic, **params)))
        if waits:
            assert there[-1].begun.wait(PATIENCE_S)
        return there[-1]

    yield begin
    for heard in there:
        heard.close()


@pytest.fixture
def publish() -> Iterator[Callable[..., Publisher]]:
    there: list[Publisher] = []

    def begin(*args: Any, **params: Any) -> Publisher:
        there.append(Publisher(*args, **params))
        return there[-1]

    yield begin
    for publisher in there:
        publisher.close()


Publish = Callable[..., Publisher]


def test_wildcards_give_each_value_with_its_topic(broker: Broker, hear: Hear, publish: Publish) -> None:
    heard = hear(broker.name, "house/+/temperature")
    for room in ("kitchen", "hall"):
        publish(broker.name, f"house/{room}/temperature")(x={"degrees": 20.5})
    publish(broker.name, "house/hall/light")(x=1)
    assert sorted((heard.next() for _ in range(2)), key=lambda value: value["topic"]) == [
        {"topic": "house/hall/temperature", "value": {"degrees": 20.5}},
        {"topic": "house/kitchen/temperature", "value": {"degrees": 20.5}},
    ]


@pytest.mark.parametrize(
    ("payload", "given", "told"),
    [("text", "on", "on"), ("number", 3, 3.0), ("bytes", b"\0a", b"\0a"), ("json", [1], [1])],
)
def test_a_payload_has_the_form_that_is_said(
    payload: str, given: object, told: object, broker: Broker, hear: Hear, publish: Publish
) -> None:
    heard = hear(broker.name, "x", payload=payload)
    publish(broker.name, "x", payload=payload)(value=given)
    assert heard.next() == told


@pytest.mark.parametrize(
    ("payload", "wrong"),
    [("number", "nan"), ("number", "inf"), ("number", "1_000"), ("json", "NaN"), ("json", '{"x": -Infinity}')],
)
def test_a_message_that_is_no_number_is_left_out(
    payload: str, wrong: str, broker: Broker, hear: Hear, publish: Publish
) -> None:
    heard = hear(broker.name, "x", payload=payload)
    texts = publish(broker.name, "x", payload="text")
    for text in (wrong, "20.5"):
        texts(value=text)
    assert heard.next() == 20.5


@pytest.mark.parametrize("payload", ["number", "json"])
def test_what_is_no_number_is_not_published(payload: str, broker: Broker, publish: Publish) -> None:
    with pytest.raises(ValueError, match=r"not a number|JSON"):
        publish(broker.name, "x", payload=payload)(value=float("nan"))


def test_a_retained_value_comes_first_unless_it_is_not_wanted(broker: Broker, hear: Hear, publish: Publish) -> None:
    publisher = publish(broker.name, "door", retain=True)
    before = hear(broker.name, "door")
    publisher(x="open")
    assert before.next() == "open"
    with_it, without = hear(broker.name, "door"), hear(broker.name, "door", retained=False)
    assert with_it.next() == "open"
    publisher(x="shut")
    assert (with_it.next(), without.next()) == ("shut", "shut")


def test_nothing_is_lost_while_the_broker_is_away(broker: Broker, hear: Hear, publish: Publish) -> None:
    heard, publisher = hear(broker.name, "count"), publish(broker.name, "count")
    for number in range(50):
        publisher(x=number)
    assert [heard.next() for _ in range(50)] == [*range(50)]
    broker.stop()
    for number in range(50, 100):
        publisher(x=number)
    broker.start()
    for number in range(100, 150):
        publisher(x=number)
    rest = [*iter(heard.next, 149)]
    # Messages that the broker had not confirmed come again: `qos` 1 is at least once.
    assert [*dict.fromkeys(number for number in rest if number >= 50)] == [*range(50, 149)]


def test_confirmations_that_come_while_a_message_is_published_block_nothing(broker: Broker, publish: Publish) -> None:
    publisher = publish(broker.name, "count")

    def send() -> None:
        for number in range(3000):
            publisher(x=number)

    thread = threading.Thread(target=send, daemon=True)
    thread.start()
    thread.join(PATIENCE_S)
    assert not thread.is_alive()
    eventually(lambda: not publisher._outbox._unsent)
    assert not publisher._outbox._sent_early


def test_a_message_counts_as_taken_once_the_next_is_asked_for(broker: Broker, publish: Publish) -> None:
    first = iter(Subscriber(broker.name, "job", client_id="worker"))
    next(first)
    publisher = publish(broker.name, "job")
    for job in ("a", "b"):
        publisher(x=job)
    assert next(value for value in first if value is not None) == "a"
    first.close()
    again = iter(Subscriber(broker.name, "job", client_id="worker"))
    again_taken = (value for value in again if value is not None)
    mqtt_again = [next(again_taken), next(again_taken)]
    again.close()
    assert mqtt_again == ["a", "b"]


def test_a_unit_whose_session_another_one_has_taken_up_is_silent_and_does_not_take_it_back(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """mosquitto 2.0.11 ends such a connection without a word; MQTT 5 has one (142) for it."""
    connections: list[socket.socket] = []

    def answer() -> None:
        with suppress(OSError):
            while True:
                client, _ = server.accept()
                connections.append(client)
                client.recv(4096)
                client.sendall(bytes.fromhex("2003000000") + bytes.fromhex("e0028e00"))

    with socket.create_server(("127.0.0.1", 0)) as server:
        threading.Thread(target=answer, daemon=True).start()
        elements = iter(Subscriber(f"127.0.0.1:{server.getsockname()[1]}", "x", client_id="reader"))
        told = ""

        def is_told() -> bool:
            nonlocal told
            assert next(elements) is None
            told += capsys.readouterr().out
            return "another client of this id has taken up the session; this one is silent" in told

        eventually(is_told)
        eventually(lambda: not any("paho" in thread.name for thread in threading.enumerate()))
        assert (next(elements), len(connections)) == (None, 1)
        elements.close()
        server.shutdown(socket.SHUT_RDWR)
    for connection in connections:
        connection.close()


def test_the_session_of_a_unit_ends_with_it(
    broker: Broker, hear: Hear, publish: Publish, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CFGPLAN_UNIT", "run/reader.1")
    first = hear(broker.name, "x")
    monkeypatch.delenv("CFGPLAN_UNIT")
    witness, publisher = hear(broker.name, "x"), publish(broker.name, "x")
    publisher(x=1)
    assert first.next() == witness.next() == 1
    first.close()
    publisher(x=2)
    assert witness.next() == 2, "the broker has it before the session begins again"
    monkeypatch.setenv("CFGPLAN_UNIT", "run/reader.1")
    again = hear(broker.name, "x")
    publisher(x=3)
    assert again.next() == 3, "who was stopped wants nothing of the time between"


def test_a_link_that_is_half_open_is_noticed_and_made_anew(
    broker: Broker, hear: Hear, publish: Publish, capsys: pytest.CaptureFixture[str]
) -> None:
    with proxy_to(broker.port) as (port, hush):
        heard = hear(f"127.0.0.1:{port}", "x", keepalive=1)
        publisher = publish(broker.name, "x")
        publisher(x=1)
        assert heard.next() == 1
        hush.set()
        publisher(x=2)
        eventually(lambda: "is lost" in capsys.readouterr().out)
        hush.clear()
        assert heard.next() == 2


@contextmanager
def proxy_to(port: int) -> Iterator[tuple[int, threading.Event]]:
    """A port that leads to another one. While the event is set nothing goes either way, and nothing is closed."""
    hush, over = threading.Event(), threading.Event()
    server = socket.create_server(("127.0.0.1", 0))

    def pump(source: socket.socket, target: socket.socket) -> None:
        source.settimeout(0.05)
        while not over.is_set():
            with suppress(TimeoutError):
                try:
                    data = source.recv(65536)
                    while hush.is_set() and not over.is_set():
                        over.wait(0.02)
                    target.sendall(data)
                except (ConnectionError, OSError) as error:
                    if isinstance(error, TimeoutError):
                        raise
                    return
                if not data:
                    return

    def accept() -> None:
        while not over.is_set():
            try:
                client, _ = server.accept()
            except OSError:
                return
            there = socket.create_connection(("127.0.0.1", port))
            ends.extend((client, there))
            for pair in ((client, there), (there, client)):
                threading.Thread(target=pump, args=pair, daemon=True).start()

    ends: list[socket.socket] = []
    threading.Thread(target=accept, daemon=True).start()
    try:
        yield server.getsockname()[1], hush
    finally:
        over.set()
        server.close()
        for end in ends:
            end.close()


def test_the_broker_publishes_the_last_will_of_who_dies_and_of_no_other(
    broker: Broker, hear: Hear, publish: Publish
) -> None:
    heard = hear(broker.name, "gone/#", payload="text")
    publish(broker.name, "x", will={"topic": "gone/well", "payload": "well"}).close()
    code = (
        "import sys, time; from cfgplan_runtime.mqtt import Publisher\n"
        "p = Publisher(sys.argv[1], 'x', will={'topic': 'gone/badly', 'payload': 'badly'}); p(x=1)\n"
        "print('there', flush=True); time.sleep(60)"
    )
    with subprocess.Popen([sys.executable, "-c", code, broker.name], stdout=subprocess.PIPE, text=True) as dying:
        assert dying.stdout is not None
        assert dying.stdout.readline() == "there\n"
        dying.kill()
    assert heard.next() == {"topic": "gone/badly", "value": "badly"}


def test_a_run_takes_from_a_broker_and_gives_to_it(
    broker: Broker, run_units: StartRuntime, hear: Hear, publish: Publish
) -> None:
    sensor = Transformation(
        "sensor",
        (),
        (OutputPort("y", "Y"),),
        source="cfgplan_runtime.mqtt:Subscriber",
        params={"broker": broker.name, "topic": "in"},
    )
    lamp = Transformation(
        "lamp",
        (InputPort("x", "Y"),),
        source="cfgplan_runtime.mqtt:Publisher",
        params={"broker": broker.name, "topic": "out"},
    )
    heard = hear(broker.name, "out")
    runtime = run_units(sensor, lamp)
    runtime.apply(start(unit("sensor.1"), unit("lamp.1", x="sensor.1/y")))
    publisher = publish(broker.name, "in", retain=True)
    publisher(x={"on": True})
    assert heard.next() == {"on": True}


def test_a_field_of_a_message_is_given_and_messages_without_it_are_told_once(
    broker: Broker, hear: Hear, publish: Publish, capsys: pytest.CaptureFixture[str]
) -> None:
    heard, inner = hear(broker.name, "air", field="co2"), hear(broker.name, "air", field=["pm", 1, "2.5"])
    publisher = publish(broker.name, "air")
    for value in ({"t": 1}, [3], {"co2": 600, "pm": [0, {"2.5": 7}]}):
        publisher(x=value)
    assert (heard.next(), inner.next()) == (600, 7)
    told = capsys.readouterr().out
    assert told.count("air: a message has no such field, and is left out: co2") == 1


def test_what_is_no_value_is_told_once_and_left_out(
    broker: Broker, hear: Hear, publish: Publish, capsys: pytest.CaptureFixture[str]
) -> None:
    heard, words = hear(broker.name, "x"), publish(broker.name, "x", payload="text")
    for word in ("{", "}", "7"):
        words(x=word)
    assert heard.next() == 7
    told = capsys.readouterr().out
    assert told.count("x: a message can't be read as json, and is left out") == 1
    assert "(it begins b'{'; `payload: text` accepts it)" in told


@pytest.mark.parametrize(("payload", "form"), [(b"open", "text"), (b"\xff\xd8 a picture", "bytes"), (b"\0\1", "bytes")])
def test_the_form_that_takes_an_unreadable_message_is_told(payload: bytes, form: str) -> None:
    told: list[str] = []
    assert PayloadReader("number", None, told.append).values("t", payload) == ()
    assert f"(it begins {payload!r}; `payload: {form}` accepts it)" in told[0]
    assert PayloadReader(form, None, told.append).values("t", payload)


def test_a_broker_that_is_not_there_yet_is_told_once(
    broker: Broker, hear: Hear, publish: Publish, capsys: pytest.CaptureFixture[str]
) -> None:
    broker.stop()
    heard = hear(broker.name, "x", waits=False)
    told = ""

    def is_told() -> bool:
        nonlocal told
        told += capsys.readouterr().out
        return "does not answer" in told

    eventually(is_told)
    broker.start()
    assert heard.begun.wait(PATIENCE_S)
    publish(broker.name, "x")(x=1)
    assert heard.next() == 1
    told += capsys.readouterr().out
    assert told.count("does not answer (Connection refused)") == 1
    assert f"{broker.name} is connected again" in told


def test_names_and_passwords_are_read_from_elsewhere_and_wrong_ones_end_it(
    tmp_path: Path, hear: Hear, publish: Publish, monkeypatch: pytest.MonkeyPatch
) -> None:
    users = tmp_path / "users"
    subprocess.run(["mosquitto_passwd", "-b", "-c", users, "bob", "open sesame"], check=True, capture_output=True)
    users.chmod(0o644)
    with running(tmp_path, "allow_anonymous false", f"password_file {users}") as broker:
        monkeypatch.setenv("MQTT_PASSWORD", "open sesame")
        (tmp_path / "secret").write_text("open sesame\n")
        heard = hear(broker.name, "x", username="bob", password_env="MQTT_PASSWORD")
        publish(broker.name, "x", username="bob", password_file=str(tmp_path / "secret"))(x=1)
        assert heard.next() == 1
        monkeypatch.setenv("MQTT_PASSWORD", "open barley")
        wrong = hear(broker.name, "x", waits=False, username="bob", password_env="MQTT_PASSWORD")
        eventually(lambda: wrong.raised)
        assert "the broker refuses this client" in str(wrong.raised[0])
        assert "barley" not in str(wrong.raised[0])


def test_a_broker_is_spoken_to_by_tls(tmp_path: Path, hear: Hear, publish: Publish) -> None:
    make_certificate(tmp_path)
    files = (f"certfile {tmp_path}/cert.pem", f"keyfile {tmp_path}/key.pem")
    with running(tmp_path, "allow_anonymous true", *files) as broker:
        address, ca = f"mqtts://{broker.name}", str(tmp_path / "cert.pem")
        heard = hear(address, "x", ca=ca)
        publish(address, "x", ca=ca)(x="safe")
        assert heard.next() == "safe"


REFUSED_AT_ONCE: list[tuple[dict[str, Any], str]] = [
    ({"broker": "http://house"}, "`http://house` is not the address of a broker"),
    ({"broker": "house:many"}, "`house:many` is not the address of a broker"),
    ({"broker": "mqtt://bob:secret@house"}, "address of a broker can't hold"),
    ({"topic": "a/#/b"}, "is not a topic filter"),
    ({"topic": "a+/b"}, "is not a topic filter"),
    ({"topic": ""}, "is not a topic filter"),
    ({"qos": 3}, "`3` is not a quality of service of MQTT"),
    ({"payload": "yaml"}, "`yaml` is not a form of payload"),
    ({"field": []}, r"`\[\]` is not a field"),
    ({"field": {"a": 1}}, "is not a field"),
    ({"field": "a", "payload": "number"}, "a message that is a number has no fields"),
    ({"password": "secret"}, "an environment file can't hold a password"),
    ({"usrname": "bob"}, "did you mean `username`"),
    ({"password_env": "NO_SUCH_VARIABLE"}, "a password without a name"),
    ({"keepalive": -1}, "`-1` can't be a keepalive"),
]


@pytest.mark.parametrize(
    ("params", "message"),
    [
        *REFUSED_AT_ONCE,
        ({"username": "bob", "password_env": "NO_SUCH_VARIABLE"}, "the variable NO_SUCH_VARIABLE is not set"),
        ({"username": "bob", "password_file": "/absent"}, "the password can't be read"),
        ({"ca": "/absent"}, "the files of TLS"),
    ],
)
def test_parameters_that_can_not_be_meant_are_refused(params: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message) as refused:
        Subscriber(**{"broker": "house", "topic": "x", **params})
    assert "secret" not in str(refused.value)


@pytest.mark.parametrize(("params", "message"), REFUSED_AT_ONCE)
def test_they_are_refused_before_a_run_if_the_machine_does_not_matter(params: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        Subscriber.check_params({"broker": "house", "topic": "x", **params})


@pytest.mark.parametrize(
    "will", [{"topic": "a/#"}, {"topic": ""}, {"topic": "a", "qos": 3}, {"payload": "x"}, {"topic": "a", "payload": 3}]
)
def test_a_last_will_that_no_broker_takes_is_refused(will: dict[str, Any]) -> None:
    with pytest.raises(InputError, match="`will`"):
        Publisher("house", "a", will=will)


def test_a_sink_publishes_on_no_wildcard() -> None:
    with pytest.raises(InputError, match="is not a topic to publish on"):
        Publisher("house", "a/#")


def test_a_unit_says_what_it_needs_where_the_library_lacks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cfgplan.extras.is_there", lambda _: False)
    with pytest.raises(InputError, match=r"cfgplan\[mqtt\]"):
        mqtt.Subscriber("house", "x")
