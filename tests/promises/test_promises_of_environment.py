"""What `manual/environment.md` promises, a test for each sentence above its tables.

The tables are written by `tests/test_manual.py`, the JSON Schema is held against the loader by
`tests/formats/test_schema_and_loader.py`, the paper's XML by `tests/formats/test_xml.py`, tags and ontologies by
`tests/matching`, faults by `tests/formats/test_environment_faults.py`.
"""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from promised import solved

import cfgplan
from cfgplan.errors import InputError

ROOMS = """\
@prefix : <https://example.org/r#> . @prefix owl: <http://www.w3.org/2002/07/owl#> . @prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> .
<https://example.org/r> a owl:Ontology .
:NAO a owl:Class . :Small a owl:Class ; rdfs:subClassOf :NAO . :Image a owl:Class . :of a owl:ObjectProperty .
:piff a owl:NamedIndividual , :NAO . :puff a owl:NamedIndividual , :Small .
"""  # noqa: E501


def test_unknown_keys_dangling_references_bad_tags_and_bad_costs_are_told_at_once_with_place_and_mend(
    tmp_path: Path,
) -> None:
    text = """\
transformations:
  - {label: s, upkep: 1, outputs: {x: A}}
  - {label: f, labor: much, inputs: {x: "A and"}}
units: [{id: s.1, transformation: gone}]
"""
    with pytest.raises(InputError) as caught:
        solved(tmp_path, text)
    faults = caught.value.faults
    assert [fault.line for fault in faults] == [4, 5, 5, 6]
    assert all(fault.file and fault.column and fault.mend for fault in faults)


def test_the_same_document_is_read_as_json(tmp_path: Path) -> None:
    data = {"format": "cfgplan/1", "transformations": [{"label": "s", "outputs": {"x": "A"}}]}
    (path := tmp_path / "env.json").write_text(json.dumps(data))
    assert [one.label for one in cfgplan.load(path).environment.library] == ["s"]


SERVED = """\
transformations:
  - {{label: s, labor: 1, max_instances: {most}, outputs: {{x: A}}}}
  - {{label: f, inputs: {{x: {{tag: A, count: {count}{more}}}}}, outputs: {{y: B}}}}
targets: [{{label: t, topic: /t, tag: B}}{also}]
"""


def test_an_input_with_count_takes_streams_of_different_units_unless_max_instances_says_less(tmp_path: Path) -> None:
    found = solved(tmp_path, SERVED.format(most=3, count=3, more="", also=""))
    assert len({stream.unit for stream in found.unit("f.1").feeds["x"]}) == 3
    assert solved(tmp_path, SERVED.format(most=2, count=3, more="", also="")).plan.status == "infeasible"


ALSO = ", {label: u, topic: /u, tag: A}"


def test_count_all_takes_every_stream_of_other_running_units_that_matches_and_at_least_one(tmp_path: Path) -> None:
    text = SERVED.format(most=3, count="all", more="", also="").replace("max_instances: 3", "min_instances: 2")
    assert len(solved(tmp_path, text).unit("f.1").feeds["x"]) == 2
    found = solved(tmp_path, SERVED.format(most=1, count="all", more="", also=""))
    assert [str(stream) for stream in found.unit("f.1").feeds["x"]] == ["s.1/x"]


def test_optional_with_count_all_stays_unfed_only_where_no_stream_of_another_running_unit_matches(
    tmp_path: Path,
) -> None:
    more = ", optional: true"
    assert solved(tmp_path, SERVED.format(most=1, count="all", more=more, also="")).unit("f.1").feeds.get("x", ()) == ()
    fed = solved(tmp_path, SERVED.format(most=1, count="all", more=more, also=ALSO))
    assert [str(stream) for stream in fed.unit("f.1").feeds["x"]] == ["s.1/x"]
    limited = SERVED.format(most=1, count="all", more=more, also=ALSO).replace("{x: A}", "{x: {tag: A, serves: 1}}")
    assert solved(tmp_path, limited).plan.status == "infeasible", "the topic takes it, and the input must"


