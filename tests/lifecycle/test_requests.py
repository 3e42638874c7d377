"""What a running manager may be asked, and what it answers; no process."""

from __future__ import annotations

from pathlib import Path

import pytest
from cfgplan_runtime.errors import RuntimeFaultError
from cfgplan_runtime.lifecycle.changes import (
    Add,
    Change,
    Declare,
    Individual,
    KillUnit,
    LoseHost,
    RegainHost,
    Remove,
    ReplaceWorld,
    Restore,
    Stop,
    Withdraw,
)
from cfgplan_runtime.lifecycle.perturbations import WorldChanged
from cfgplan_runtime.lifecycle.reports import Ended, Phase
from simulated_life import RESULT, Life, source, started, worker

from cfgplan import api
from cfgplan.domain import Environment, Target
from cfgplan.errors import InputError

ROBOTS = """
@prefix : <http://example.org/robots#> .
@prefix owl: <http://www.w3.org/2002/07/owl#> .
@prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> .
:Robot a owl:Class .
:Flying a owl:Class ; rdfs:subClassOf :Robot .
:Image a owl:Class .
:hasSource a owl:ObjectProperty .
:follows a owl:ObjectProperty .
:r1 a owl:NamedIndividual , :Robot .
"""
TEMPLATE = """
format: cfgplan/1
ontology: robots.ttl
transformations:
  - label: camera(${Robot})
    source: units.py:camera
    outputs: {image: "Image and hasSource some {${Robot}}"}
targets:
  - {label: seen, topic: /seen, tag: "Image and hasSource some {r1}"}
"""
SEES_R2 = Target("seen2", "Image and hasSource some {r2}", "/seen2")


@pytest.fixture
def robots(tmp_path: Path) -> Life:
    (tmp_path / "robots.ttl").write_text(ROBOTS)
    (tmp_path / "env.yaml").write_text(TEMPLATE)
    return started(world=api.load(tmp_path / "env.yaml"))


@pytest.mark.parametrize(
    ("change", "part"),
    [
        (KillUnit("nobody.1"), "no unit 'nobody.1' runs"),
        (Remove(targets=("nothing",)), "there is no target 'nothing' (choose one of result)"),
        (Remove(targets=("resul",)), "there is no target 'resul' (did you mean `result`?)"),
        (Remove(transformations=("nothing",)), "there is no transformation 'nothing'"),
        (Remove(individuals=("nobody",)), "there is no individual 'nobody'"),
        (Add(individuals=(Individual("me"),)), "without an ontology there are no individuals"),
        (Add(targets=(Target("other", "Y and", "/other"),)), "target 'other'"),
        (Add(targets=(Target("other", "Y", "/result"),)), "topic"),
        (Add(transformations=(worker("bad", needs="some ("),)), "input x of transformation 'bad'"),
        (LoseHost("far"), "there is no host 'far'"),
        (RegainHost("far"), "host 'far' was not taken out of service"),
        (Withdraw("robot"), "there is no addition 'robot' (the run has none)"),
        (Declare("robot", {"transformations": [{"lable": "x"}]}), "declared by robot"),
        (Declare("robot", {"targets": [{"label": "result", "topic": "/x", "tag": "Y"}]}), "'result'"),
    ],
)
def test_a_bad_request_is_refused_with_a_reason_and_changes_nothing(change: Change, part: str) -> None:
    life = started()
    before, reviews = life.manager.world.environment, len(life.reviews)
    outcome = life.manager.request(change)
    life.settle()
    with pytest.raises(InputError) as error:
        outcome.result(timeout=0)
    assert part in str(error.value)
    assert life.manager.world.environment == before
    assert len(life.reviews) == reviews


def test_what_changes_nothing_needs_no_review() -> None:
    life = started()
    assert life.ask(Add(targets=(RESULT,))) is None
    assert len(life.reviews) == 1


def test_requests_that_come_together_are_answered_by_one_review() -> None:
    life = started()
    outcomes = [
        life.manager.request(change)
        for change in (
            Add(transformations=(worker("more"),)),
            Add(targets=(Target("n", "N", "/n"),)),
            KillUnit("work.1"),
        )
    ]
    life.settle()
    assert outcomes[0].result(0) == outcomes[1].result(0) == outcomes[2].result(0) == life.reviews[-1]


def test_of_file_and_requests_the_later_word_holds() -> None:
    life = started()
    life.ask(Add(transformations=(worker(params={"by": "request"}),)))
    life.ask(Remove(transformations=("count",)))

    def say(*library: object) -> None:
        environment = Environment((), library, (RESULT,))  # type: ignore[arg-type]
        life.ask(ReplaceWorld(api.world(environment, horizon_s=60), "file"))

    say(source(), worker(), worker("more"))
    known = life.manager.world.environment.transformation
    assert (known["work"].params, "count" in known) == ({"by": "request"}, False)
    say(source(params={"by": "file"}), worker(params={"by": "file"}), worker("more"))
    known = life.manager.world.environment.transformation
    assert known["work"].params == known["count"].params == {"by": "file"}


def test_an_individual_that_comes_fills_the_templates(robots: Life) -> None:
    review = robots.reviewed(Add(individuals=(Individual("r2", ("Flying",), (("follows", "r1"),)),)))
    (changed,) = review.perturbations
    assert isinstance(changed, WorldChanged)
    assert changed.difference.added_individuals == ("r2",)
    assert changed.difference.added_transformations == ("camera(r2)",)
    robots.ask(Add(targets=(SEES_R2,)))
    assert robots.met == {"seen", "seen2"}
    robots.ask(Remove(targets=("seen2",)))
    robots.ask(Remove(individuals=("r2",)))
    assert set(robots.manager.world.environment.transformation) == {"camera(r1)"}


