"""No word of an environment file does nothing in silence: it changes what is planned or run, or a warning names it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml
from command import Run

import cfgplan
from cfgplan import answers
from cfgplan.cli.idle_words import idle_words
from cfgplan.errors import InputError
from cfgplan.formats import fields
from cfgplan.formats.fields import Part
from cfgplan.rows import running
from cfgplan.transformations import running_fields

TABLES = yaml.safe_load(Path(__file__).with_name("idle_words.yaml").read_text())
EFFECTS: dict[str, str] = TABLES["effects"]
"""For each key an environment in which it has an effect."""
DESCRIBING = {
    "AttributePart.unit": "it is printed behind values",
    "FactPart.unit": "it is printed behind values",
    "IncludedPart.format": "an included file may say what it is",
    "IncludedPart.transformations": "as in an environment",
    "IncludedPart.targets": "as in an environment",
    "EnvironmentPart.transformations": "none of its keys is left if it is absent",
}
"""The keys without such an environment, with the reason."""

IDLE = [(each["told"], each["text"]) for each in TABLES["idle"]]
"""What is said of a word, and an environment in which it has no effect."""
OWL = "@prefix owl: <http://www.w3.org/2002/07/owl#> ."
FILES = {
    "o.ttl": f"{OWL} @prefix one: <x:> . @prefix s: <http://www.w3.org/2000/01/rdf-schema#> . <x:o> a owl:Ontology . "
    "<x:X> a owl:Class . <x:S> a owl:Class . <x:Y> a owl:Class ; s:subClassOf <x:X> .",
    "p.ttl": f"{OWL} <y:p> a owl:Ontology . <y:X> a owl:Class .",
    "i.ttl": f"{OWL} <x:i> a owl:Ontology ; owl:imports <x:absent> .",
    "r.ofn": "Ontology(<x:o> Declaration(Class(<x:X>)) Declaration(Class(<x:Y>)) Declaration(NamedIndividual(<x:i>)) "
    "ClassAssertion(<x:Y> <x:i>) "
    "DLSafeRule(Body(ClassAtom(<x:Y> Variable(<v:v>))) Head(ClassAtom(<x:X> Variable(<v:v>)))))",
    "more.yaml": "transformations: [{label: a, outputs: {o: X}}]\n",
}
"""The files that the environments name."""


def written(text: str, folder: Path) -> Path:
    """The file of an environment of the tables."""
    for name, content in FILES.items():
        (folder / name).write_text(content)
    lines = text.splitlines()
    head = [line for line in lines if not line.startswith("- ")]
    head += [] if "targets:" in text else ["targets: [{label: t, topic: /t, tag: X}]"]
    library = [line for line in lines if line.startswith("- ")]
    path = folder / "env.yaml"
    path.write_text("\n".join(["format: cfgplan/1", *head, "transformations:", *library]) + "\n")
    return path


def cut(text: str) -> str:
    """The environment without what stands between the marks."""
    return text.partition("«")[0] + text.partition("»")[2]


def kept(text: str) -> str:
    return text.replace("«", "").replace("»", "")


def outcome(path: Path) -> Any:
    """What is planned, and what a run is told; of a file that is refused, only that."""
    try:
        world = cfgplan.load(path, use_cache=False)
    except InputError:
        return "refused"
    found = answers.best_effort(cfgplan.match(world), planner="cpsat")
    environment = world.environment
    told = [
        *map(running_fields, environment.library),
        *map(running, environment.targets),
        *map(running, environment.facts),
    ]
    return found.plan.status, found.plan.cost_us, found.plan.change_set, found.given_up, told


def warnings(path: Path) -> list[str]:
    return [fault.message for fault in idle_words(cfgplan.load(path, use_cache=False))]


@pytest.mark.parametrize("key", EFFECTS)
def test_a_word_with_an_effect_changes_a_plan_or_a_run_and_no_warning_names_it(key: str, tmp_path: Path) -> None:
    text = EFFECTS[key]
    assert not any(f"{key.partition('.')[2]}` " in each for each in warnings(written(kept(text), tmp_path)))
    if key not in DESCRIBING:
        assert outcome(written(kept(text), tmp_path)) != outcome(written(cut(text), tmp_path))


@pytest.mark.parametrize(("told", "text"), IDLE)
def test_a_warning_names_a_word_without_effect_and_is_true(told: str, text: str, tmp_path: Path) -> None:
    assert [each for each in warnings(written(kept(text), tmp_path)) if each.startswith(told)]
    assert not [each for each in warnings(written(cut(text), tmp_path)) if each.startswith(told)]
    assert outcome(written(kept(text), tmp_path))[:-1] == outcome(written(cut(text), tmp_path))[:-1]


def test_each_field_of_a_file_is_in_the_table() -> None:
    parts = [each for each in vars(fields).values() if isinstance(each, type) and issubclass(each, Part)]
    keys = {f"{part.__name__}.{key}" for part in parts for key, row in part.rows().items() if row.default is not ...}
    assert keys == {*EFFECTS, *DESCRIBING}


def test_solve_check_and_run_warn_at_the_place_of_the_word(run: Run, tmp_path: Path) -> None:
    path = written("- {label: a, source: 'x.py:X', run: {queue: 1}, outputs: {o: X}}\n", tmp_path)
    (tmp_path / "x.py").write_text("class X: pass\n")
    for command in (("check", path), ("solve", path), ("run", path, "--dry-run")):
        err = run(*command).err
        assert "env.yaml:4:38: transformations[0].run.queue: `run.queue` of a has no effect" in err


def test_warnings_are_in_the_order_of_the_file_and_name_the_place_of_each_word(run: Run, tmp_path: Path) -> None:
    text = """
transfer: 1
- {label: b, run: {queue: 1}, outputs: {p: Y}}
- {label: a, run: {tolerance: 1}, inputs: {i: Y}, outputs: {o: X}}
"""
    err = run("check", written(text, tmp_path)).err
    places = [line.split()[1] for line in err.splitlines() if line.startswith("warning: ")]
    assert [each.partition("env.yaml")[2] for each in places] == [":3:1:", ":6:20:", ":7:20:"]


def test_a_run_measures_what_units_take_of_a_limited_host(tmp_path: Path) -> None:
    path = written("hosts: [{name: h, cpu: 1}]\n- {label: a, source: 'x.py:X', outputs: {o: X}}\n", tmp_path)
    assert not warnings(path)


def test_a_library_may_say_more_than_an_environment_that_includes_it_wants(run: Run, tmp_path: Path) -> None:
    path = written("include: library.yaml\n", tmp_path)
    (tmp_path / "library.yaml").write_text(
        "transformations: [{label: a, on: gpu, memory: 5, outputs: {o: {tag: X, quality: {q: 1}}}}]\n"
    )
    assert not warnings(path)
    assert "no effect" not in run("check", path).err


def test_a_library_may_be_checked_alone(tmp_path: Path) -> None:
    path = written("targets: []\n- {label: a, on: gpu, memory: 5, outputs: {o: {tag: X, quality: {q: 1}}}}\n", tmp_path)
    assert not warnings(path)


def test_the_limit_of_a_processor_counts_where_a_run_measures_upkeep(tmp_path: Path) -> None:
    path = written("hosts: [{name: h, cpu: 1}]\n- {label: a, source: 'x.py:X', outputs: {o: X}}\n", tmp_path)
    assert not warnings(path)
