"""The page of a run: what it tells, to whom, and how it looks in a browser."""

from __future__ import annotations

import json
import ssl
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import httpx
import pytest
from cfgplan_runtime.fleet.certificates import make
from cfgplan_runtime.lifecycle.changes import Declare, KillUnit, LoseHost, Withdraw
from cfgplan_runtime.lifecycle.deliberation import Thought
from cfgplan_runtime.lifecycle.reports import Decision, UnitView
from cfgplan_runtime.operating.control_client import connect
from cfgplan_runtime.operating.control_server import ControlServer
from cfgplan_runtime.operating.methods import Methods
from cfgplan_runtime.operating.records import snapshot_record
from cfgplan_runtime.page.server import METHODS, PageServer
from cfgplan_runtime.page.watched import configuration, svg
from fake_manager import DETECTOR, FORESEEN_IN, SNAPSHOT, FakeManager, observation
from operated_world import PATIENCE_S, eventually

from cfgplan.domain import ChangeSet, ComputationUnit, Publication, Stream, Subscription
from cfgplan.errors import InputError

CHROMIUM = Path("/usr/bin/chromium")
UNIT = {"unit": "camera.1"}
MARKUP = "<img src=x onerror=alert(1)> & \\N"


@pytest.fixture
def page(server: ControlServer) -> Iterator[PageServer]:
    assert server is not None
    with PageServer(connect) as serving:
        yield serving


def asking(page: PageServer, method: str, params: dict[str, str] | None = None, **more: str) -> httpx.Response:
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


def test_who_looks_is_told_of_the_run_its_state_and_its_picture(page: PageServer) -> None:
    found: dict[str, Any] = {}
    for kind, data in messages(page):
        found.setdefault(kind, data)
        if {"run", "state", "picture"} <= found.keys():
            break
    assert found["run"]["environment"] == "env.yaml"
    assert [unit["id"] for unit in found["state"]["units"]] == ["camera.1", "detector.1"]
    assert 'id="node detector.1" class="node kept"' in found["picture"]
    assert 'id="arrow camera.1/image detector.1/image" class="edge kept"' in found["picture"]


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
def test_a_page_adds_no_unit_code(page: PageServer, manager: FakeManager, text: str) -> None:
    reply = asking(page, "add", {"text": text})
    assert "--allow-code" in reply.json()["refused"]
    assert manager.requested == []


def test_a_page_adds_targets_and_code_if_it_may(page: PageServer, manager: FakeManager) -> None:
    asking(page, "add", {"name": "more", "text": "targets: []"})
    with PageServer(connect, allows_code=True) as other:
        asking(other, "add", {"name": "spy", "text": CODE})
    assert [added.name for added in manager.requested if isinstance(added, Declare)] == ["more", "spy"]


def test_a_page_does_what_it_lists_and_no_other_method_of_a_run(page: PageServer, manager: FakeManager) -> None:
    others = Methods(manager).by_name().keys() - set(METHODS)
    assert others == {"state", "plan", "apply", "fact", "logs", "events", "topics", "remove_individual"}
    assert {asking(page, method).status_code for method in others} == {400}


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


def test_a_picture_marks_what_an_update_has_changed_and_keeps_markup_text() -> None:
    before = configuration(snapshot_record(SNAPSHOT))
    odd = ComputationUnit(MARKUP, "camera")
    rewired = replace(DETECTOR, subscriptions=(Subscription("image", Stream(MARKUP, "image")),))
    now = configuration(snapshot_record(replace(SNAPSHOT, units=(UnitView(odd), UnitView(rewired)))))
    drawn = svg(before, now)
    assert 'id="node detector.1" class="node rewired"' in drawn
    assert 'id="node camera.1" class="node stopped"' in drawn
    assert "<img" not in drawn
    assert 'class="node kept"' in svg(now, now)


def test_a_unit_that_died_and_is_there_again_is_marked_as_started(page: PageServer, manager: FakeManager) -> None:
    told = messages(page)
    next(picture for kind, picture in told if kind == "picture")
    manager.shows(replace(SNAPSHOT, reviews=(*SNAPSHOT.reviews, replace(SNAPSHOT.reviews[-1], number=2))))
    again = next(picture for kind, picture in told if kind == "picture")
    assert 'id="node detector.1" class="node started"' in again


