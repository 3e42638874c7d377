"""The words of deployments, each in every place that has to know it: a table of words by places.

A row is a small world that says the word. What runs in it breaks the word's rule (`broken`), or costs more by it
(`costs_us`); where the word can forbid all plans, `limit` is how it is named as the reason.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any
from unittest.mock import patch

import pytest
import yaml
from hypothesis import HealthCheck, Phase, find, settings
from hypothesis.errors import NoSuchExample

import cfgplan
from cfgplan import api
from cfgplan.domain import ALL, Environment, Similarity
from cfgplan.drawing import picture
from cfgplan.errors import InputError
from cfgplan.explaining.why_not import why_not
from cfgplan.planners import PLANNERS
from cfgplan.planners.exact import session
from cfgplan.planners.exact.solve_run import SolveRun
from cfgplan.planners.exact.stages import STAGES, Stage
from cfgplan.planning import Feature, Plan, Problem
from cfgplan.validity.plans import kept_us
from experiments.families.random_library import random_library

sys.path.append(str(Path(__file__).parent / "planners"))

from fleets import fleets

Said = Mapping[str, Any]
ALWAYS_ASKED = {"min_instances", "pinned"}
"""What a transformation says that no plan can do without."""
MANY = settings(
    max_examples=2000, database=None, derandomize=True, phases=[Phase.generate], suppress_health_check=[*HealthCheck]
)


@dataclass(frozen=True)
class Word:
    """A row of the table: what is said of the world `source -> sink`, and what each place makes of it."""

    drawn: Callable[[Environment], bool] | None
    """What the generators have to draw; None: the word is gone once a file is read."""
    source: Said = field(default_factory=dict)
    sink: Said = field(default_factory=dict)
    takes: Said = field(default_factory=dict)
    gives: Said = field(default_factory=dict)
    top: Said = field(default_factory=dict)
    target: Said = field(default_factory=dict)
    hosts: tuple[Said, ...] = ()
    units: tuple[Said, ...] | None = None
    feature: Feature | None = None
    """By what name planners refuse it that don't know it; None: it is no more than they know."""
    broken: str | None = None
    costs_us: int = 0
    limit: str | None = None
    never: Said | None = None
    """With what of the source no plan keeps to the word's limit."""
    shown: str | None = None
    """What a picture shows of it."""
    beside: Said | None = field(default_factory=dict)
    """What else to say so that the word does nothing where no plan can use source and sink; None: it always does."""

    def problem(self, folder: Path, *, is_asked_too_much: bool = False) -> Problem:
        source = {"label": "source", "upkeep": 1, **self.source, "outputs": {"a": {"tag": "A", **self.gives}}}
        source |= (self.never or {}) if is_asked_too_much else {}
        sink: dict[str, Any] = {"label": "sink", **self.sink, "inputs": {"a": {"tag": "A", **self.takes}}}
        sink["outputs"] = {"b": "B"}
        at = {"host": self.hosts[0]["name"]} if self.hosts else {}
        usual = (
            {"id": "source.1", "transformation": "source", **at},
            {"id": "sink.1", "transformation": "sink", "inputs": {"a": "source.1/a"}, "topics": {"b": ["/t"]}, **at},
        )
        document = {
            "format": "cfgplan/1",
            "horizon": 10,
            "hosts": [*self.hosts],
            "transformations": [source, sink],
            "units": [*(usual if self.units is None else self.units)],
            "targets": [self.target or {"label": "t", "topic": "/t", "tag": "B"}],
            **self.top,
        }
        return problem_of(document, folder)

    def where_it_does_nothing(self, plain: Problem, folder: Path, *, is_startable: bool) -> Problem:
        """A problem in whose library source and sink are too, which nothing wants; some input of them is never fed
        unless they are startable.
        """
        assert self.beside is not None
        said = {
            "format": "cfgplan/1",
            "hosts": [*self.hosts],
            "transformations": [
                {"label": "source", **self.source, "outputs": {"a": {"tag": "A", **self.gives}}},
                {"label": "sink", **self.sink, "inputs": {"a": {"tag": "A", **self.takes}}, "outputs": {"b": "B"}},
            ],
            **self.top,
        }
        said |= {key: [*said.get(key, ()), *more] for key, more in self.beside.items()}
        for transformation in said["transformations"]:
            if not is_startable:
                transformation["inputs"] = {**transformation.get("inputs", {}), "gap": "NothingGivesThis"}
            for key in ALWAYS_ASKED & transformation.keys():
                del transformation[key]
        small = problem_of(said, folder)
        environment = replace(
            small.environment,
            library=(*plain.environment.library, *small.environment.library),
            targets=plain.environment.targets,
        )
        similarity = Similarity({**plain.similarity.offers, **small.similarity.offers})
        return replace(plain, environment=environment, similarity=similarity, survive=small.survive)


