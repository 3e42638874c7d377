"""What the command line says where it is not decided of a pair of tags whether it matches."""

from __future__ import annotations

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
    env.write_text(ENVIRONMENT.replace("  - {label: dear, labor: 100, upkeep: 1, outputs: {o: W}}\n", ""))
    result = run("solve", env, "--best-effort", "--reasoner", "el")
    assert result.code == 21
    assert "target t wants W, but nobody knows yet whether C is W" in result.out


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
