"""No sentence of `explain` ends without its reason: over random environments, and for the smallest that did."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cfgplan.cli import main
from cfgplan.cli.explain import pinned_lines, table_lines, unused_lines, why_not_told, why_text
from cfgplan.cli.plan_text import verdict
from cfgplan.explaining import unreachable, why_not, why_transformation
from cfgplan.explaining.what_if import running
from cfgplan.planners import PLANNERS
from cfgplan.planning import REFUSED, Feature, Problem
from cfgplan.reasons import pinned_reasons

sys.path.append(str(Path(__file__).parents[1] / "planners"))
from fleets import KNOWN_TO_BOUNDS, fleets
from worlds import fusions, problems

EMPTY = re.compile(
    r":\s*$|^\s*:|\(\s*\)|\[\s*\]|,\s*,|\s,|: *(;|,)|\b(and|with|by|of|for|without|wants|gives|is) *($|[.;:,])|  (?=\S)"
)
"""An empty list, a colon with nothing behind it, a word that wants another."""
ASKED = st.one_of(
    problems(),
    fusions(),
    fleets(KNOWN_TO_BOUNDS, most=2),
    fleets(frozenset({Feature.HOSTS, Feature.INSTANCES, Feature.CONFLICTS})),
    fleets(frozenset({Feature.OPTIONAL, Feature.COUNTS, Feature.LIMITS})),
    fleets(frozenset({Feature.BESIDE, Feature.HOSTS}), most=2),
)


def said(problem: Problem) -> list[str]:
    """All that `explain` says of a problem, line by line."""
    planner = PLANNERS["cpsat"]
    plan = planner(problem)
    if plan.change_set is None:
        why = why_not(problem, planner)
        text = why_not_told(problem, why).text.plain
        assert text or plan.status not in REFUSED, "no plan, and nothing says why"
        return [verdict(problem, plan).plain, *text.splitlines()]
    whys = [why_transformation(problem, planner, plan, t.label) for t in problem.environment.library]
    lines = [line for why in whys for line in why_text(why).plain.splitlines()]
    for line in table_lines(whys):
        assert line.split("  ")[-1].strip() not in ("forced", "a tie", "not decided"), line
        lines.append(line.rpartition("  ")[2])
    if plan.unused_required:
        for each in why_not(problem, planner).unused:
            lines += unused_lines(problem, each)
    for unit in pinned_reasons(problem):
        label = problem.environment.unit[unit].transformation
        (why_unfed,) = unreachable(running(problem, label))
        lines += pinned_lines(problem.environment, unit, why_unfed)
    return lines


@settings(max_examples=150, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
@given(problem=ASKED)
def test_every_line_of_explain_says_what_it_begins_to_say(problem: Problem) -> None:
    assert [line for line in said(problem) if EMPTY.search(line.strip())] == []


def explained(folder: Path, text: str, capsys: pytest.CaptureFixture[str], *subject: str) -> str:
    (env := folder / "env.yaml").write_text(f"format: cfgplan/1\nhorizon: 10\n{text}")
    main(["explain", str(env), *subject])
    return capsys.readouterr().out


def test_limits_that_forbid_every_configuration_are_named_without_any_target(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = (
        "hosts: [{name: h, cpu: 1}]\ntransformations: [{label: a, upkeep: 0.6, min_instances: 2, max_instances: 2}]\n"
    )
    out = explained(tmp_path, text, capsys)
    assert "no configuration is valid, not even without any target" in out
    assert "`min_instances` of transformation a" in out
    assert "`cpu` of host h" in out


def test_a_tag_that_is_misspelt_gets_the_nearest_one_without_an_ontology_too(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = """\
transformations:
  - {label: camera, outputs: {image: camera_image}}
  - {label: other, outputs: {text: greeting}}
  - {label: detector, inputs: {image: camera_imagee}, outputs: {bbox: box}}
targets: [{label: p, topic: /p, tag: box}]
"""
    out = explained(tmp_path, text, capsys)
    assert "nearest: camera/image gives camera_image: lacks camera_imagee" in out
    assert "greeting" not in out


def test_what_a_required_transformation_gives_is_named_if_nothing_takes_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = """\
transformations:
  - {label: s, outputs: {x: A}}
  - {label: greeter, required: true, outputs: {hello: Greeting}}
targets: [{label: t, topic: /t, tag: A}]
"""
    assert "no input and no target matches Greeting" in explained(tmp_path, text, capsys)


def test_forced_and_a_tie_say_why(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = """\
transformations:
  - {label: one, outputs: {x: A}}
  - {label: two, outputs: {x: A}}
  - {label: only, inputs: {x: A}, outputs: {y: B}}
targets: [{label: t, topic: /t, tag: B}]
"""
    out = explained(tmp_path, text, capsys)
    assert "needed: without it, target t wants B, but no output matches" in out
    assert "a tie: two would run instead, without one" in out


def test_what_takes_the_place_of_a_unit_says_that_it_has_to_be_started(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = """\
transformations: [{label: s, labor: 0.5, outputs: {x: A}}]
units: [{id: s.1, transformation: s}]
targets: [{label: t, topic: /t, tag: A}]
"""
    out = explained(tmp_path, text, capsys, "--unit", "s.1")
    assert "costs 0.5 s more" in out
    assert "another unit of its transformation would be started in its place" in out