def problem_of(document: Mapping[str, Any], folder: Path) -> Problem:
    file = folder / "env.yaml"
    file.write_text(yaml.safe_dump({key: value for key, value in document.items() if value}))
    return cfgplan.match(cfgplan.load(file))


def ports(environment: Environment) -> list[Any]:
    return [port for t in environment.library for port in t.inputs]


def outputs(environment: Environment) -> list[Any]:
    return [port for t in environment.library for port in t.outputs]


ONE, TWO = ({"name": "h"},), ({"name": "h"}, {"name": "k"})
APART = (
    {"id": "source.1", "transformation": "source", "host": "h"},
    {"id": "sink.1", "transformation": "sink", "host": "k", "inputs": {"a": "source.1/a"}, "topics": {"b": ["/t"]}},
)
STREAM = {"rate": 1, "size": 1_000_000}

WORDS: Mapping[str, Word] = {
    "count": Word(
        lambda e: any(port.count > 1 for port in ports(e)),
        takes={"count": 2},
        feature=Feature.COUNTS,
        broken="input a of unit sink.1 takes 2 streams, but has 1: source.1/a",
        never={"max_instances": 1},
        limit="`count` of input sink/a",
        shown="one of 2",
    ),
    "count: all": Word(
        lambda e: any(port.count == ALL for port in ports(e)),
        takes={"count": "all"},
        units=(
            {"id": "source.1", "transformation": "source"},
            {"id": "source.2", "transformation": "source"},
            {"id": "sink.1", "transformation": "sink", "inputs": {"a": "source.1/a"}, "topics": {"b": ["/t"]}},
        ),
        feature=Feature.COUNTS,
        broken="input a of unit sink.1 takes all that matches, but not source.2/a",
        shown="one of all",
    ),
    "optional": Word(
        lambda e: any(port.starts_nothing for port in ports(e)),
        source={"pinned": True},
        takes={"optional": True},
        units=(
            {"id": "source.1", "transformation": "source"},
            {"id": "sink.1", "transformation": "sink", "topics": {"b": ["/t"]}},
        ),
        feature=Feature.OPTIONAL,
        broken="optional input a of unit sink.1 is not fed, but source.1/a could feed it",
        shown="(a: not fed)",
    ),
    "worth": Word(
        lambda e: any(port.worth_us for port in ports(e)),
        takes={"optional": True, "worth": 0.5},
        units=({"id": "sink.1", "transformation": "sink", "topics": {"b": ["/t"]}},),
        feature=Feature.OPTIONAL,
        costs_us=5_000_000,
        shown="(a: not fed)",
    ),
    "kind: service": Word(
        lambda e: any(port.feedback for port in ports(e)),
        takes={"kind": "service"},
        shown="<-->",
    ),
    "serves": Word(
        lambda e: any(port.serves is not None for port in outputs(e)),
        gives={"serves": 1},
        units=(
            {"id": "source.1", "transformation": "source"},
            {"id": "sink.1", "transformation": "sink", "inputs": {"a": "source.1/a"}, "topics": {"b": ["/t"]}},
            {"id": "sink.2", "transformation": "sink", "inputs": {"a": "source.1/a"}},
        ),
        sink={"min_instances": 2},
        feature=Feature.LIMITS,
        broken="stream source.1/a feeds too many inputs and topics: 1 more than its output serves",
        never={"max_instances": 1},
        limit="`serves` of output source/a",
        shown="serves 1",
    ),
    "run": Word(
        lambda e: bool(e.wanted_to_run),
        target={"label": "shown", "run": "sink"},
        units=({"id": "source.1", "transformation": "source"},),
        feature=Feature.RUNS,
        broken="no unit of sink runs, which target shown wants",
        shown="shown",
        beside=None,
    ),
    "needs": Word(
        lambda e: any(t.needs for t in e.library) and any(host.offers for host in e.hosts),
        source={"needs": {"gpu": 1}},
        hosts=({"name": "h", "offers": {"gpu": 1}},),
        units=tuple({"id": f"source.{n}", "transformation": "source", "host": "h"} for n in (1, 2)),
        feature=Feature.HOSTS,
        broken="the units on h take 2 gpu, but it has 1 gpu",
        never={"needs": {"gpu": 2}},
        limit="`needs` of transformation source",
        shown="1 gpu",
    ),
    "memory": Word(
        lambda e: any(t.memory_mb for t in e.library) and any(host.memory_mb is not None for host in e.hosts),
        source={"memory": 6},
        hosts=({"name": "h", "memory": 10},),
        units=tuple({"id": f"source.{n}", "transformation": "source", "host": "h"} for n in (1, 2)),
        feature=Feature.HOSTS,
        broken="the units on h take 12 MB of memory, but it has 10 MB of memory",
        never={"memory": 11},
        limit="`memory` of host h",
    ),
    "on": Word(
        lambda e: any(t.on for t in e.library) and any(host.labels for host in e.hosts),
        source={"on": "not old"},
        hosts=({"name": "h", "labels": ["old"]}, {"name": "k"}),
        feature=Feature.HOSTS,
        broken="unit source.1 is on h, where source may not run",
        never={"on": "young"},
        limit="`on` of transformation source",
        shown="h (old)",
    ),
    "with": Word(
        lambda e: bool(e.companions),
        source={"with": ["sink"]},
        hosts=TWO,
        units=APART,
        feature=Feature.BESIDE,
        broken="unit source.1 runs on h without a unit of sink",
        never={"with": ["sink"], "conflicts": {"host": ["sink"]}},
        limit="`with` of transformation source",
    ),
    "per_host": Word(
        lambda e: any(t.per_host is not None for t in e.library),
        source={"per_host": 1},
        hosts=ONE,
        units=tuple({"id": f"source.{n}", "transformation": "source", "host": "h"} for n in (1, 2)),
        feature=Feature.INSTANCES,
        broken="2 units of source are on h, but it allows 1 on one host",
        never={"min_instances": 2},
        limit="`per_host` of transformation source",
    ),
    "at_most": Word(
        lambda e: any(t.at_most for t in e.library),
        source={"at_most": {"spot": 1}},
        hosts=({"name": "h", "labels": ["spot"]}, {"name": "k", "labels": ["spot"]}),
        units=tuple({"id": f"source.{n}", "transformation": "source", "host": "hk"[n - 1]} for n in (1, 2)),
        feature=Feature.INSTANCES,
        broken="2 units of source are on spot, but at most 1 may run on spot",
        never={"min_instances": 2},
        limit="`at_most` of transformation source",
        shown="(at most 1 on spot)",
    ),
    "conflicts: host": Word(
        lambda e: any(t.conflicts_on_host for t in e.library),
        source={"conflicts": {"host": ["sink"]}},
        hosts=ONE,
        feature=Feature.CONFLICTS,
        broken="units of source and sink are on h, which conflict on a host",
        never={},
        limit="`conflicts: host` of transformation source",
    ),
    "rent": Word(
        lambda e: any(host.rent_us for host in e.hosts),
        hosts=({"name": "h", "rent": 0.25},),
        feature=Feature.HOSTS,
        costs_us=12_500_000,
        shown="h, rent 0.25 s/s",
        beside={"hosts": [{"name": "free"}]},
    ),
    "speed": Word(
        lambda e: any(host.speed != 1_000_000 for host in e.hosts),
        hosts=({"name": "h", "speed": 0.5},),
        feature=Feature.HOSTS,
        costs_us=20_000_000,
        shown="h, speed 0.5",
        beside={"hosts": [{"name": "fast"}]},
    ),
    "energy": Word(
        lambda e: any(host.energy is not None for host in e.hosts),
        source={"needs": {"power": 2}},
        hosts=({"name": "h", "energy": 15},),
        feature=Feature.HOSTS,
        broken="the units on h take 20 W s of energy in 10 s, but it has 15 W s",
        never={},
        limit="`energy` of host h",
        shown="h, energy 15 W s",
    ),
    "copies": Word(
        None,
        source={"host": "h.2"},
        hosts=({"name": "h", "copies": 2},),
        units=({"id": "source.1", "transformation": "source", "host": "h.1"},),
        feature=Feature.HOSTS,
        broken="unit source.1 is on h.1, where source may not run",
    ),
    "bandwidth": Word(
        lambda e: any(link.bandwidth is not None for link in e.links),
        source={"host": "h"},
        sink={"host": "k"},
        gives=STREAM,
        hosts=TWO,
        units=APART,
        top={"links": [{"between": ["h", "k"], "bandwidth": 9}]},
        feature=Feature.HOSTS,
        broken="the link between h and k carries 1000000 bytes per second, but has a bandwidth of 9",
        never={},
        limit="`bandwidth` of link h - k",
    ),
    "price": Word(
        lambda e: any(link.price_us is not None for link in e.links),
        gives=STREAM,
        hosts=TWO,
        units=APART,
        top={"links": [{"between": ["h", "k"], "price": 0.1}]},
        feature=Feature.HOSTS,
        costs_us=11_000_000,
    ),
    "latency": Word(
        lambda e: any(link.latency for link in e.links),
        source={"host": "h"},
        sink={"host": "k"},
        hosts=TWO,
        units=APART,
        top={
            "qualities": [{"name": "delay", "better": "lower", "worst": 100}],
            "links": [{"between": ["h", "k"], "latency": 20, "adds": "delay"}],
        },
        gives={"quality": {"delay": {"set": 5}}},
        target={"label": "t", "topic": "/t", "tag": "B", "quality": {"delay": {"at_most": 10}}},
        feature=Feature.LATENCY,
        broken="target t asks for delay of at most 10, but its stream has 25",
        never={},
        limit="`quality` of target t",
        shown="delay 25",
    ),
    "minimise": Word(
        lambda e: len(e.minimise) > 1,
        hosts=ONE,
        top={"minimise": ["hosts"]},
        feature=Feature.ORDER,
    ),
    "survive": Word(
        lambda e: any(unit.standby for unit in e.units),
        top={"survive": "units"},
        feature=Feature.SURVIVAL,
        broken="if unit source.1 fails, nothing else can meet target t",
        never={"max_instances": 1},
        limit="`survive` of the environment",
        beside=None,
    ),
}

