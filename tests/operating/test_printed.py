"""`cfgplan ctl logs`: what units have printed, those that have ended too."""

from __future__ import annotations

import json
from collections.abc import Iterator
from types import SimpleNamespace

import pytest
from cfgplan_runtime.lifecycle.reports import UnitEvent
from cfgplan_runtime.operating import printed as kept
from cfgplan_runtime.operating.control_client import Control
from cfgplan_runtime.operating.control_server import ControlServer
from cfgplan_runtime.operating.methods import Methods
from cfgplan_runtime.operating.printed import LINES_KEPT, Printed
from cfgplan_runtime.operating.protocol import RefusedError
from cfgplan_runtime.streams.run_folder import RunFolder
from cfgplan_runtime.supervision.events import UnitDied, UnitPrinted, UnitReady
from fake_manager import FakeManager

from cfgplan.cli.main import main


@pytest.fixture
def printed() -> Printed:
    times = iter(range(1_000_000))
    return Printed(now_s=lambda: float(next(times)))


def say(printed: Printed, unit: str, *lines: str) -> None:
    for line in lines:
        printed.hear(UnitEvent(UnitPrinted(unit, line)))


def texts(printed: Printed, name: str, after: int = 0) -> list[tuple[str, str]]:
    return [(line.unit, line.line) for line in printed.lines(name, after)]


def test_lines_of_a_label_are_those_of_all_its_units_in_their_order(printed: Printed) -> None:
    say(printed, "camera.1", "a")
    say(printed, "camera.2", "b")
    say(printed, "camera.1.5", "of a label of its own")
    say(printed, "camera(piff).1", "c")
    say(printed, "camera.1", "d")
    assert texts(printed, "camera") == [("camera.1", "a"), ("camera.2", "b"), ("camera.1", "d")]
    assert texts(printed, "camera.1") == [("camera.1", "a"), ("camera.1.5", "of a label of its own"), ("camera.1", "d")]
    assert texts(printed, "camera(piff)") == [("camera(piff).1", "c")]
    assert texts(printed, "camera", after=printed.lines("camera")[1].number) == [("camera.1", "d")]


def test_a_death_is_among_the_lines_and_ends_nothing(printed: Printed) -> None:
    say(printed, "camera.1", "ValueError: no lens")
    printed.hear(UnitEvent(UnitDied("camera.1", "exited with 1")))
    printed.hear(UnitEvent(UnitReady("camera.2", 10)))
    assert [line for _, line in texts(printed, "camera")] == [
        "ValueError: no lens",
        "cfgplan: camera.1 died: exited with 1",
    ]


def test_what_is_kept_is_bounded(printed: Printed, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kept, "UNITS_KEPT", 2)
    say(printed, "a.1", *map(str, range(LINES_KEPT + 5)), "x" * 100_000)
    lines = printed.lines("a")
    assert (len(lines), lines[0].line) == (LINES_KEPT, "6")
    assert len(lines[-1].line) < 5000
    monkeypatch.setattr(kept, "MOST_CHARACTERS", 25_000)
    say(printed, "b.1", "b")
    say(printed, "a.1", "again")
    say(printed, "c.1", "c")
    assert (bool(printed.lines("a")), printed.lines("b"), bool(printed.lines("c"))) == (True, [], True)
    say(printed, "c.1", *["y" * 4000] * 5)
    assert (printed.lines("a"), len(printed.lines("c"))) == ([], 6)
    say(printed, "d.1", "z")
    assert [line.line for line in printed.lines("d")] == ["z"]


@pytest.fixture
def served(run_folder: RunFolder, manager: FakeManager, printed: Printed) -> Iterator[Printed]:
    with ControlServer(run_folder.path, Methods(manager, printed=printed).by_name(), "/robots/env.yaml"):
        yield printed


def test_the_shell_prints_lines_with_the_unit_where_there_may_be_several(
    served: Printed, capsys: pytest.CaptureFixture[str]
) -> None:
    say(served, "camera.1", "one", "two \x1b[31mred")
    say(served, "camera.2", "three")
    assert main(["ctl", "logs", "camera.1"]) == 0
    assert [line[10:] for line in capsys.readouterr().out.splitlines()] == ["one", "two red"]
    assert main(["ctl", "logs", "camera", "--last", "2"]) == 0
    assert [line[10:] for line in capsys.readouterr().out.splitlines()] == ["camera.1  two red", "camera.2  three"]
    assert main(["ctl", "logs", "camera", "--json"]) == 0
    first = json.loads(capsys.readouterr().out.splitlines()[0])
    assert (first["unit"], first["line"], first["number"]) == ("camera.1", "one", 1)


def test_a_unit_that_runs_and_prints_nothing_is_told_from_one_that_is_not_there(
    served: Printed, capsys: pytest.CaptureFixture[str]
) -> None:
    assert served.lines("camera") == []
    assert main(["ctl", "logs", "camera.1"]) == 0
    assert "camera.1 has printed nothing" in capsys.readouterr().err
    assert main(["ctl", "logs", "nobody"]) == 30
    told = capsys.readouterr().err
    assert "no unit 'nobody' runs, and none has printed anything" in told
    assert "there is camera, camera.1" in told


@pytest.mark.usefixtures("server")
@pytest.mark.parametrize("after", [-1, True, "3", 1.5])
def test_a_number_of_a_line_is_a_whole_number(control: Control, after: object) -> None:
    with pytest.raises(RefusedError, match="`after` is not the number of a line"):
        control.call("logs", unit="camera.1", after=after)


def test_following_ends_with_the_run(
    run_folder: RunFolder,
    manager: FakeManager,
    printed: Printed,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    server = ControlServer(run_folder.path, Methods(manager, printed=printed).by_name(), "/robots/env.yaml")
    say(printed, "camera.1", "one")
    steps = iter([lambda: say(printed, "camera.1", "two", "three"), lambda: None, server.close])
    monkeypatch.setattr("cfgplan.cli.ctl_views.time", SimpleNamespace(sleep=lambda _: next(steps)()))
    assert main(["ctl", "logs", "camera.1", "--follow"]) == 0
    told = capsys.readouterr()
    assert [line[10:] for line in told.out.splitlines()] == ["one", "two", "three"]
    assert "has ended" in told.err
