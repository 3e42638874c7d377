"""`check`, `solve` and `run` look at unit code before it starts; what is broken is left out until it is mended."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from cfgplan_runtime.lifecycle.changes import KillUnit, RestartUnits, ReviewNow
from cfgplan_runtime.lifecycle.kinds import Level, level, sentence
from cfgplan_runtime.lifecycle.perturbations import CodeChanged
from cfgplan_runtime.lifecycle.policy import Policy
from cfgplan_runtime.lifecycle.reports import OldCodeRuns, Perturbed, Report, Reviewed, UnitEvent, WorldRefused
from cfgplan_runtime.operating.operation import Operation, Settings
from cfgplan_runtime.operating.sources import SourceCheck, Sources
from cfgplan_runtime.supervision.events import HostLost, UnitReady
from operated_world import PATIENCE_S, UNITS, await_event, eventually, running, write_world

from cfgplan import api
from cfgplan.cli import main
from cfgplan.domain import ComputationUnit, OutputPort, Transformation
from cfgplan.errors import Fault

BROKEN = "import nosuchmodule\n" + UNITS
AT_DETECTORS = "detectors.py:1:8: it imports nosuchmodule, which is not there"
SAYS = "units.py:1:8: it imports nosuchmodule, which is not there"


@pytest.fixture
def env(tmp_path: Path) -> Path:
    return write_world(tmp_path)


@pytest.mark.parametrize("verb", ["check", "solve"])
def test_a_fault_of_code_is_a_warning_before_anything_runs(
    verb: str, env: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (env.parent / "units.py").write_text(BROKEN)
    assert main([verb, str(env)]) == 0
    said = capsys.readouterr().err
    place, _, what = SAYS.partition(": ")
    assert f"warning: {env.with_name(place)}: camera(piff), detector(piff) can't be started: {what}\n" in said
    assert said.count("can't be started") == 1, "one fault of a file is told once"
    assert "    1 | import nosuchmodule\n      |        ^^^^^^^^^^^^" in said
    (env.parent / "units.py").write_text(UNITS)
    assert main([verb, str(env)]) == 0
    assert "can't be started" not in capsys.readouterr().err


def test_a_dry_run_leaves_out_what_the_run_would(env: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (env.parent / "units.py").write_text(BROKEN)
    assert main(["run", str(env), "--dry-run", "--no-estimates"]) == 12
    assert "0 to start" in capsys.readouterr().out


def test_broken_code_is_told_once_never_started_and_used_as_soon_as_it_is_mended(env: Path) -> None:
    detectors = env.parent / "detectors.py"
    detectors.write_text(BROKEN)
    env.write_text(env.read_text().replace("units.py:Detector", "detectors.py:Detector"))
    with running(env) as run:
        told = await_event(run, "Warning")["text"]
        assert told.startswith(f"detector(piff) is left out until its code changes: {AT_DETECTORS}")
        review = await_event(run, "Reviewed")
        assert review["decision"] == "kept"
        assert AT_DETECTORS in review["avoided"]["detector(piff)"]
        detectors.write_text(UNITS)
        assert len(await_event(run, "Reviewed", decision="applied")["change_set"]["started"]) == 2


def test_a_run_shows_broken_code_once_with_its_line_and_the_review_says_why(
    env: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (env.parent / "detectors.py").write_text(BROKEN)
    env.write_text(env.read_text().replace("units.py:Detector", "detectors.py:Detector"))
    assert main(["run", str(env), "--no-estimates", "--for", "500ms"]) == 12
    said = capsys.readouterr()
    assert said.err.count("is left out until its code changes") == 1
    assert "    1 | import nosuchmodule\n      |        ^^^^^^^^^^^^" in said.err
    assert "cause: start, detector(piff) can't be started" in said.out


def test_a_run_that_could_start_nothing_names_the_place_in_its_file(
    env: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It named the missing file of code in place of the line that names it."""
    (env.parent / "units.py").unlink()
    assert main(["run", str(env)]) == 30
    said = capsys.readouterr().err
    assert re.search(r"env\.yaml:\d+:\d+: .* can't be started: units\.py: there is no such file of unit code", said)
    assert "^^^" in said


