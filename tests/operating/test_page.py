"""The page of a run: what it tells, to whom, and how it looks in a browser."""

from __future__ import annotations

import json
import ssl
import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import httpx
import pytest
from cfgplan_runtime.fleet.certificates import make
from cfgplan_runtime.lifecycle.changes import Declare, KillUnit, LoseHost
from cfgplan_runtime.lifecycle.reports import UnitEvent
from cfgplan_runtime.operating.control_client import connect
from cfgplan_runtime.operating.control_server import ControlServer
from cfgplan_runtime.operating.methods import Methods
from cfgplan_runtime.operating.records import report_record
from cfgplan_runtime.page.server import METHODS, PageServer
from cfgplan_runtime.supervision.events import UnitDied
from fake_manager import SNAPSHOT, FakeManager
from operated_world import PATIENCE_S, eventually

from cfgplan.errors import InputError

CHROMIUM = Path("/usr/bin/chromium")
UNIT = {"unit": "camera.1"}
MARKUP = "<img src=x onerror=alert(1)> & \\N"


@pytest.fixture
def page(server: ControlServer) -> Iterator[PageServer]:
    assert server is not None
    with PageServer(connect) as serving:
        yield serving


def asking(page: PageServer, method: str, params: dict[str, Any] | None = None, **more: str) -> httpx.Response:
    origin, _, token = page.url.partition("/#")
    headers = {"Origin": origin, "X-Token": token, **more}
    return httpx.post(f"{origin}/do", json={"method": method, "params": params or UNIT}, headers=headers)


def messages(page: PageServer) -> Iterator[tuple[str, Any]]:
    with httpx.stream("GET", page.url.partition("#")[0] + "messages", timeout=PATIENCE_S) as told:
        kind = ""
        for line in told.iter_lines():
            name, _, value = line.partition(": ")
            if name == "event":
                kind = value
            elif name == "data":
                yield kind, json.loads(value)