def test_a_run_that_ends_is_told(page: PageServer, server: ControlServer) -> None:
    told = messages(page)
    next(told)
    server.close()
    assert "ended" in (kind for kind, _ in told)


def test_who_looks_when_the_run_has_ended_is_told_too(page: PageServer, server: ControlServer) -> None:
    server.close()
    eventually(page.watched.has_ended.is_set)
    assert "ended" in (kind for kind, _ in messages(page))


@contextmanager
def browser(page: PageServer, **context: Any) -> Iterator[tuple[Any, list[str]]]:
    """A tab with the page, and what its console complains of."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed (extra dev)")
    if not CHROMIUM.exists():
        pytest.skip("there is no Chromium at /usr/bin/chromium")
    quiet = ["--no-sandbox", "--disable-gpu", "--disable-background-networking", "--disable-component-update"]
    with playwright.sync_playwright() as started:
        chromium = started.chromium.launch(executable_path=str(CHROMIUM), args=[*quiet, "--disable-sync"])
        tab = chromium.new_context(**context).new_page()
        tab.set_default_timeout(PATIENCE_S * 1000)
        wrong: list[str] = []
        tab.on("console", lambda said: wrong.append(said.text) if said.type in ("error", "warning") else None)
        tab.on("pageerror", lambda error: wrong.append(str(error)))
        tab.on("request", lambda one: None if one.url.startswith(page.url[:16]) else wrong.append(one.url))
        tab.goto(page.url)
        tab.wait_for_selector("body[data-frames]")
        yield tab, wrong
        chromium.close()


def test_a_browser_shows_the_run_and_its_buttons_and_keys_work(page: PageServer, manager: FakeManager) -> None:
    with browser(page) as (tab, wrong):
        tab.focus("[id='node camera.1']")
        tab.keyboard.press("Enter")
        assert "30 Hz" in tab.inner_text("#chosen")
        tab.click("#kill")
        eventually(lambda: manager.requested == [KillUnit("camera.1")])
        tab.click("#hosts button")
        eventually(lambda: LoseHost("nao1", "told through the control socket") in manager.requested)
        manager.foreseen = Thought(FORESEEN_IN, FORESEEN_IN, decision=Decision.KEPT, change_set=ChangeSet(), cost_us=0)
        tab.click("#ask-why")
        tab.wait_for_selector("#why li:has-text('camera.1 serves target ball, feeds detector.1/image.')")
        tab.fill("#add-name", "robot3")
        tab.fill("#add-text", "targets: [{label: more, topic: /more, tag: Ball}]")
        tab.click("#add")
        eventually(lambda: any(isinstance(one, Declare) and one.name == "robot3" for one in manager.requested))
        tab.fill("#add-text", "- nothing")
        tab.click("#add")
        tab.wait_for_selector("#answer:has-text('this declares nothing')")
        tab.click("#declared button")
        eventually(lambda: Withdraw("robot2") in manager.requested)
        assert "✗ goal" in tab.inner_text("#targets")
        box = tab.get_attribute("#picture svg", "viewBox")
        tab.focus("#picture")
        tab.keyboard.press("+")
        assert tab.get_attribute("#picture svg", "viewBox") != box
        odd = ComputationUnit(MARKUP, "camera")
        fed = ComputationUnit(
            "detector.1",
            "detector",
            (Subscription("image", Stream(MARKUP, "image")),),
            (Publication("ball", "/result"),),
        )
        units = (UnitView(odd, None, observation(MARKUP)), UnitView(fed, None, observation("detector.1")))
        manager.shows(replace(SNAPSHOT, units=units))
        tab.wait_for_selector("g.node.started")
        assert tab.text_content("g.node.started text").replace("\N{NO-BREAK SPACE}", " ") == f"+ {MARKUP}"
        assert wrong == []


def test_a_narrow_dark_browser_needs_no_scrolling_sideways(page: PageServer) -> None:
    with browser(page, viewport={"width": 390, "height": 800}, color_scheme="dark") as (tab, wrong):
        assert tab.evaluate("document.documentElement.scrollWidth") <= 390
        assert tab.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(13, 17, 23)"
        assert wrong == []
