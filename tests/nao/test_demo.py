"""`cfgplan demo nao` as a user calls it, in a short version, and the page that it writes."""

from __future__ import annotations

import importlib.util
import json
import math
import os
import signal
import subprocess
import sys
import zipfile
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import httpx
import psutil
import pytest
from cfgplan_runtime import subscribe
from football import scenario
from living import descendants
from nao_demo.story import WORLD, declared_by

from cfgplan.cli import demo, main
from cfgplan.cli.exits import Exit

PATIENCE_S = 60


@pytest.fixture
def nothing_is_left_behind(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    base = tmp_path_factory.mktemp("run")
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(base))
    children = descendants()
    yield
    assert descendants() - children == set()
    assert list((base / "cfgplan").rglob("*")) == []


class Page(HTMLParser):
    """What a page consists of, and whether each element is closed."""

    def __init__(self) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.links: list[str] = []
        self.open: list[str] = []
        self.text = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.links += [value or "" for name, value in attrs if name in ("src", "href", "xlink:href")]
        if tag not in ("meta", "br", "img", "input", "link"):
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if self.open and self.open[-1] == tag:
            self.open.pop()

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data


@pytest.mark.usefixtures("nothing_is_left_behind")
def test_the_story_of_section_five_happens_and_is_put_on_a_page(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "page.html"
    assert main(["demo", "nao", "--step", "1s", "--report", str(out), "--json"]) == 0
    steps: list[dict[str, Any]] = [json.loads(line) for line in capsys.readouterr().out.splitlines()]

    alone, registered, killed, joined, offered, required = steps
    assert alone["unmet"].keys() == {"ball"}
    assert alone["positions"] == 0
    assert (registered["cost_us"], len(registered["started"])) == (20_550_000, 6)
    assert (killed["cost_us"], killed["started"]) == (18_950_000, ["segmenter(piff).1"])
    assert killed["rewired"] == ["ball_detector(piff).1"]
    for unchanged in (joined, offered):
        assert (unchanged["decision"], unchanged["cost_us"]) == ("kept", 18_600_000)
        assert unchanged["started"] == unchanged["rewired"] == unchanged["stopped"] == []
    assert [other["cost_us"] for other in joined["others"]] == [20_550_000]
    assert [other["cost_us"] for other in offered["others"]] == [20_550_000, 39_900_000]
    assert (required["cost_us"], len(required["started"])) == (39_900_000, 7)
    assert required["source"] == "fuse_ball_pos"
    assert all(step["source"] == "ball_localization(piff)" for step in (registered, killed, joined, offered))
    assert all(step["positions"] > 0 and step["rms_error_m"] < 0.4 for step in steps[1:])

    page = Page()
    page.feed(out.read_text(encoding="utf-8"))
    assert page.open == []
    assert page.tags.count("section") == 6
    assert page.tags.count("svg") >= 3 + 8
    assert page.tags.count("img") == 2
    assert all(link.startswith(("data:", "#")) for link in page.links)
    for said in ("Two robots, one ball", "The segmenter is killed", "39.90 s, 21.30 s more", "killed by SIGKILL"):
        assert said in page.text


@pytest.mark.usefixtures("nothing_is_left_behind")
@pytest.mark.parametrize("end", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_play_leaves_no_process(tmp_path: Path, end: signal.Signals) -> None:
    command = [sys.executable, "-c", "import sys; from cfgplan.cli import main; sys.exit(main())"]
    arguments = ["demo", "nao", "--json", "--step", "60s", "--report", str(tmp_path / "page.html"), "--page"]
    with subprocess.Popen([*command, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as playing:
        assert playing.stdout is not None
        assert playing.stderr is not None
        url = playing.stderr.readline().removeprefix("The page is at ").strip()
        assert json.loads(playing.stdout.readline())["step"] == 0
        subscription = subscribe("/result", wait_s=PATIENCE_S, timeout_s=PATIENCE_S)
        next(iter(subscription))
        assert "<title>cfgplan</title>" in httpx.get(url).text
        started = psutil.Process(playing.pid).children(recursive=True)
        assert len(started) > 6
        playing.send_signal(end)
        _, err = playing.communicate(timeout=PATIENCE_S)
        subscription.close()
    assert playing.returncode == Exit.INTERRUPTED, err
    assert psutil.wait_procs(started, timeout=PATIENCE_S)[1] == []
    assert not (tmp_path / "page.html").exists()


def test_without_opencv_the_extra_is_named(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    found = importlib.util.find_spec
    monkeypatch.setattr("cfgplan.extras.find_spec", lambda name: None if name == "cv2" else found(name))
    assert main(["demo", "nao"]) == 30
    err = capsys.readouterr().err
    assert "demos need the package cv2" in err
    assert "pip install 'cfgplan[demo]'" in err


def test_an_installation_without_the_world_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(demo, "_FOLDERS", (tmp_path,))
    assert main(["demo", "nao"]) == 30
    assert "the world 'nao' is neither in the installed package" in capsys.readouterr().err


def test_a_page_that_can_not_be_written_is_refused_before_anything_starts(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["demo", "nao", "--report", str(tmp_path / "nowhere" / "page.html")]) == 30
    assert "nowhere" in capsys.readouterr().err


def test_what_a_robot_declares_is_the_pipeline_in_its_name() -> None:
    declared = declared_by("piff")
    assert [one.name for one in declared.individuals] == ["piff"]
    transformations: Any = declared.document["transformations"]
    assert len(transformations) == 6
    assert "${NAO}" not in str(transformations)


@pytest.mark.usefixtures("nothing_is_left_behind")
def test_a_stage_of_the_case_study_runs_and_tells_where_the_ball_is(capsys: pytest.CaptureFixture[str]) -> None:
    command = [sys.executable, "-c", "import sys; from cfgplan.cli import main; sys.exit(main())"]
    arguments = ["run", str(WORLD / "1-piff-registered.yaml")]
    with subprocess.Popen([*command, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as running:
        assert main(["listen", "/result", "--json", "--count", "3", "--wait", f"{PATIENCE_S}s"]) == 0
        running.send_signal(signal.SIGINT)
        _, err = running.communicate(timeout=PATIENCE_S)
    assert running.returncode == 0, err
    for line in map(json.loads, capsys.readouterr().out.splitlines()):
        assert math.dist((line["value"]["x"], line["value"]["y"]), scenario.ball(line["time_ns"])) < 0.5


def test_the_wheel_holds_the_case_study_and_its_play(tmp_path: Path) -> None:
    checkout = Path(demo.__file__).parents[2]
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(tmp_path)]
    subprocess.run(build, cwd=checkout, check=True, capture_output=True)
    (wheel,) = tmp_path.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(tmp_path / "installed")
    code = "from cfgplan.cli import demo; print(demo._folder('nao'))"
    setting = {**os.environ, "PYTHONPATH": str(tmp_path / "installed")}
    found = subprocess.run(
        [sys.executable, "-c", code], env=setting, cwd=tmp_path, check=True, capture_output=True, text=True
    )
    world = Path(found.stdout.strip())
    assert world == tmp_path / "installed" / "cfgplan" / "worlds" / "nao"
    files = {path.relative_to(WORLD) for path in WORLD.rglob("*") if path.suffix in (".py", ".yaml", ".ttl", ".j2")}
    assert files <= {path.relative_to(world) for path in world.rglob("*")}
