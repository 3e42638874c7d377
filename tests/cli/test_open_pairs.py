"""What the command line says where it is not decided of a pair of tags whether it matches."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from command import Run

ONTOLOGY = """\
@prefix : <http://e/h#> .
@prefix owl: <http://www.w3.org/2002/07/owl#> .
@prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> .
<http://e/h> a owl:Ontology .
:A a owl:Class . :B a owl:Class . :C a owl:Class . :W a owl:Class .
:A rdfs:subClassOf :W . :B rdfs:subClassOf :W .
:C rdfs:subClassOf [ a owl:Class ; owl:unionOf ( :A :B ) ] .
"""
ENVIRONMENT = """\
format: cfgplan/1
ontology: ontology.ttl
horizon: 60
transformations:
  - {label: dear, labor: 100, upkeep: 1, outputs: {o: W}}
  - {label: cheap, labor: 1, upkeep: 0.1, outputs: {o: C}}
targets:
  - {label: t, topic: /t, tag: W}
"""
DEAR = "  - {label: dear, labor: 100, upkeep: 1, outputs: {o: W}}\n"
RUNNING = "units:\n  - {id: cheap.1, transformation: cheap, topics: {o: [/t]}}\n"


@pytest.fixture
def env(tmp_path: Path) -> Path:
    (tmp_path / "ontology.ttl").write_text(ONTOLOGY)
    path = tmp_path / "env.yaml"
    path.write_text(ENVIRONMENT)
    return path


def test_what_hermit_decides_is_proven(run: Run, env: Path) -> None:
    assert (result := run("solve", env, "--json")).code == 0
    assert (result.document["cost_us"], result.document["undecided"]) == (7_000_000, [])


def test_how_many_pairs_were_asked_and_who_decided_the_others(run: Run, env: Path) -> None:
    counts = run("solve", env, "--json", "--no-cache").document["counts"]
    pairs = {name: count for name, count in counts.items() if name.startswith("pairs ")}
    assert pairs == {"pairs decided by el": 1, "pairs decided by hermit": 1, "pairs asked": 1}
    told = "HermiT was asked about 1 pair of tags. Decided: 1 by el, 1 by hermit."
    assert told in run("solve", env, "--no-cache").out
    assert told not in run("solve", env, "--reasoner", "el").out


@pytest.mark.parametrize("options", [("--reasoner", "el"), ("--reasoner-timeout", "0.01")])
def test_what_nobody_decides_is_named_and_nothing_is_called_optimal(
    run: Run, env: Path, options: tuple[str, ...]
) -> None:
    result = run("solve", env, *options)
    assert result.code == 20
    assert "no update costs less than 7 s" in result.out
    assert "Not decided: whether `C` is `W` (cheap/o -> target t).\nIf so, an update for 7 s may exist." in result.out
    document = run("solve", env, *options, "--json").document
    assert (document["status"], document["cost_us"], document["bound_us"]) == ("feasible", 160_000_000, 7_000_000)
    assert document["undecided"] == [["C", "W"]]


def test_no_time_for_hermit_is_no_proof_that_there_is_no_plan(run: Run, env: Path) -> None:
    result = run("solve", env, "--reasoner", "hermit", "--reasoner-timeout", "0.01")
    assert (result.code, "Not decided: whether `C` is `W`" in result.out) == (21, True)
    assert run("explain", env, "--reasoner", "hermit", "--reasoner-timeout", "0.01").code == 21


def test_a_target_that_an_open_pair_may_meet_is_not_called_impossible(run: Run, env: Path) -> None:
    env.write_text(ENVIRONMENT.replace(DEAR, ""))
    result = run("solve", env, "--best-effort", "--reasoner", "el")
    assert result.code == 21
    assert "target t wants W, but it is not decided yet whether C is W" in result.out


def test_what_an_open_pair_may_meet_besides_is_left_open(run: Run, env: Path) -> None:
    env.write_text(ENVIRONMENT.replace(DEAR, "") + "  - {label: u, topic: /u, tag: C}\n")
    result = run("solve", env, "--best-effort", "--reasoner", "el")
    assert result.code == 20
    assert "target t wants W, but it is not decided yet whether C is W" in result.out
    assert "whether more targets can be met depends on 1 pair of undecided tags" in result.err
    assert "time ran out" not in result.err
    (env.parent / "units.py").write_text("def cheap():\n    yield 1\n")
    env.write_text(env.read_text().replace("label: cheap,", "label: cheap, source: 'units.py:cheap',"))
    run_dry = run("run", env, "--dry-run", "--reasoner", "el")
    assert (run_dry.code, "it is not decided yet whether C is W" in run_dry.out) == (20, True)


def test_explain_names_the_pair_that_no_plan_can_do_without(run: Run, env: Path) -> None:
    env.write_text(ENVIRONMENT.replace(DEAR, ""))
    result = run("explain", env, "--reasoner", "el")
    assert result.code == 21
    assert "Not decided: whether `C` is `W` (cheap/o -> target t)." in result.out


def test_a_reason_says_of_what_may_match_that_nobody_has_decided_it(run: Run, env: Path) -> None:
    env.write_text(ENVIRONMENT.replace(DEAR, "").replace("outputs: {o: C}", "inputs: {i: B}, outputs: {o: C}"))
    result = run("explain", env, "--reasoner", "el")
    assert result.code == 10
    assert "not decided yet whether cheap matches" in result.out
    document = run("explain", env, "--reasoner", "el", "--json").document
    assert document["unreachable"][0]["wanted"]["undecided"] == ["cheap"]


@pytest.mark.parametrize("verb", ["graph", "sensitivity", "alternatives", "front"])
def test_whatever_else_is_asked_claims_nothing_that_hangs_on_an_open_pair(run: Run, env: Path, verb: str) -> None:
    if verb == "front":
        env.write_text(f"{ENVIRONMENT}qualities:\n  - {{name: q, better: lower, rule: add, worst: 5}}\n")
    words = {"alternatives": ("solve", "--alternatives", "2"), "front": ("solve", "--front", "t:q")}.get(verb, (verb,))
    result = run(words[0], env, *words[1:], "--reasoner", "el")
    assert result.code == (21 if verb == "front" else 20)
    assert not re.search("[Oo]ptimal|proven", re.sub("(not|were) proven( it)?( optimal)?", "", result.out))


def test_the_next_alternative_is_not_searched_for_ever_where_an_open_pair_decides_it(run: Run, env: Path) -> None:
    env.write_text(ENVIRONMENT.replace(DEAR, DEAR + DEAR.replace("dear", "other").replace("100", "0.1")))
    env.write_text(env.read_text().replace("labor: 0.1, upkeep: 1", "labor: 0.1, upkeep: 0"))
    result = run("solve", env, "--alternatives", "3", "--reasoner", "el", "--json")
    assert (result.code, result.document["complete"], result.document["has_more"]) == (20, False, True)
    assert [plan["cost_us"] for plan in result.document["alternatives"]] == [100_000]


def test_one_pair_and_what_comes_nearest_are_asked_within_the_limit(run: Run, env: Path) -> None:
    slow = ("--reasoner", "hermit", "--reasoner-timeout", "0.01")
    result = run("match", env, "cheap/o", "t", *slow)
    assert (result.code, "C  may feed  W" in result.out) == (0, True)


def test_the_matrix_marks_what_is_open(run: Run, env: Path) -> None:
    result = run("match", env, "--reasoner", "el")
    assert "  <- dear/o\n  ?? cheap/o" in result.out
    assert "1 pair of tags not decided" in result.out
    assert run("match", env, "--reasoner", "el", "--json").document["unknown"] == [["C", "W"]]
    assert "??" not in run("match", env, "--decide").out


def test_a_running_configuration_that_hangs_on_an_open_pair_is_neither_valid_nor_broken(run: Run, env: Path) -> None:
    env.write_text(ENVIRONMENT + RUNNING)
    result = run("check", env, "--reasoner", "el")
    assert (result.code, "it is not decided whether the running configuration is valid" in result.out) == (20, True)
    assert run("check", env, "--reasoner", "el", "--json").document["valid"] is None
    assert run("check", env).code == 0