each_word = pytest.mark.parametrize("word", WORDS.values(), ids=list(WORDS))
KEYS = {"on": {"on", "labels"}, "needs": {"needs", "offers"}, "latency": {"latency", "adds"}}


def of_word(told: Callable[[Word], object]) -> pytest.MarkDecorator:
    """The words of which something is told."""
    rows = {name: word for name, word in WORDS.items() if told(word)}
    return pytest.mark.parametrize("word", rows.values(), ids=list(rows))


@cache
def schema() -> str:
    return api.schema_text()


@pytest.mark.parametrize("name", WORDS)
def test_the_schema_names_the_word(name: str) -> None:
    assert all(f'"{key}"' in schema() for key in KEYS.get(name, {name.partition(":")[0]}))


@each_word
def test_the_word_means_the_same_in_yaml_and_in_json(word: Word, tmp_path: Path) -> None:
    environment = word.problem(tmp_path).environment
    as_json = tmp_path / "env.json"
    as_json.write_text(json.dumps(yaml.safe_load((tmp_path / "env.yaml").read_text())))
    assert cfgplan.load(as_json).environment == environment
    again = tmp_path / "again.yaml"
    again.write_text(api.converted(as_json, "yaml"))
    assert cfgplan.load(again).environment == environment


@each_word
def test_a_planner_that_does_not_know_the_word_refuses_it_by_name(word: Word, tmp_path: Path) -> None:
    problem = word.problem(tmp_path)
    if word.feature is None:
        assert problem.is_plain
        return
    with pytest.raises(InputError, match=f"does not support .*{word.feature}"):
        PLANNERS["branch-and-bound"](problem)