def test_an_individual_of_the_ontology_file_can_go(robots: Life) -> None:
    robots.ask(Add(individuals=(Individual("r2", ("Robot",)),)))
    outcome = robots.manager.request(Remove(individuals=("r1",)))
    robots.settle()
    with pytest.raises(InputError, match="r1"):
        outcome.result(timeout=0)  # a target of the file needs it
    robots.ask(Remove(targets=("seen",)))
    with pytest.raises(InputError, match="r1"):  # its tag is still checked, as it stands in the file
        robots.ask(Remove(individuals=("r1",)))


def test_a_robot_registers_itself_and_leaves(robots: Life) -> None:
    document = {
        "transformations": [
            {
                "label": "track(${Flying})",
                "source": "units.py:Track",
                "labor": 0.25,
                "inputs": {"image": "Image and hasSource some {${Flying}}"},
                "outputs": {"pose": "Thing"},
            }
        ],
        "targets": [{"label": "seen2", "topic": "/seen2", "tag": SEES_R2.tag, "priority": 3}],
    }
    robots.ask(Declare("r2", document, (Individual("r2", ("Flying",)),)))
    known = robots.manager.world.environment.transformation
    assert set(known) == {"camera(r1)", "camera(r2)", "track(r2)"}
    assert known["track(r2)"].labor_us == 250_000
    assert robots.met == {"seen", "seen2"}
    assert robots.manager.snapshot().declared == ("r2",)
    robots.ask(Withdraw("r2"))
    assert robots.units == {"camera(r1).1"}


def test_what_was_removed_of_a_declaration_stays_away_until_it_is_declared_again(robots: Life) -> None:
    document = {
        "transformations": [{"label": "film(${Flying})", "outputs": {"film": "Thing"}}],
        "targets": [{"label": "seen2", "topic": "/seen2", "tag": SEES_R2.tag}],
    }
    register = Declare("r2", document, (Individual("r2", ("Flying",)),))
    robots.ask(register)
    robots.ask(Remove(targets=("seen2",)))
    robots.ask(Remove(transformations=("film(r2)",)))
    assert set(robots.manager.world.environment.transformation) == {"camera(r1)", "camera(r2)"}
    robots.ask(register)
    assert set(robots.manager.world.environment.transformation) == {"camera(r1)", "camera(r2)", "film(r2)"}
    assert robots.met == {"seen", "seen2"}


def test_what_was_removed_can_be_restored(robots: Life) -> None:
    robots.ask(Remove(targets=("seen",)))
    robots.ask(Remove(transformations=("camera(r1)",)))
    assert robots.manager.snapshot().removed == ("camera(r1)", "seen")
    robots.ask(Restore(("seen", "camera(r1)")))
    assert (robots.met, robots.manager.snapshot().removed) == ({"seen"}, ())
    with pytest.raises(InputError, match="there is no removed name 'seen'"):
        robots.ask(Restore(("seen",)))


def test_an_individual_that_was_declared_can_be_removed_unless_it_is_needed(robots: Life) -> None:
    robots.ask(Declare("r2", {}, (Individual("r2", ("Robot",)),)))
    robots.ask(Remove(individuals=("r2",)))
    assert set(robots.manager.world.environment.transformation) == {"camera(r1)"}
    robots.ask(
        Declare("r2", {"targets": [{"label": "seen2", "topic": "/seen2", "tag": SEES_R2.tag}]}, (Individual("r2"),))
    )
    with pytest.raises(InputError, match="no individual 'r2'"):
        robots.ask(Remove(individuals=("r2",)))


def test_an_individual_with_an_unknown_class_is_refused(robots: Life) -> None:
    with pytest.raises(InputError, match=r"no class 'Robto' \(did you mean `Robot`"):
        robots.ask(Add(individuals=(Individual("r2", ("Robto",)),)))


def test_a_world_that_contradicts_itself_is_refused_and_the_old_one_holds(robots: Life, tmp_path: Path) -> None:
    (tmp_path / "robots.ttl").write_text(ROBOTS + ":r1 a :Image . :Robot owl:disjointWith :Image .\n")
    (tmp_path / "env.yaml").write_text(TEMPLATE.replace("${Robot}", "r1"))
    robots_now = robots.manager.world
    with pytest.raises(InputError, match="contradicts itself"):
        robots.ask(ReplaceWorld(api.load(tmp_path / "env.yaml"), "env.yaml"))
    assert robots.manager.world is robots_now
    assert "contradicts itself" in robots.manager.snapshot().faults[0].message
    robots.fail("camera(r1).1")
    assert robots.met == {"seen"}


def test_stop_stops_every_unit_and_turns_away_who_comes_later() -> None:
    life = started()
    last = life.manager.request(Stop())
    life.manager.step()
    assert last.result(timeout=0) is None
    assert (life.units, life.manager.snapshot().phase) == (set(), Phase.STOPPED)
    assert life.reports[-1] == Ended()
    with pytest.raises(RuntimeFaultError, match="the run has ended"):
        life.manager.request(KillUnit("work.1")).result(timeout=0)