def test_a_death_is_shown_at_once_and_not_with_the_next_refresh(
    server: ControlServer, manager: FakeManager, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cfgplan_runtime.page.watched.REFRESH_S", 100 * PATIENCE_S)
    with PageServer(connect) as page:
        states = ([unit["id"] for unit in data["units"]] for kind, data in messages(page) if kind == "state")
        assert next(states) == ["camera.1", "detector.1"]
        manager.shows(replace(SNAPSHOT, units=SNAPSHOT.units[:1]))
        server.publish(report_record(UnitEvent(UnitDied("detector.1", "killed by signal 9"))))
        assert next(states) == ["camera.1"]


def test_who_looks_is_told_of_the_run_its_state_its_health_and_its_reviews(page: PageServer) -> None:
    found: dict[str, Any] = {}
    for kind, data in messages(page):
        found.setdefault(kind, data)
        if {"run", "state", "reviews"} <= found.keys():
            break
    assert found["run"]["environment"] == "env.yaml"
    assert [unit["id"] for unit in found["state"]["units"]] == ["camera.1", "detector.1"]
    assert [review["number"] for review in found["reviews"]] == [1]
    assert found["state"]["health"] == {
        "level": "bad",
        "says": "1 of 2 targets is not met. It is goal: nothing gives Goal.",
    }


def test_who_has_the_token_may_change_the_run(page: PageServer, manager: FakeManager) -> None:
    reply = asking(page, "kill")
    assert (reply.status_code, manager.requested) == (200, [KillUnit("camera.1")])


@pytest.mark.parametrize(
    ("method", "more", "status"),
    [
        ("kill", {"X-Token": "wrong"}, 403),
        ("kill", {"Origin": "http://elsewhere"}, 403),
        ("kill", {"Host": "elsewhere"}, 400),
        ("dance", {}, 400),
    ],
)
def test_nobody_else_may_and_only_what_the_page_does(
    page: PageServer, manager: FakeManager, method: str, more: dict[str, str], status: int
) -> None:
    assert asking(page, method, **more).status_code == status
    assert manager.requested == []


def test_what_the_run_refuses_is_an_answer(page: PageServer, manager: FakeManager) -> None:
    reply = asking(page, "lose_host")
    assert reply.status_code == 200
    assert "there is no parameter `unit`" in reply.json()["refused"]
    assert manager.requested == []


CODE = "transformations: [{label: spy, source: 'spy.py:Spy', outputs: {o: O}}]"


@pytest.mark.parametrize("text", [CODE, '{"transformations": [{"label": "spy", "source": "program:./spy"}]}'])
def test_a_page_adds_and_supposes_no_unit_code(page: PageServer, manager: FakeManager, text: str) -> None:
    for reply in (
        asking(page, "add", {"text": text}),
        asking(page, "what_if", {"change": "add", "params": {"text": text}}),
    ):
        assert "--allow-code" in reply.json()["refused"]
    assert (manager.requested, manager.supposed) == ([], [])


def test_a_supposed_change_needs_the_token_and_asks_for_no_change(page: PageServer, manager: FakeManager) -> None:
    supposed = {"change": "lose_host", "params": {"host": "nao1"}}
    assert asking(page, "what_if", supposed, **{"X-Token": "wrong"}).status_code == 403
    assert "no time" in asking(page, "what_if", supposed).json()["says"]
    assert (manager.supposed, manager.requested) == ([LoseHost("nao1", "told through the control socket")], [])


def test_only_a_page_that_looks_may_peek(page: PageServer) -> None:
    origin = page.url.partition("#")[0]

    def status(**asked: object) -> int:
        return httpx.post(f"{origin}peek", json=asked).status_code

    assert status(viewer="somebody", stream="/result") == 403
    assert status(viewer="somebody", stream=3) == 400
    told = messages(page)
    viewer = next(told)[1]["viewer"]
    assert status(viewer=viewer, stream="/nothing") == 200
    failed = next(data["failed"] for kind, data in told if kind == "peek")
    assert "nothing publishes topic '/nothing'" in failed
    assert status(viewer=viewer, stream=None) == 200


def test_a_page_adds_targets_and_code_if_it_may(page: PageServer, manager: FakeManager) -> None:
    asking(page, "add", {"name": "more", "text": "targets: []"})
    with PageServer(connect, allows_code=True) as other:
        asking(other, "add", {"name": "spy", "text": CODE})
    assert [added.name for added in manager.requested if isinstance(added, Declare)] == ["more", "spy"]


def test_a_page_does_what_it_lists_and_no_other_method_of_a_run(page: PageServer, manager: FakeManager) -> None:
    others = Methods(manager).by_name().keys() - set(METHODS)
    assert others == {
        "state",
        "plan",
        "apply",
        "fact",
        "logs",
        "events",
        "topics",
        "tap",
        "remove_individual",
    }
    assert {asking(page, method).status_code for method in others} == {400}


def test_a_peek_ends_with_the_page_that_looks(page: PageServer) -> None:
    def peeks() -> list[str]:
        return [thread.name for thread in threading.enumerate() if thread.name.startswith("cfgplan-peek")]

    origin = page.url.partition("#")[0]
    with httpx.stream("GET", f"{origin}messages", timeout=PATIENCE_S) as told:
        lines = told.iter_lines()
        run = json.loads(next(line for line in lines if line.startswith("data")).partition(": ")[2])
        httpx.post(f"{origin}peek", json={"viewer": run["viewer"], "stream": "/nothing"})
        assert peeks() == ["cfgplan-peek /nothing"]
    eventually(lambda: not peeks())


def test_a_page_beyond_loopback_is_served_by_tls_or_refused(server: ControlServer, tmp_path: Path) -> None:
    assert server is not None
    with pytest.raises(InputError, match="--certificates"):
        PageServer(connect, "0.0.0.0")
    make(tmp_path / "secrets", {"here": ["127.0.0.1"]}, days=1)
    with PageServer(connect, "0.0.0.0", certificates=tmp_path / "secrets" / "here") as page:
        port = page.url.partition("/#")[0].rpartition(":")[2]
        trusted = ssl.create_default_context(cafile=tmp_path / "secrets" / "here" / "authority.pem")
        assert page.url.startswith("https://")
        assert httpx.get(f"https://127.0.0.1:{port}/", verify=trusted).status_code == 200
        assert httpx.get(f"https://127.0.0.1:{port}/messages", verify=trusted).status_code == 403


def test_a_page_loads_nothing_from_elsewhere_and_runs_no_other_script(page: PageServer) -> None:
    policy = httpx.get(page.url).headers["content-security-policy"]
    assert "default-src 'none'" in policy
    assert "script-src 'self'" in policy


@pytest.mark.parametrize("number", ["", "-1", "1.5", "x", "9" * 5000])
def test_a_moment_is_asked_for_by_the_number_of_a_review(page: PageServer, number: str) -> None:
    answer = httpx.get(page.url.partition("#")[0] + "moment", params={"review": number})
    assert (answer.status_code, answer.json()) == (400, {"message": "this is not a request"})


def test_a_moment_that_is_not_kept_is_refused(page: PageServer) -> None:
    answer = httpx.get(page.url.partition("#")[0] + "moment", params={"review": "77"})
    assert answer.status_code == 200
    assert "the state after review 77 is not kept" in answer.json()["refused"]


def test_an_address_that_is_taken_is_refused_from_the_beginning(server: ControlServer) -> None:
    assert server is not None
    page = PageServer(connect)
    port = int(page.url.rpartition(":")[2].partition("/")[0])
    with page, pytest.raises(InputError, match="name another port"):
        PageServer(connect, port=port)


def test_a_page_that_is_closed_leaves_no_thread_behind(server: ControlServer) -> None:
    assert server is not None
    before = set(threading.enumerate())
    with PageServer(connect) as page:
        assert next(messages(page))[0] == "run"
    eventually(lambda: set(threading.enumerate()) <= before)


def test_a_run_that_ends_is_told(page: PageServer, server: ControlServer) -> None:
    told = messages(page)
    next(told)
    server.close()
    assert "ended" in (kind for kind, _ in told)


def test_who_looks_when_the_run_has_ended_is_told_too(page: PageServer, server: ControlServer) -> None:
    server.close()
    eventually(page.watched.has_ended.is_set)
    assert "ended" in (kind for kind, _ in messages(page))