@each_word
def test_the_planner_and_the_oracle_agree_on_the_word(word: Word, tmp_path: Path) -> None:
    problem = word.problem(tmp_path)
    plan, oracle = PLANNERS["cpsat"](problem), PLANNERS["exhaustive"](problem)
    assert cfgplan.plan_violations(problem, plan) == []
    assert (plan.status, plan.cost_us, plan.objectives) == (oracle.status, oracle.cost_us, oracle.objectives)


@of_word(lambda word: word.broken)
def test_the_judge_says_which_word_is_broken(word: Word, tmp_path: Path) -> None:
    problem = word.problem(tmp_path)
    found = cfgplan.violations(problem.environment, problem.similarity, problem.survive, problem.horizon_s)
    assert word.broken in [str(violation) for violation in found]


@of_word(lambda word: word.costs_us)
def test_the_judge_counts_what_the_word_costs(word: Word, tmp_path: Path) -> None:
    problem = word.problem(tmp_path)
    assert kept_us(problem.environment, problem.horizon_s) == word.costs_us


@of_word(lambda word: word.limit)
def test_the_word_is_named_where_it_forbids_every_plan(word: Word, tmp_path: Path) -> None:
    found = why_not(word.problem(tmp_path, is_asked_too_much=True), PLANNERS["cpsat"])
    assert found.clash is not None
    assert word.limit in map(str, found.clash.limits)


