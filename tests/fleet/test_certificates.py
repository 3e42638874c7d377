"""Certificates of a fleet: what is made, and who gets in with what, over real links on loopback."""

from __future__ import annotations

import contextlib
import json
import os
import queue
import shutil
import socket
from collections.abc import Callable, Iterator
from datetime import datetime, timedelta, tzinfo
from itertools import product
from pathlib import Path
from typing import Literal

import pytest
import zenoh
from cfgplan_runtime.fleet import certificates
from cfgplan_runtime.fleet.agent import Agent
from cfgplan_runtime.fleet.certificates import Validity, ending, make
from cfgplan_runtime.fleet.links import config
from cfgplan_runtime.streams.zenoh_link import Lane, ZenohLink
from cryptography import x509
from small_fleet import PATIENCE_S, Listener, eventually, free_port, small_fleet, source, unit, worker

from cfgplan.cli import main
from cfgplan.domain import ChangeSet
from cfgplan.errors import InputError

ADDRESS = ["127.0.0.1"]
PUBLISHER = ZenohLink.publisher


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("fleet") / "secrets"
    make(folder, {"r1": ADDRESS, "r2": ADDRESS, "base": ADDRESS}, passing_on=["base"], days=2)
    return folder


@pytest.fixture(scope="module")
def strangers(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same names from another authority."""
    folder = tmp_path_factory.mktemp("strangers") / "secrets"
    make(folder, {"r1": ADDRESS, "r2": ADDRESS}, days=2)
    return folder


@contextlib.contextmanager
def session(
    folder: Path | None,
    *,
    listen: int | None = None,
    connect: int | None = None,
    is_known: bool = True,
    mode: Literal["peer", "client"] = "peer",
) -> Iterator[zenoh.Session]:
    def endpoints(port: int | None) -> list[str]:
        return [] if port is None else [f"{'tcp' if folder is None else 'tls'}/127.0.0.1:{port}"]

    given = config(endpoints(listen), endpoints(connect), folder, mode=mode)
    if not is_known:
        tls = given["transport"]["link"]["tls"]
        given["transport"]["link"]["tls"] = {"root_ca_certificate": tls["root_ca_certificate"]}
    # One attempt, which may take long on a busy computer: who is refused raises.
    given["connect"] |= {"timeout_ms": 0, "exit_on_failure": True}
    given["transport"]["unicast"]["open_timeout"] = round(PATIENCE_S * 1000)
    with zenoh.open(zenoh.Config.from_json5(json.dumps(given))) as opened:
        yield opened


def is_refused(folder: Path | None, port: int, *, is_known: bool = True) -> bool:
    """Whether who has these certificates gets no link. Who is not known shows none."""
    try:
        with session(folder, connect=port, is_known=is_known):
            return False
    except zenoh.ZError:
        return True


def connected(one: zenoh.Session) -> None:
    eventually(lambda: bool(one.info.peers_zid()))


def test_files_are_for_their_owner_alone_and_name_the_host(fleet: Path) -> None:
    files = [path for path in fleet.rglob("*") if path.is_file()]
    assert len(files) == 2 + 4 * 4
    assert {path.stat().st_mode & 0o777 for path in files} == {0o600}
    assert {path.stat().st_mode & 0o777 for path in (fleet, *fleet.iterdir()) if path.is_dir()} == {0o700}
    made = x509.load_pem_x509_certificate((fleet / "r1" / "host.pem").read_bytes())
    assert made.subject.rfc4514_string() == "CN=r1"
    names = made.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert names.get_values_for_type(x509.DNSName) == ["r1"]
    assert [str(address) for address in names.get_values_for_type(x509.IPAddress)] == ADDRESS
    uses = made.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value
    assert {use._name for use in uses} == {"clientAuth", "serverAuth"}
    assert timedelta(days=2) < made.not_valid_after_utc - made.not_valid_before_utc < timedelta(days=3)
    assert not (fleet / "r1" / "authority.key").exists()


def test_a_host_that_is_added_is_listed_by_all_and_nothing_else_is_written_over(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "secrets"
    assert main(["certificates", str(folder), "r1=10.0.0.1,r1.local", "base", "--passes-on", "base"]) == 0
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file() and path.suffix != ".json"}
    assert main(["certificates", str(folder), "r1"]) == 30
    assert "r1: exists already, and is not overwritten" in capsys.readouterr().err
    assert main(["certificates", str(folder), "r2"]) == 0
    assert {path: path.read_bytes() for path in before} == before
    for host in ("r1", "r2", "base", "manager"):
        access = json.loads((folder / host / "access.json").read_text())
        assert access == {"hosts": ["base", "manager", "r1", "r2"], "passing_on": ["base"]}


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["../r1"], "'../r1' can't be the name of a host"),
        (["r1=nowhere at all"], "'nowhere at all' can't be the name of a host"),
        (["r1", "r1=10.0.0.1"], "host r1 is named twice"),
        (["r1", "--passes-on", "base"], "base: no such host"),
        (["r1", "--days", "9999999"], "can't be valid for 9999999 days"),
    ],
)
def test_what_makes_no_sense_is_refused_and_nothing_is_written(
    arguments: list[str], says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["certificates", str(tmp_path / "secrets"), *arguments]) == 30
    assert says in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "secrets").exists()


def test_an_authority_that_is_damaged_is_told(fleet: Path, tmp_path: Path) -> None:
    folder = tmp_path / "secrets"
    shutil.copytree(fleet, folder)
    (folder / "authority.key").write_text("nonsense")
    with pytest.raises(InputError, match="the authority can't be read"):
        make(folder, {"r3": ()}, days=1)
    shutil.copy(fleet / "r1" / "host.key", folder / "authority.key")
    with pytest.raises(InputError, match="the authority's key is not that of its certificate"):
        make(folder, {"r3": ()}, days=1)


def test_a_folder_that_lacks_a_file_is_told_with_its_name(fleet: Path, tmp_path: Path) -> None:
    shutil.copytree(fleet / "r1", tmp_path / "r1")
    (tmp_path / "r1" / "host.key").unlink()
    with pytest.raises(InputError, match=r"host.key: there is no such file"):
        config(["tls/127.0.0.1:7447"], certificates=tmp_path / "r1")
    (tmp_path / "r1" / "access.json").write_text('{"hosts": 3}')
    with pytest.raises(InputError, match=r"access.json: can't be read"):
        config(["tls/127.0.0.1:7447"], certificates=tmp_path / "r1")


def test_who_has_no_certificate_a_strangers_or_an_expired_one_gets_no_link(
    fleet: Path, strangers: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class LastYear(datetime):
        @classmethod
        def now(cls, tz: tzinfo | None = None) -> datetime:  # type: ignore[override]
            return datetime.now(tz) - timedelta(days=365)

    for name in ("authority.pem", "authority.key"):
        shutil.copy(fleet / name, tmp_path / name)
    monkeypatch.setattr(certificates, "datetime", LastYear)
    make(tmp_path, {"r2": ADDRESS}, days=2)
    shutil.copytree(fleet / "r2", tmp_path / "mixed")
    shutil.copy(strangers / "authority.pem", tmp_path / "mixed" / "authority.pem")
    port = free_port()
    with session(fleet / "r1", listen=port):
        assert not is_refused(fleet / "r2", port)
        assert is_refused(fleet / "r2", port, is_known=False)
        assert is_refused(strangers / "r2", port)
        assert is_refused(tmp_path / "r2", port)
        assert is_refused(tmp_path / "mixed", port)  # it trusts the others' authority, and refuses this agent itself
        assert is_refused(None, port)


def aged(folder: Path, monkeypatch: pytest.MonkeyPatch, *, by: timedelta, days: int) -> Path:
    """The folder of r1 in a fleet whose certificates were made so long ago, for so many days."""

    class Then(datetime):
        @classmethod
        def now(cls, tz: tzinfo | None = None) -> datetime:  # type: ignore[override]
            return datetime.now(tz) - by

    with monkeypatch.context() as then:
        then.setattr(certificates, "datetime", Then)
        make(folder, {"r1": ADDRESS}, days=days)
    return folder / "r1"


def test_a_certificate_that_has_ended_is_refused_with_its_file_and_the_mend(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = aged(tmp_path, monkeypatch, by=timedelta(days=3), days=2)
    assert main(["agent", "--name", "r1", "--certificates", str(folder), "--listen", "tls/127.0.0.1:0"]) == 30
    said = " ".join(capsys.readouterr().err.split())
    assert f"{folder}/host.pem: this certificate was valid until " in said
    assert "make a new folder by `cfgplan certificates`" in said


def test_a_certificate_that_ends_within_a_month_is_told_once_a_day(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fresh = Validity(aged(tmp_path / "new", monkeypatch, by=timedelta(), days=40), "r1")
    assert fresh.warning() is None
    validity = Validity(aged(tmp_path / "old", monkeypatch, by=timedelta(days=330), days=340), "r1")
    told = validity.warning()
    assert told is not None
    assert (told.host, told.days_left) == ("r1", 9)
    assert "the certificate of r1 ends on " in ending(told)
    assert validity.warning() is None
    validity.tell_again()
    assert validity.warning() == told


def test_an_agent_ends_with_its_certificate_and_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    life = timedelta(days=1) - timedelta(seconds=8)
    folder, runs = aged(tmp_path / "secrets", monkeypatch, by=life, days=1), tmp_path / "runs"
    said: list[str] = []
    runs.mkdir()
    agent = Agent("r1", listen=[f"tls/127.0.0.1:{free_port()}"], certificates=folder, base=runs, say=said.append)
    with pytest.raises(InputError, match=r"host\.pem: this certificate was valid until"):
        agent.run()
    assert said[0].startswith("the certificate of r1 ends on ")
    assert "(0 days left)" in said[0]


def test_an_agent_outlives_garbage(fleet: Path) -> None:
    port = free_port()
    with session(fleet / "r1", listen=port) as agent:
        for garbage in (os.urandom(4096), b"GET / HTTP/1.1\r\n\r\n", b""):
            with socket.create_connection(("127.0.0.1", port), PATIENCE_S) as plain:
                plain.sendall(garbage)
                plain.shutdown(socket.SHUT_WR)
                with contextlib.suppress(ConnectionError):
                    while plain.recv(4096):
                        pass
        with session(fleet / "r2", connect=port) as other:
            connected(other)
            assert [str(zid) for zid in agent.info.peers_zid()] == [str(other.info.zid())]


def heard_by(agent: zenoh.Session) -> queue.SimpleQueue[str]:
    heard: queue.SimpleQueue[str] = queue.SimpleQueue()
    agent.declare_subscriber(
        "cfgplan/**", lambda sample: heard.put(str(sample.key_expr)), allowed_origin=zenoh.Locality.REMOTE
    )
    return heard


def all_heard(heard: queue.SimpleQueue[str], writer: zenoh.Session, last: str) -> set[str]:
    """What has been heard once `last`, put again and again by the writer, is."""
    keys: set[str] = set()

    def comes() -> bool:
        writer.put(last, b"")
        with contextlib.suppress(queue.Empty):
            keys.add(heard.get(timeout=0.05))
        return last in keys

    eventually(comes)
    return keys


def test_a_host_writes_its_own_keys_and_no_others(fleet: Path) -> None:
    port = free_port()
    with session(fleet / "r1", listen=port) as agent, session(fleet / "r2", connect=port) as other:
        heard = heard_by(agent)
        alive: queue.SimpleQueue[str] = queue.SimpleQueue()
        agent.liveliness().declare_subscriber("cfgplan/**", lambda sample: alive.put(str(sample.key_expr)))
        connected(other)
        assert all_heard(heard, other, "cfgplan/r2/first") == {"cfgplan/r2/first"}
        for key in ("cfgplan/r1/x", "cfgplan/manager/x", "cfgplan/base/x", "other/r2/x", "cfgplan/r2x/x"):
            other.put(key, b"")
            tokens = [other.liveliness().declare_token(key)]
        tokens.append(other.liveliness().declare_token("cfgplan/r2/alive"))
        assert all_heard(heard, other, "cfgplan/r2/last") <= {"cfgplan/r2/first", "cfgplan/r2/last"}
        assert alive.get(timeout=PATIENCE_S) == "cfgplan/r2/alive"
        assert alive.empty()
        assert tokens


def test_what_other_hosts_write_comes_through_who_passes_it_on_and_through_nobody_else(fleet: Path) -> None:
    ports = {host: free_port() for host in ("base", "r2")}
    for middle, passes in (("base", True), ("r2", False)):
        with (
            session(fleet / middle, listen=ports[middle]) as third,
            session(fleet / "r1", connect=ports[middle], mode="client") as agent,
            session(fleet / "manager", connect=ports[middle], mode="client") as manager,
        ):
            heard, heard_between = heard_by(agent), heard_by(third)
            connected(agent)
            connected(manager)
            if passes:
                assert all_heard(heard, manager, "cfgplan/manager/order") == {"cfgplan/manager/order"}
            else:
                assert all_heard(heard, third, f"cfgplan/{middle}/first") == {f"cfgplan/{middle}/first"}
                assert all_heard(heard_between, manager, "cfgplan/manager/order") == {"cfgplan/manager/order"}
                assert "cfgplan/manager/order" not in all_heard(heard, third, f"cfgplan/{middle}/last")


def test_a_certificate_of_the_authority_with_a_name_that_is_not_listed_may_do_nothing(
    fleet: Path, tmp_path: Path
) -> None:
    """It was made for another fleet of the same authority, or its host was taken from the list."""
    folder = tmp_path / "secrets"
    shutil.copytree(fleet, folder)
    make(folder, {"r3": ADDRESS}, days=2)
    port = free_port()
    with (
        session(fleet / "r1", listen=port) as agent,
        session(folder / "r3", connect=port) as stranger,
        session(fleet / "r2", connect=port) as other,
    ):
        heard, overheard = heard_by(agent), heard_by(stranger)
        connected(other)
        connected(stranger)
        for _ in range(20):
            stranger.put("cfgplan/r3/x", b"")
            agent.put("cfgplan/r1/x", b"")
        assert all_heard(heard, other, "cfgplan/r2/last") == {"cfgplan/r2/last"}
        assert overheard.empty()


@pytest.fixture
def orders(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, bytes, bytes]]:
    """Key, head and payload of all that a link of this process puts, as by somebody who hears it all."""
    heard: list[tuple[str, bytes, bytes]] = []

    def overheard(link: ZenohLink, key: str, lane: Lane) -> Callable[[bytes, bytes], None]:
        put = PUBLISHER(link, key, lane)

        def hear(head: bytes, payload: bytes) -> None:
            heard.append((key, head, payload))
            put(head, payload)

        return hear

    monkeypatch.setattr(ZenohLink, "publisher", overheard)
    return heard


def test_garbage_at_the_keys_of_orders_and_answers_changes_nothing(orders: list[tuple[str, bytes, bytes]]) -> None:
    units = unit("count.1", "r1"), unit("work.1", "r1", topic="/result", x="count.1/n")
    with (
        small_fleet("r1") as fleet,
        contextlib.closing(ZenohLink(config(connect=fleet.agents.endpoints))) as stranger,
        fleet.runtime(source(), worker()) as runtime,
    ):
        runtime.apply(ChangeSet(units))
        listener = Listener(runtime)
        listener.await_more(10)
        sessions = {key.rpartition("/")[2] for key, *_ in orders} | {"0-strange-1-0", "nonsense", "9-x-y", "9-x-y-z"}
        for way, session in product(("manager/say/r1", "manager/heard/r1", "r1/say/manager"), sessions):
            for garbage in (b"", b"x", bytes(100), os.urandom(5)):
                PUBLISHER(stranger, f"cfgplan/{way}/{session}", "orders")(garbage, garbage)
        eventually(lambda: list(stranger.ask("cfgplan/r1/clock/*", PATIENCE_S)) != [])  # what was put before has come
        runtime.apply(ChangeSet(started=(unit("count.2", "r1"),)))
        listener.await_more(10)
        assert listener.values == list(range(listener.values[0], listener.values[0] + len(listener.values)))
        assert sorted(fleet.units()) == ["count.1", "count.2", "work.1"]


def test_orders_that_are_put_again_are_not_carried_out_again(orders: list[tuple[str, bytes, bytes]]) -> None:
    with (
        small_fleet("r1") as fleet,
        contextlib.closing(ZenohLink(config(connect=fleet.agents.endpoints))) as spy,
        fleet.runtime(source()) as runtime,
    ):
        runtime.apply(ChangeSet(started=(unit("count.1", "r1"),)))
        runtime.apply(ChangeSet(stopped=("count.1",)))
        known = list(orders)
        assert sum(b"StartOrder" in payload for _, _, payload in known) == 1
        for key, head, payload in known:
            PUBLISHER(spy, key, "orders")(head, payload)
        eventually(lambda: list(spy.ask("cfgplan/r1/clock/*", PATIENCE_S)) != [])  # what was put before has come
        runtime.apply(ChangeSet(started=(unit("count.2", "r1"),)))
        assert fleet.units() == ["count.2"]
