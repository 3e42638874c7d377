"""Queries over running units: set up by the life-cycle, answered, taken down."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from cfgplan_runtime import Policy, Runtime
from cfgplan_runtime.lifecycle.changes import KillUnit, ReplaceWorld
from cfgplan_runtime.lifecycle.manager import Manager
from cfgplan_runtime.operating.control_client import connect
from cfgplan_runtime.operating.control_server import ControlServer
from cfgplan_runtime.operating.methods import Methods
from cfgplan_runtime.reasoning.engine import Engine
from cfgplan_runtime.reasoning.features import of_file, of_targets
from cfgplan_runtime.reasoning.managed import ManagedSubscriptions, RemoteSubscriptions
from cfgplan_runtime.reasoning.queries import Answer, Noted, QueryReport, query
from cfgplan_runtime.reasoning.truth import Verdict

import cfgplan
from cfgplan.cli import main
from cfgplan.domain import Environment, OutputPort, Target, Transformation
from cfgplan.matching import Ontology

PITCH = Path(__file__).parent / "pitch"
WORLD = PITCH / "world.yaml"
PATIENCE_S = 60
OFF_SIDE = "always (not in(ball, opponent_half) -> eventually[0,{0}] in(ball, opponent_half))"

pytestmark = pytest.mark.usefixtures("runs")


def ask(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, list[dict[str, Any]]]:
    code = main(["query", str(WORLD), *arguments, "--json"])
    return code, [json.loads(line) for line in capsys.readouterr().out.splitlines()]


def wait_for(what: Callable[[], bool]) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not what():
        assert time.monotonic() < deadline
        time.sleep(0.02)


@contextmanager
def running() -> Iterator[tuple[Manager, Runtime]]:
    """A run with the target /robot and nothing else."""
    with Runtime(folder=PITCH) as runtime, Manager(cfgplan.load(WORLD), runtime) as manager:
        assert manager.settle(PATIENCE_S)
        yield manager, runtime


def units(manager: Manager) -> set[str]:
    return {unit.transformation for unit in manager.snapshot().environment.units}


def test_a_rule_that_is_broken_is_answered_with_false_and_the_units_are_stopped(
    capsys: pytest.CaptureFixture[str],
) -> None:
    code, told = ask(capsys, OFF_SIDE.format("100ms"), "--for", "60s", "--hold", "30s")
    assert code == 1
    assert told[0]["event"] == "SetUp"
    answer = told[-1]
    assert (answer["event"], answer["verdict"]) == ("Answer", "false")
    (expired,) = answer["expired"]
    assert expired["until_ns"] <= answer["time_ns"] <= expired["until_ns"] + 2_000_000_000
    notes = [line["text"] for line in told if line["event"] == "Noted"]
    assert any(text.startswith("stopped camera.1, localizer.1") for text in notes)


def test_what_becomes_true_is_answered_at_once(capsys: pytest.CaptureFixture[str]) -> None:
    formula = "eventually[0,1h] (in(ball, opponent_half) and robot.seen and tpp(robot.hull, field))"
    code, told = ask(capsys, formula)
    assert (code, told[-1]["verdict"]) == (0, "true")


def test_a_query_that_is_open_when_its_time_is_over_says_so(capsys: pytest.CaptureFixture[str]) -> None:
    code, told = ask(capsys, OFF_SIDE.format("1h"), "--for", "700ms")
    assert (code, told[-1]["verdict"]) == (20, "open")


def test_a_feature_that_nothing_gives_is_refused_with_the_reason(capsys: pytest.CaptureFixture[str]) -> None:
    code = main(["query", str(WORLD), "always heat.celsius > 3"])
    assert code == 10
    assert "heat wants Temperature, but no output matches" in capsys.readouterr().err


def test_a_target_of_a_run_is_used_as_it_is_and_units_that_only_the_query_needs_are_stopped() -> None:
    with running() as (manager, runtime):
        before = units(manager)
        told: list[QueryReport] = []
        declared = of_targets(manager.world.environment).with_more(of_file(PITCH / "features.yaml"))
        asked = query("eventually (robot.seen and in(ball, opponent_half))", declared)
        answer = Engine(asked, ManagedSubscriptions(manager, runtime.id), told.append).run(for_s=PATIENCE_S)
        assert answer.verdict is Verdict.TRUE
        assert before == {"camera", "robot"}
        assert units(manager) == before


def test_a_query_survives_the_death_of_a_unit() -> None:
    with running() as (manager, runtime):
        told: list[QueryReport] = []
        asked = query(OFF_SIDE.format("1h"), of_file(PITCH / "features.yaml"))
        engine = Engine(asked, ManagedSubscriptions(manager, runtime.id), told.append)
        found: list[Answer] = []
        thread = threading.Thread(target=lambda: found.append(engine.run(every_s=0.05)))
        thread.start()
        wait_for(lambda: engine.monitor.states > 20)
        manager.request(KillUnit("localizer.1"))
        wait_for(lambda: any(isinstance(one, Noted) and "localizer.1 died" in one.text for one in told))
        states = engine.monitor.states
        wait_for(lambda: sum(isinstance(one, Noted) and "started localizer" in one.text for one in told) >= 2)
        wait_for(lambda: engine.monitor.states > states + 50)
        engine.stop()
        thread.join(PATIENCE_S)
        assert found[0].verdict is Verdict.OPEN


def test_a_run_of_another_process_is_asked_through_its_control_socket(
    runs: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with running() as (manager, runtime):
        methods = Methods(manager).by_name()
        with ControlServer(runs / "cfgplan" / runtime.id, methods, str(WORLD)):
            formula = "eventually (robot.seen and in(ball, opponent_half))"
            code = main(["query", formula, "--json", "--features", str(PITCH / "features.yaml")])
            answer = json.loads(capsys.readouterr().out.splitlines()[-1])
            assert (code, answer["verdict"]) == (0, "true")
            assert units(manager) == {"camera", "robot"}
            assert main(["query", "always heat.celsius > 3", "--features", str(PITCH / "features.yaml")]) == 10
            assert "no output matches" in capsys.readouterr().err
            assert main(["query", "always hot.x > 3", "--feature", "hot=Ball and and"]) == 30
            assert "'and' stands where a concept is expected" in capsys.readouterr().err
            with connect() as control:
                remote = RemoteSubscriptions(control)
                assert set(remote.declared().features) == {"robot"}


def test_what_a_query_has_added_ends_with_its_process_even_if_that_is_killed(runs: Path) -> None:
    with running() as (manager, runtime):
        methods = Methods(manager).by_name()
        with ControlServer(runs / "cfgplan" / runtime.id, methods, str(WORLD)):
            code = "import sys; from cfgplan.cli import main; sys.exit(main())"
            features = ("--features", str(PITCH / "features.yaml"))
            line = [sys.executable, "-c", code, "query", "always eventually[0,1h] ball.x > 99", *features]
            with subprocess.Popen(line) as process:
                wait_for(lambda: units(manager) == {"camera", "robot", "localizer"})
                process.kill()
            wait_for(lambda: units(manager) == {"camera", "robot"})
            assert {view.label for view in manager.snapshot().targets} == {"robot"}


def test_a_query_whose_run_ends_is_left_open() -> None:
    told: list[QueryReport] = []
    with running() as (manager, runtime):
        engine = Engine(
            query("always (ball.x > 99 or eventually[0,1h] ball.x > 99)", of_file(PITCH / "features.yaml")),
            ManagedSubscriptions(manager, runtime.id),
            told.append,
        )
        found: list[Answer] = []
        thread = threading.Thread(target=lambda: found.append(engine.run()))
        thread.start()
        wait_for(lambda: engine.monitor.states > 5)
    thread.join(PATIENCE_S)
    assert found[0].verdict is Verdict.OPEN
    assert Noted("the stream of ball has ended") in told


def test_what_a_run_can_not_decide_is_named_to_whoever_asks_for_it(
    runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    axioms = ["SubClassOf(<#A> <#W>)", "SubClassOf(<#B> <#W>)", "SubClassOf(<#C> ObjectUnionOf(<#A> <#B>))"]
    cheap = Transformation("cheap", (), (OutputPort("o", "C"),), labor_us=1, source="camera.py:camera")
    world = cfgplan.world(Environment((), (cheap,), ()), horizon_s=60, ontology=Ontology(axioms))
    why = "wants W, but it is not decided yet whether C is W"
    more = tmp_path / "more.yaml"
    more.write_text("targets: [{label: t, topic: /t, tag: W}]")
    with Runtime(folder=PITCH) as runtime, Manager(world, runtime, policy=Policy(reasoner="el")) as manager:
        assert manager.settle(PATIENCE_S)
        methods = Methods(manager).by_name()
        with ControlServer(runs / "cfgplan" / runtime.id, methods, str(WORLD)):
            assert main(["query", "always u.x > 3", "--feature", "u=W"]) == 10
            assert f"u {why}" in capsys.readouterr().err
            assert main(["ctl", "add", str(more)]) == 12
            told = capsys.readouterr().out
            assert "no decision: it is not decided whether there is a plan" in told
            assert f"not met: target t {why}" in told
            assert "it is undecided whether C is W: if so, a better update may exist" in told
            assert "in time" not in told
            assert main(["ctl", "state"]) == 12
            assert f"target t {why}" in capsys.readouterr().out
            edited = replace(world.environment, targets=(Target("v", "W", "/v"),))
            review = manager.request(ReplaceWorld(replace(world, environment=edited), "env.yaml")).result(PATIENCE_S)
            assert review is not None
            assert review.unmet["v"] == f"target v {why}"
            assert (review.undecided, review.is_proven) == ((("C", "W"),), False)
            assert units(manager) == set()


@pytest.mark.usefixtures("runs")
@pytest.mark.parametrize(
    ("source", "why"),
    [
        ("", "cam (it has no unit code: add `source: package.module:Class` or `source: units.py:Class`)"),
        (", source: 'units.py:camra'", "env.yaml:2:57: cam can't be started: units.py: the file has no camra"),
    ],
)
def test_a_target_of_the_file_that_no_unit_can_meet_ends_the_query(
    source: str, why: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A query once waited for its stream without end, or until `--for`."""
    (tmp_path / "units.py").write_text("def camera(): yield 1\n")
    env = tmp_path / "env.yaml"
    library = f"transformations: [{{label: cam, outputs: {{o: X}}{source}}}]"
    env.write_text(f"format: cfgplan/1\n{library}\ntargets: [{{label: t, topic: /t, tag: X}}]\n")
    assert main(["query", str(env), "eventually t > 3"]) == 10
    told = capsys.readouterr().err
    assert "error: target t wants X, but needs transformations that are left out for now: cam" in told
    assert why in told