def test_an_optional_input_is_fed_wherever_what_runs_anyway_may_feed_it_and_starts_nothing(tmp_path: Path) -> None:
    more = ", optional: true"
    assert solved(tmp_path, SERVED.format(most=1, count=1, more=more, also="")).runs == ["f"]
    found = solved(tmp_path, SERVED.format(most=1, count=1, more=more, also=ALSO))
    assert [str(stream) for stream in found.unit("f.1").feeds["x"]] == ["s.1/x"]


@pytest.mark.parametrize(("worth", "runs"), [(0.09, ["f"]), (0.11, ["f", "s"])])
def test_an_unfed_input_costs_its_worth_each_second(worth: float, runs: list[str], tmp_path: Path) -> None:
    """To start what feeds it costs 1 s, and the horizon is 10 s."""
    more = f", optional: true, worth: {worth}"
    found = solved(tmp_path, SERVED.format(most=1, count=1, more=more, also=""))
    assert found.runs == runs
    assert found.cost_s == pytest.approx(1 + min(1, 10 * worth))


def test_a_service_may_close_a_cycle(tmp_path: Path) -> None:
    text = """\
transformations:
  - {{label: a, inputs: {{x: {{tag: B, kind: {kind}}}}}, outputs: {{y: A}}}}
  - {{label: b, inputs: {{x: A}}, outputs: {{y: B}}}}
targets: [{{label: t, topic: /t, tag: A}}]
"""
    assert solved(tmp_path, text.format(kind="service")).runs == ["a", "b"]
    assert solved(tmp_path, text.format(kind="stream")).plan.status == "infeasible"


def test_a_target_without_topic_and_tag_wants_a_unit_of_a_transformation_that_gives_nothing(tmp_path: Path) -> None:
    text = """\
transformations: [{label: s, outputs: {x: A}}, {label: display, inputs: {x: A}}]
targets: [{label: shown, run: display}]
"""
    assert solved(tmp_path, text).runs == ["display", "s"]


def test_a_required_transformation_is_used_by_some_target_if_that_is_possible_at_all(tmp_path: Path) -> None:
    text = """\
transformations:
  - {{label: cheap, labor: 1, outputs: {{x: A}}}}
  - {{label: dear, labor: 9, required: true, {needs}outputs: {{x: A}}}}
targets: [{{label: t, topic: /t, tag: A}}]
"""
    assert solved(tmp_path, text.format(needs="")).runs == ["dear"]
    assert solved(tmp_path, text.format(needs="inputs: {y: Nowhere}, ")).runs == ["cheap"]


def library_of(folder: Path, text: str) -> list[str]:
    (folder / "r.ttl").write_text(ROOMS)
    (path := folder / "env.yaml").write_text(f"format: cfgplan/1\nontology: r.ttl\ntransformations:\n  - {text}\n")
    return [one.label for one in cfgplan.load(path).environment.library]


def test_a_template_makes_one_transformation_for_every_individual_asserted_or_inferred(tmp_path: Path) -> None:
    assert library_of(tmp_path, '{label: "cam(${NAO})", outputs: {x: Image}}') == ["cam(piff)", "cam(puff)"]


def test_two_named_variables_range_over_a_class_each(tmp_path: Path) -> None:
    made = library_of(tmp_path, '{label: "fuse(${NAO:a},${NAO:b})", outputs: {x: Image}}')
    assert made == [f"fuse({a},{b})" for a in ("piff", "puff") for b in ("piff", "puff")]


def test_a_doubled_dollar_is_a_plain_one(tmp_path: Path) -> None:
    assert library_of(tmp_path, '{label: "cam($${NAO})", outputs: {x: Image}}') == ["cam(${NAO})"]


def test_without_an_ontology_every_name_in_a_tag_is_free(tmp_path: Path) -> None:
    text = """\
transformations: [{label: s, outputs: {x: Thing and hasSource value Nothing}}]
targets: [{label: t, topic: /t, tag: "hasSource value Nothing"}]
"""
    assert solved(tmp_path, text).runs == ["s"]


def test_a_predicate_of_the_paper_says_what_its_concept_says(tmp_path: Path) -> None:
    text = """\
transformations: [{label: s, outputs: {x: Undistorted(cam1)}}]
targets: [{label: t, topic: /t, tag: "Undistorted and hasSource some {cam1}"}]
"""
    assert solved(tmp_path, text).runs == ["s"]