def test_a_run_that_could_start_nothing_does_not_begin(env: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (env.parent / "units.py").write_text(BROKEN)
    assert main(["run", str(env)]) == 30
    said = capsys.readouterr().err
    told = "camera(piff), detector(piff) can't be started: it imports nosuchmodule"
    assert f"error: {env.with_name('units.py')}:1:8: {told}" in said
    assert "    1 | import nosuchmodule\n      |        ^^^^^^^^^^^^" in said


def test_code_that_is_broken_while_it_runs_stops_nothing(env: Path) -> None:
    with running(env) as run:
        await_event(run, "Reviewed", decision="applied")
        (env.parent / "units.py").write_text("def camera(:\n" + UNITS)
        told = await_event(run, "Warning")["text"]
        assert told.startswith("camera(piff), detector(piff) are left out until their code changes: units.py:1"), "once"
        review = await_event(run, "Reviewed")
        assert (review["change_set"]["stopped"], review["unmet"]) == ([], {})


def test_edited_code_is_advised_to_be_restarted_and_a_restart_uses_it(
    env: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with running(env) as run:
        first = await_event(run, "Reviewed", decision="applied")["change_set"]["started"]
        (env.parent / "units.py").write_text(UNITS + "\n")
        unit = min(one["id"] for one in first)
        assert unit in await_event(run, "OldCodeRuns", file="units.py")["units"]
        assert main(["ctl", "restart", unit]) == 0
        out = capsys.readouterr().out
        assert out.startswith("Done.\n")
        assert f"stopped {unit}" in out
        review = await_event(run, "Reviewed", decision="applied")
        assert (review["perturbations"][0]["kind"], review["change_set"]["stopped"]) == ("RestartAsked", [unit])
        (env.parent / "units.py").write_text(UNITS + "\nraise ValueError('no lens')\n")
        await_event(run, "OldCodeRuns")
        assert main(["ctl", "restart", review["change_set"]["started"][0]["id"]]) == 30
        out = capsys.readouterr().out
        assert "no lens" in out
        assert "Done." not in out
        assert main(["ctl", "logs", review["change_set"]["started"][0]["transformation"]]) == 0
        assert "ValueError: no lens" in capsys.readouterr().out


def test_a_warning_of_old_code_ends_when_the_code_is_changed_back_or_its_units_have_ended(env: Path) -> None:
    """The state of the run, which the page shows, says so, too."""
    with Operation(api.load(env), env, Settings()) as operation:
        assert operation.begun.wait(PATIENCE_S)
        manager, told = operation.manager, list[OldCodeRuns]()
        manager.listen(lambda report: told.append(report) if isinstance(report, OldCodeRuns) else None)
        units = tuple(sorted(unit.id for unit in operation.runtime.environment.units))

        def eventually_old(expected: tuple[str, ...]) -> None:
            eventually(lambda: bool(told) and tuple(sorted(told[-1].units)) == expected)
            assert {file: tuple(sorted(ids)) for file, ids in manager.snapshot().old_code.items()} == (
                {"units.py": expected} if expected else {}
            )

        file = env.with_name("units.py")
        file.write_text(UNITS + "\n")
        eventually_old(units)
        assert "these units run with the code from before: " in str(sentence(told[-1]))
        assert level(told[-1]) is Level.WARNING
        file.write_text(UNITS)
        eventually_old(())
        assert sentence(told[-1]) == "units.py: no unit runs with the code from before any more"
        assert level(told[-1]) is Level.INFORMATION
        file.write_text(UNITS + "\n\n")
        eventually_old(units)
        for number, unit in enumerate(units, 1):
            manager.request(RestartUnits((unit,), "me")).result(PATIENCE_S)
            left = units[number:]
            eventually(lambda left=left: set(manager.snapshot().old_code.get("units.py", ())) == set(left))
        eventually_old(())
        assert [len(one.units) for one in told] == [len(units), 0, len(units), 0]


CODE = "def count():\n    yield 0\n"


class Watched:
    """Sources of which each unit runs with CODE; `told` has the files and units of which old code is told."""

    def __init__(self, folder: Path, running: list[ComputationUnit], check: SourceCheck | None = None) -> None:
        labels = dict.fromkeys(unit.transformation for unit in running)
        library = tuple(Transformation(t, outputs=(OutputPort("n", t),), source=f"units.py:{t}") for t in labels)
        self.running, self.told = running, list[tuple[str, tuple[str, ...]]]()
        self._file = folder / "units.py"
        self.sources = Sources(
            folder,
            check,
            library=lambda: library,
            running=lambda: self.running,
            request=lambda _: None,
            tell=lambda _: None,
            tell_old=lambda file, units: self.told.append((file, units)),
        )
        self._file.write_text(CODE)
        self.sources.look_at(library)
        for unit in running:
            self.is_ready(unit.id)

    def is_ready(self, unit: str) -> None:
        self.sources.hear(UnitEvent(UnitReady(unit, 10)))

    def edit(self, text: str) -> None:
        self._file.write_text(text)
        self.sources._hear(frozenset({self._file}))


def test_code_that_is_as_it_was_again_is_no_other_code(tmp_path: Path) -> None:
    """A unit that has started in between has the other code."""
    watched = Watched(tmp_path, [ComputationUnit("count.1", "count")])

    def units_with_other_code_than(text: str) -> tuple[str, ...] | None:
        watched.told.clear()
        watched.edit(text)
        assert {name for name, _ in watched.told} <= {"units.py"}
        return watched.told[-1][1] if watched.told else None

    assert units_with_other_code_than(CODE) is None
    assert units_with_other_code_than(CODE + "\n") == ("count.1",)
    assert units_with_other_code_than(CODE) == ()
    assert units_with_other_code_than(CODE + "\n") == ("count.1",)
    watched.running.append(ComputationUnit("count.2", "count"))
    watched.is_ready("count.2")
    assert units_with_other_code_than(CODE + "\n\n") == ("count.1", "count.2")
    assert units_with_other_code_than(CODE) == ("count.2",)


def test_a_reloading_run_restarts_nothing_if_no_unit_has_other_code(tmp_path: Path) -> None:
    file, one = tmp_path / "units.py", Transformation("count", outputs=(OutputPort("n", "N"),), source="units.py:count")
    said, asked = list[str](), list[object]()
    sources = Sources(
        tmp_path,
        None,
        library=lambda: (one,),
        running=lambda: (ComputationUnit("count.1", "count"),),
        request=asked.append,
        tell=said.append,
        tell_old=lambda file, units: said.append(f"{file}: {units}"),
        reloads=True,
    )
    for text, restarted in (("a", []), ("b", [RestartUnits(("count.1",), "units.py")])):
        file.write_text("a")
        sources.look_at((one,))
        sources.hear(UnitEvent(UnitReady("count.1", 10)))
        said.clear()
        asked.clear()
        file.write_text(text)
        sources._hear(frozenset({file}))
        assert [each for each in asked if isinstance(each, RestartUnits)] == restarted
        assert said == ["units.py has changed: count.1 is restarted"] * len(restarted)


def test_units_with_old_code_are_told_beside_a_fault_in_the_same_file(tmp_path: Path) -> None:
    """A fault of one transformation hid that the units of the others run with the code from before."""
    faulty = {"sum"}
    watched = Watched(
        tmp_path,
        [ComputationUnit("count.1", "count"), ComputationUnit("sum.1", "sum")],
        lambda one, _: Fault("the file has no sum") if one.label in faulty else None,
    )
    watched.edit(CODE + "\n")
    assert watched.told.pop() == ("units.py", ("count.1",)), "sum.1 can't be replaced yet"
    faulty.add("count")
    watched.edit(CODE + "\n\n")
    assert watched.told == [], "the faults say so"
    faulty.remove("sum")
    watched.edit(CODE + "\n")
    assert watched.told.pop() == ("units.py", ("count.1", "sum.1")), "both still run with it"
    assert watched.told == []


def test_units_of_a_lost_host_run_with_no_code(tmp_path: Path) -> None:
    """The loss of a host is told without an end of each of its units: the warning of old code stayed for ever."""
    watched = Watched(tmp_path, [ComputationUnit(f"count.{n}", "count", host=f"r{n}") for n in (1, 2)])
    watched.edit(CODE + "\n")
    for left in (("count.2",), ()):
        host = watched.running.pop(0).host
        assert host is not None
        watched.sources.hear(UnitEvent(HostLost(host, "it does not answer")))
        assert watched.told[-1] == ("units.py", left)


def test_a_reloading_run_restarts_what_runs_of_an_edited_file(env: Path) -> None:
    with running("--reload", env) as run:
        first = {one["id"] for one in await_event(run, "Reviewed", decision="applied")["change_set"]["started"]}
        (env.parent / "units.py").write_text(UNITS + "\n")
        assert await_event(run, "Warning")["text"].startswith("units.py has changed: ")
        review = await_event(run, "Reviewed", decision="applied")
        assert (set(review["change_set"]["stopped"]), review["unmet"]) == (first, {})


@pytest.mark.parametrize(
    ("options", "what"),
    [
        (["--connect", "tcp/127.0.0.1:1"], "files of this computer"),
        (["--middleware", "ros2"], "unit code, and not nodes"),
    ],
)
def test_code_that_a_run_can_t_watch_is_not_reloaded(
    env: Path, options: list[str], what: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["run", str(env), "--reload", *options]) == 30
    assert f"--reload watches {what}" in capsys.readouterr().err


def test_faults_of_a_refused_file_do_not_count(env: Path) -> None:
    """The manager refuses hosts in a run without them; the code of the file before still runs."""
    with Operation(api.load(env), env, Settings(policy=Policy(refuses_hosts=True))) as operation:
        assert operation.begun.wait(PATIENCE_S)
        reports = list[Report]()
        operation.manager.listen(reports.append)
        broken = env.read_text().replace("units.py:Detector", "nowhere.py:Detector")
        env.write_text(broken + "hosts: [{name: r1}]\n")
        eventually(lambda: any(isinstance(one, WorldRefused) and one.faults for one in list(reports)))
        assert operation.manager.request(ReviewNow()).result(PATIENCE_S)
        causes = [one.perturbation for one in reports if isinstance(one, Perturbed)]
        assert not [one for one in causes if isinstance(one, CodeChanged)]
        env.write_text(broken)
        eventually(lambda: "nowhere.py: there is no such file" in str(operation.news.get(timeout=PATIENCE_S)))
        operation.manager.request(KillUnit("detector(piff).1")).result(PATIENCE_S)
        eventually(lambda: any(isinstance(one, Reviewed) and one.review.avoided for one in list(reports)))
