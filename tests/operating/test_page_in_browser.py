"""The page in a browser: legible at every size, still while figures change, and what its buttons do."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest
from browsed import assert_legible, await_frames, await_so, browser
from cfgplan_runtime.lifecycle.changes import Declare, KillUnit, LoseHost, Withdraw
from cfgplan_runtime.lifecycle.deliberation import Findings
from cfgplan_runtime.lifecycle.reports import Decision, Reviewed, TargetView, UnitView
from cfgplan_runtime.operating.control_client import connect
from cfgplan_runtime.operating.control_server import ControlServer
from cfgplan_runtime.operating.methods import Methods
from cfgplan_runtime.operating.moments import Moments
from cfgplan_runtime.operating.operation import Operation, Settings
from cfgplan_runtime.page.server import PageServer
from cfgplan_runtime.streams.run_folder import RunFolder, base_folder, topics_of
from cfgplan_runtime.streams.topic_names import TAPS
from fake_manager import DETECTOR, FORESEEN_IN, SNAPSHOT, FakeManager, observation
from operated_world import PATIENCE_S, eventually, write_world
from page_world import building, with_a_kill

from cfgplan import api
from cfgplan.amounts import core_share, rate, span
from cfgplan.domain import ChangeSet, ComputationUnit, Host, Publication, Stream, Subscription
from cfgplan.unmet import Lack, Reason

MARKUP = "<img src=x onerror=alert(1)> & \\N"
WINDOWS = [{"width": 1400, "height": 1500}, {"width": 400, "height": 3000}]
"""High enough for the whole page: the browser reports shifts only of what the window shows."""


@pytest.fixture
def page(server: ControlServer) -> Iterator[PageServer]:
    assert server is not None
    with PageServer(connect) as serving:
        yield serving


@contextmanager
def page_of_a_run(folder: Path) -> Iterator[tuple[Operation, PageServer]]:
    env = write_world(folder)
    with Operation(api.load(env), env, Settings()) as operation, PageServer(lambda: connect(operation.id)) as serving:
        assert operation.begun.wait(PATIENCE_S)
        yield operation, serving


@pytest.mark.parametrize("window", WINDOWS, ids=["wide", "narrow"])
@pytest.mark.parametrize("units", [3, 31, 151])
def test_no_text_lies_on_another_or_outside_and_no_figure_moves_anything(
    page: PageServer, manager: FakeManager, units: int, window: dict[str, int]
) -> None:
    manager.shows(building(units))
    with browser(page, viewport=window, color_scheme="dark") as (tab, wrong):
        await_frames(tab)
        assert_legible(tab)
        tab.emulate_media(color_scheme="light")
        assert_legible(tab)
        tab.evaluate("shifts.length = 0")
        for second in range(1, 4):
            manager.shows(building(units, second))
            await_frames(tab)
        assert tab.evaluate("shifts") == []
        assert_legible(tab)
        assert tab.get_attribute("#health", "data-level") == "well"
        manager.shows(with_a_kill(building(units, 4)))
        tab.wait_for_selector("#health[data-level=bad]")
        assert f"1 of {(units - 1) // 2 + 1} targets is not met. It is comfort of room0" in tab.inner_text("#health")
        assert_legible(tab)
        assert wrong == []


@pytest.mark.parametrize("width", [390, 1000, 1440])
def test_the_figures_of_the_head_are_shown_whole(page: PageServer, manager: FakeManager, width: int) -> None:
    manager.shows(building(3))
    with browser(page, viewport={"width": width, "height": 900}) as (tab, wrong):
        await_frames(tab)
        tab.evaluate("document.querySelectorAll('#tiles dd').forEach((one) => one.textContent = '0.424 % of a core')")
        assert tab.evaluate("[...document.querySelectorAll('#tiles dd')].every((x) => x.scrollWidth <= x.clientWidth)")
        assert wrong == []


@pytest.mark.parametrize("window", WINDOWS, ids=["wide", "narrow"])
def test_equal_units_are_one_node_that_unfolds_and_folds_again(
    page: PageServer, manager: FakeManager, window: dict[str, int]
) -> None:
    manager.shows(building(151))
    with browser(page, viewport=window) as (tab, wrong):
        folded = tab.locator("g.node").count()
        assert folded <= 8
        tab.focus("g.node:has-text('comfort × 75')")
        tab.keyboard.press("Enter")
        await_so(tab, f"document.querySelectorAll('g.node').length >= {folded + 74}")
        assert_legible(tab)
        tab.click("#unfolded button")
        await_so(tab, f"document.querySelectorAll('g.node').length === {folded}")
        tab.select_option("#fold-by", "host")
        tab.wait_for_selector("g.node:has-text('roof × 50')")
        assert_legible(tab)
        tab.select_option("#fold-by", "none")
        await_so(tab, "document.querySelectorAll('g.node').length === 227")
        assert_legible(tab)
        assert wrong == []


@pytest.mark.parametrize("window", WINDOWS, ids=["wide", "narrow"])
@pytest.mark.parametrize("units", [3, 31, 151])
def test_the_time_line_shows_the_picture_and_the_health_of_each_review(
    run_folder: RunFolder, manager: FakeManager, units: int, window: dict[str, int]
) -> None:
    moments = Moments(lambda: (manager.snapshot(), {}))
    manager.shows(building(units))
    well = manager.snapshot()
    moments.hear(Reviewed(well.reviews[-1]))
    killed = with_a_kill(well)
    manager.shows(killed)
    moments.hear(Reviewed(killed.reviews[-1]))
    healed = replace(well, reviews=(*killed.reviews, replace(well.reviews[0], number=3, time_s=1_700_000_070.5)))
    manager.shows(healed)
    moments.hear(Reviewed(healed.reviews[-1]))
    methods = Methods(manager, moments=moments).by_name()
    with (
        ControlServer(run_folder.path, methods, "/robots/env.yaml"),
        PageServer(connect) as page,
        browser(page, viewport=window, color_scheme="dark") as (tab, wrong),
    ):
        await_frames(tab)
        assert (tab.get_attribute("#health", "data-level"), tab.inner_text("#scrubbed")) == ("well", "now")
        tab.evaluate("shifts.length = 0")
        tab.click("#earlier")
        tab.click("#earlier")
        tab.wait_for_selector("#health[data-level=bad]")
        assert not [one for one in tab.evaluate("shifts") if "scrub" in one or "earlier" in one]
        assert "Review 2: nothing to change" in tab.inner_text("#moment-says")
        assert tab.inner_text("#tile-units") == str(units - 1)
        tab.wait_for_selector("g.node.unmet:has-text('not met'), g.node.unmet:has-text('comfort of room0')")
        tab.click("#units .name")
        assert not any(tab.is_visible(part) for part in ("#chosen-acts", "#acts", "#adding"))
        assert_legible(tab)
        await_frames(tab)  # what comes from the run meanwhile changes nothing
        assert tab.get_attribute("#health", "data-level") == "bad"
        assert tab.get_attribute("#to-now", "data-level") == "well"
        tab.emulate_media(color_scheme="light")
        tab.click("#earlier")
        tab.wait_for_selector("g.node.started")
        assert tab.get_attribute("#health", "data-level") == "well"
        assert tab.is_disabled("#earlier")
        assert_legible(tab)
        tab.click("#to-now")
        tab.wait_for_selector("#moment", state="hidden")
        assert (tab.inner_text("#tile-units"), tab.is_disabled("#later")) == (str(units), True)
        tab.click("#timeline li.kept summary")
        tab.click("#timeline li.kept .look")
        tab.wait_for_selector("#health[data-level=bad]")
        tab.keyboard.press("Escape")
        tab.wait_for_selector("#health[data-level=well]")
        assert wrong == []


def test_a_moment_that_the_run_does_not_keep_is_told(page: PageServer) -> None:
    with browser(page) as (tab, wrong):
        tab.click("#earlier")
        tab.wait_for_selector("#moment-says:has-text('the state after review 1 is not kept')")
        assert wrong == []


def test_a_search_and_only_unmet_shorten_the_lists(page: PageServer, manager: FakeManager) -> None:
    manager.shows(with_a_kill(building(31)))
    with browser(page) as (tab, _):
        assert tab.locator("#targets .row").count() == 16
        tab.check("#only-unmet")
        assert tab.locator("#targets .row").count() == 1
        tab.uncheck("#only-unmet")
        tab.fill("#find", "room7")
        assert (tab.locator("#targets .row").count(), tab.locator("#units .row").count()) == (1, 2)


def test_a_reason_of_several_targets_is_told_at_the_first_that_is_shown(page: PageServer, manager: FakeManager) -> None:
    views = [
        TargetView(one, "T", f"/{one}", 0, None, Reason(Lack("no output matches"), one, "T")) for one in ("a", "b")
    ]
    manager.shows(replace(building(3), targets=tuple(views)))
    with browser(page) as (tab, _):
        about = tab.locator("#targets .about")
        assert about.all_inner_texts() == ["no output matches", "as a"]
        tab.fill("#find", "b")
        assert about.all_inner_texts() == ["no output matches"]


def test_all_hosts_are_listed_with_their_number_of_units(page: PageServer, manager: FakeManager) -> None:
    hosts = tuple(map(Host, ("attic", "nao1", "shed")))
    manager.shows(replace(SNAPSHOT, environment=replace(SNAPSHOT.environment, hosts=hosts), lost_hosts=("attic",)))
    with browser(page) as (tab, wrong):
        rows = tab.locator("#hosts li > span").all_inner_texts()
        assert rows == ["attic · gone", "nao1 · 1 unit", "shed · 0 units"]
        assert wrong == []


def test_figures_are_those_of_the_terminal(page: PageServer) -> None:
    seconds = [0, 0.000828, 0.0124, 0.9994, 0.9996, 4.24, 9.96, 45, 180, 7500, 7200, 273600]
    hertz = [0, 100.2, 2.5, 0.98, 0.125, 1 / 600]
    shares = [0, 50_000, 764, 123_456, 1_500_000, 2_350_000]
    with browser(page) as (tab, _):
        figures = "async ([name, values]) => values.map((await import('/figures.js'))[name])"
        assert tab.evaluate(figures, ["span", seconds]) == list(map(span, seconds))
        assert tab.evaluate(figures, ["rate", hertz]) == list(map(rate, hertz))
        assert tab.evaluate(figures, ["coreShare", shares]) == list(map(core_share, shares))
        costs_us = [7_700_000_000, 48_200_000, 764, 0]
        shown = ["7700 s of CPU", "48.2 s of CPU", "0.000764 s of CPU", "0 s of CPU"]
        assert tab.evaluate(figures, ["cost", costs_us]) == shown


def test_its_buttons_and_keys_work(page: PageServer, manager: FakeManager) -> None:
    with browser(page) as (tab, wrong):
        tab.focus("[id='unit camera.1']")
        tab.keyboard.press("Enter")
        assert "30 Hz" in tab.inner_text("#chosen-facts")
        tab.click("#chosen .kill")
        eventually(lambda: manager.requested == [KillUnit("camera.1")])
        manager.foreseen = Findings(FORESEEN_IN, FORESEEN_IN, decision=Decision.KEPT, change_set=ChangeSet(), cost_us=0)
        tab.click("#chosen .ask-why")
        tab.wait_for_selector("#why li:has-text('camera.1 serves target ball, feeds detector.1/image.')")
        tab.keyboard.press("Escape")
        assert not tab.is_visible("#chosen")
        tab.fill("#add-name", "robot3")
        tab.fill("#add-text", "targets: [{label: more, topic: /more, tag: Ball}]")
        tab.click("#add")
        await_so(tab, "document.getElementById('add-text').value === ''")
        assert any(isinstance(one, Declare) and one.name == "robot3" for one in manager.requested)
        tab.fill("#add-text", "- nothing")
        tab.click("#add")
        tab.wait_for_selector("#answer:has-text('this declares nothing')")
        tab.click("#declared button")
        eventually(lambda: Withdraw("robot2") in manager.requested)
        assert "✗ goal" in tab.inner_text("#targets")
        tab.click("#timeline summary")
        assert "no plan is cheaper" in tab.inner_text("#timeline dl")
        assert wrong == []


def test_nothing_is_carried_out_before_the_second_press(page: PageServer, manager: FakeManager) -> None:
    manager.foreseen = Findings(
        FORESEEN_IN,
        FORESEEN_IN,
        decision=Decision.APPLIED,
        change_set=ChangeSet(stopped=("detector.1",)),
        cost_us=500_000,
        is_proven=True,
        unmet={"ball": "host nao1 is gone"},
    )
    lost = LoseHost("nao1", "told through the control socket")
    with browser(page) as (tab, wrong):
        tab.click("#hosts button")
        tab.wait_for_selector("#supposition dl")
        told = tab.inner_text("#supposition")
        for part in ("2 s of CPU", "0.5 s of CPU", "−1.5 s of CPU", "proven: no plan is cheaper", "host nao1 is gone"):
            assert part in told
        assert (manager.supposed, manager.requested) == ([lost], [])
        tab.click("#supposition button:has-text('Do it')")
        eventually(lambda: manager.requested == [lost])
        assert wrong == []


def test_a_page_without_the_token_shows_everything_and_changes_nothing(page: PageServer) -> None:
    with browser(page) as (tab, wrong):
        tab.goto("about:blank")
        tab.goto(page.url.partition("#")[0])
        tab.wait_for_selector("#picture svg")
        tab.click("[id='unit camera.1']")
        assert tab.inner_text("#chosen-acts") == ""
        assert not any(tab.is_visible(part) for part in ("#supposed", "#adding", "#acts", "#hosts button"))
        assert wrong == []


def test_names_are_text_and_new_units_are_marked(page: PageServer, manager: FakeManager) -> None:
    odd = ComputationUnit(MARKUP, "camera")
    fed = ComputationUnit(
        "detector.1", "detector", (Subscription("image", Stream(MARKUP, "image")),), (Publication("ball", "/result"),)
    )
    units = (UnitView(odd, None, observation(MARKUP)), UnitView(fed, None, observation("detector.1")))
    review = replace(SNAPSHOT.reviews[-1], number=2, change_set=ChangeSet(started=(odd,), rewired=(fed,)))
    with browser(page) as (tab, wrong):
        manager.shows(replace(SNAPSHOT, units=units, reviews=(*SNAPSHOT.reviews, review)))
        tab.wait_for_selector("g.node.started")
        assert MARKUP in tab.text_content("g.node.started title")
        assert tab.text_content("g.node.rewired text") == "~ detector.1"
        assert tab.text_content("g.node.stopped text") == "− camera.1"
        assert tab.locator("img").count() == 0
        assert wrong == []


def test_a_unit_that_died_and_is_there_again_is_marked_as_started(page: PageServer, manager: FakeManager) -> None:
    with browser(page) as (tab, _):
        manager.shows(replace(SNAPSHOT, reviews=(*SNAPSHOT.reviews, replace(SNAPSHOT.reviews[-1], number=2))))
        tab.wait_for_selector("g.node.started:has-text('detector.1')")


def test_a_fault_of_unit_code_has_its_source_line(page: PageServer, manager: FakeManager, tmp_path: Path) -> None:
    code = tmp_path / "units.py"
    code.write_text("def camera():\n    raise ValueError('five')\n")
    error = f'Traceback (most recent call last):\n  File "{code}", line 2, in camera\n    raise ...\nValueError: five\n'
    seen = replace(observation("detector.1"), errors=2, last_error=error)
    manager.shows(replace(SNAPSHOT, units=(SNAPSHOT.units[0], UnitView(DETECTOR, None, seen))))
    with browser(page) as (tab, wrong):
        tab.click("#units .name:has-text('detector.1')")
        tab.wait_for_selector("#chosen-fault pre")
        assert (
            tab.inner_text("#chosen-fault pre")
            == "    2 |     raise ValueError('five')\n      |     ^^^^^^^^^^^^^^^^^^^^^^^^"
        )
        assert f"{code}:2: 2 errors, the last: ValueError: five" in tab.inner_text("#chosen-fault")
        assert wrong == []


def test_a_kill_in_a_real_run_is_shown(tmp_path: Path) -> None:
    with page_of_a_run(tmp_path) as (operation, serving), browser(serving) as (tab, wrong):
        tab.wait_for_selector("#health[data-level=well]")
        pid = operation.runtime.pid("camera(piff).1")
        assert pid is not None
        os.kill(pid, signal.SIGKILL)
        tab.wait_for_selector("#timeline li.bad:has-text('camera(piff).1')")
        tab.wait_for_selector("#health[data-level=well]")
        tab.click("#earlier")  # a real run keeps what was so after each review
        tab.wait_for_selector("#moment-says:has-text('Review')")
        while tab.is_enabled("#earlier"):
            tab.click("#earlier")
        tab.wait_for_selector("#moment-says:has-text('Review 1:')")
        assert tab.text_content("g.node.started text").startswith("+ ")
        tab.click("#to-now")
        assert wrong == []


def test_a_peek_shows_images_and_numbers_and_only_while_somebody_looks(tmp_path: Path) -> None:
    def tapped(run: str) -> list[str]:
        return [topic for topic in topics_of(base_folder() / run) if topic.startswith(TAPS)]

    with page_of_a_run(tmp_path) as (operation, serving), browser(serving) as (tab, wrong):
        tab.click("#units .name:has-text('camera(piff).1')")
        assert tapped(operation.id) == []
        tab.click("#members button")
        await_so(tab, "document.querySelector('#peek img')?.naturalWidth === 32")
        assert tapped(operation.id) == [f"{TAPS}camera(piff).1/image"]
        tab.click("#targets .name")
        tab.click("#members button")
        await_so(tab, "document.querySelector('#peek .number .value')?.textContent > 0")
        assert "piff" in tab.inner_text("#peek pre")
        assert tab.get_attribute("#peek img", "src").startswith("data:image/png;base64,")
        assert_legible(tab)
        eventually(lambda: tapped(operation.id) == [])
        assert wrong == []