@of_word(lambda word: word.shown)
def test_a_picture_shows_the_word(word: Word, tmp_path: Path) -> None:
    assert word.shown in picture(word.problem(tmp_path).environment).mermaid()


@cache
def never_drawn() -> set[Callable[[Environment], bool]]:
    """The `drawn` conditions of words that no example of the oracle's generators meets."""
    missing = {word.drawn for word in WORDS.values() if word.drawn is not None}

    def are_all_drawn(problem: Problem) -> bool:
        missing.difference_update([is_drawn for is_drawn in missing if is_drawn(problem.environment)])
        return not missing

    with suppress(NoSuchExample):
        find(fleets(frozenset({*Feature}), most=2), are_all_drawn, settings=MANY)
    return missing


@of_word(lambda word: word.drawn)
def test_the_oracle_s_generators_draw_the_word(word: Word) -> None:
    assert word.drawn not in never_drawn()


def entered(problem: Problem) -> tuple[Plan, list[str]]:
    """A plan, and the stages that it took."""
    names: list[str] = []

    def noted(stage: Stage) -> Stage:
        def enter(work: SolveRun) -> bool:
            names.append(stage.__name__)
            return stage(work)

        return enter

    with patch.object(session, "STAGES", tuple(map(noted, STAGES))):
        return session.PlannerSession(is_asked_once=True).plan(problem), names


LIBRARIES = {
    "of what can't start": (random_library(5, transformations=200), False),
    "of what nothing wants": (random_library(3, transformations=100), True),
}


@pytest.fixture(scope="module", params=LIBRARIES)
def usual(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[str, Plan, list[str]]:
    """The plan for a library with the transformations of a row that say no word."""
    plain, is_startable = LIBRARIES[request.param]
    problem = Word(None).where_it_does_nothing(plain, tmp_path_factory.mktemp("usual"), is_startable=is_startable)
    assert problem.is_plain
    return request.param, *entered(problem)


@of_word(lambda word: word.beside is not None)
def test_the_word_costs_nothing_where_it_does_nothing(
    word: Word, usual: tuple[str, Plan, list[str]], tmp_path: Path
) -> None:
    """It changes neither cost nor proof nor the stages that are entered, nor how many booleans the model has."""
    name, before, usual_stages = usual
    plain, is_startable = LIBRARIES[name]
    said = word.where_it_does_nothing(plain, tmp_path, is_startable=is_startable)
    assert said.features or word.feature is None
    plan, stages = entered(said)
    assert cfgplan.plan_violations(said, plan) == []
    assert plan.change_set is not None
    assert before.change_set is not None
    assert [unit.id for unit in plan.change_set.started] == [unit.id for unit in before.change_set.started]
    assert (plan.status, plan.cost_us, plan.bound_us, plan.ties_proven) == (
        before.status,
        before.cost_us,
        before.bound_us,
        before.ties_proven,
    )
    assert (stages, plan.counts) == (usual_stages, before.counts)
