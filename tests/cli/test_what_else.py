"""Alternatives, what-if and best effort as a user and as a script see them."""

from __future__ import annotations

import json
import shlex
from collections.abc import Callable
from pathlib import Path

import pytest
from command import MODELS, Run

NAO = MODELS / "nao"
FUSION = NAO / "4-fusion-available.yaml"
THREE = """
max_cost: 5
transformations:
  - {label: x, labor: 3, outputs: {o: A}}
  - {label: y, labor: 4, outputs: {o: B}}
targets:
  - {label: a, topic: /a, tag: A}
  - {label: b, topic: /b, tag: B, priority: 1}
  - {label: c, topic: /c, tag: C, priority: 2}
"""


def test_the_three_ways_to_get_the_balls_position_of_section_v_c_are_the_alternatives(run: Run) -> None:
    document = run("solve", FUSION, "--alternatives", "5", "--json").document
    assert [plan["cost_us"] for plan in document["alternatives"]] == [18_600_000, 20_550_000, 39_900_000]
    assert (document["complete"], document["has_more"]) == (True, False)
    out = run("solve", FUSION, "--alternatives", "5").out
    assert "2. 20.55 s (+1.95 s): 6 to start, 0 to rewire, 6 to stop, 0 kept as they are" in out
    assert "3. 39.9 s (+21.3 s): 7 to start, 1 to rewire, 0 to stop, 5 kept as they are" in out
    assert "There are no others." in out


def test_the_first_alternative_is_the_plan(run: Run, tmp_path: Path) -> None:
    out = tmp_path / "plan.json"
    assert run("solve", FUSION, "--alternatives", "1", "--out", out).code == 0
    best, plan = json.loads(out.read_text()), run("solve", FUSION, "--json").document
    assert (best["status"], best["change_set"]) == (plan["status"], plan["change_set"])


def test_without_a_plan_there_are_no_alternatives_but_the_reasons(run: Run) -> None:
    result = run("solve", NAO / "0-target-only.yaml", "--alternatives", "3")
    assert result.code == 10
    assert "no output matches" in result.out


def test_what_is_supposed_to_be_gone_is_done_without(run: Run) -> None:
    assert "20.55 s of CPU" in run("solve", FUSION, "--without", "segmenter(piff)").out
    assert "18.95 s of CPU" in run("solve", FUSION, "--without", "segmenter(piff).1").out
    assert "0 to start, 0 to rewire, 6 to stop" in run("solve", FUSION, "--without", "ball").out


def test_a_name_of_several_kinds_is_done_without_by_its_kind(run: Run, write: Callable[[str], Path]) -> None:
    env = write(
        "transformations:\n"
        "  - {label: heat, outputs: {t: Heat}}\n"
        "  - {label: stove, labor: 5, outputs: {t: Heat}}\n"
        "targets:\n"
        "  - {label: heat, topic: /heat, tag: Heat}\n"
        "  - {label: unit heat, topic: /more, tag: Heat}\n"
        "units: [{id: heat, transformation: heat}]\n"
    )
    told = run("solve", env, "--without", "heat")
    assert told.code == 30
    assert "`heat` names a transformation, a unit and a target" in told.err
    assert "write `transformation heat` or `unit heat` or `target heat`" in told.err
    assert "stove.1" in run("solve", env, "--without", "transformation heat").out
    without_target = run("solve", env, "--without", "target heat").out
    assert "/more" in without_target
    assert "/heat" not in without_target
    without_both = run("solve", env, "--without", "unit heat", "--without", "target heat").out
    assert "/more" not in without_both
    assert "did you mean `heat`?" in run("solve", env, "--without", "haet").err


def test_costs_and_the_horizon_can_be_supposed(run: Run) -> None:
    assert "20.55 s of CPU" in run("solve", FUSION, "--set", "segmenter(piff).upkeep=0.5").out
    assert "horizon of 7 s" in run("solve", FUSION, "--set", "horizon=7").out
    assert "39.9 s of CPU" in run("solve", FUSION, "--set", "fuse_ball_pos.required=true").out
    assert run("solve", FUSION, "--set", "max_cost=1").code == 11


def test_a_file_of_transformations_can_be_supposed_to_be_included(run: Run, tmp_path: Path) -> None:
    more = tmp_path / "more.yaml"
    more.write_text(
        "format: cfgplan/1\ntransformations:\n"
        "  - {label: oracle, labor: 0.1, outputs: {ball: Position and hasSource some Ball}}\n"
    )
    assert "+ start   oracle.1" in run("solve", FUSION, "--with", more).out
    assert "oracle.1" in run("graph", FUSION, "--with", more, "--format", "dot").out
    more.write_text("format: cfgplan/1\ntransformations:\n  - {label: oracle, outputs: {ball: Nonsense and}}\n")
    result = run("solve", FUSION, "--with", more)
    assert result.code == 30
    assert "more.yaml:3" in result.err


def test_what_can_not_be_supposed_is_bad_input_all_at_once(run: Run) -> None:
    result = run("solve", FUSION, "--set", "segmenter(piff).upkep=1", "--set", "fuse.labor=1", "--set", "horizon=x")
    assert result.code == 30
    assert result.err.count("error:") == 3
    assert run("solve", FUSION, "--set", "horizon").code == 30
    assert "did you mean `segmenter(piff)`?" in run("solve", FUSION, "--without", "segmentor(piff)").err


def test_a_plan_of_a_supposed_world_is_stale_for_the_real_one(run: Run) -> None:
    real = run("solve", FUSION, "--json").document["environment"]
    assert run("solve", FUSION, "--json", "--set", "segmenter(puff).upkeep=1").document["environment"] != real


def test_best_effort_meets_what_matters_most_and_says_why_not_the_rest(run: Run, write: Callable[[str], Path]) -> None:
    env = write(THREE)
    result = run("solve", env, "--best-effort")
    assert result.code == 12
    assert "Given up: 2 of 3 targets." in result.out
    assert "target a wants A, but with the targets that are met it would cost 7 s, and 5 s is allowed" in result.out
    assert "target c wants C, but no output matches" in result.out
    document = run("solve", env, "--best-effort", "--json").document
    assert [unit["id"] for unit in document["change_set"]["started"]] == ["y.1"]
    assert sorted(document["reasons"]) == ["a", "c"]
    assert run("solve", env, "--best-effort", "--without", "a", "--without", "c").code == 0


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (("--plot", "a.svg"), "--plot draws what --front finds"),
        (("--front", "--out", "plan.json"), "--out writes one plan, but --front finds several"),
        (("--with", FUSION), "this file is a part of the environment already"),
    ],
)
def test_what_does_not_go_together_is_refused(run: Run, options: tuple[object, ...], says: str) -> None:
    result = run("solve", FUSION, *options)
    assert (result.code, says in result.err) == (30, True)


def test_the_points_of_a_front_have_names(run: Run, tmp_path: Path) -> None:
    out = tmp_path / "front.svg"
    result = run("solve", MODELS / "fleet" / "3-best-map.yaml", "--front", "error", "--plot", out)
    assert result.code == 0, result.err
    drawn = out.read_text()
    assert "<!-- 3  large_detector(r1), " in drawn
    assert "<!-- 4 -->" in drawn


@pytest.mark.parametrize("verb", ["check", "solve", "explain", "sensitivity", "graph", "compare", "run", "export"])
def test_check_and_every_command_that_plans_have_the_what_if_options(verb: str, run: Run) -> None:
    text = run(verb, "--help").out
    assert "what if" in text
    assert all(f"  --{name}" in text for name in ("without NAME", "with FILE", "set KEY=VALUE", "observed FILE"))


NIGHT = """
facts: {night: {declared: false}}
transformations: [{label: eye, requires: not night, outputs: {i: Image}}]
units: [{id: eye.1, transformation: eye, topics: {i: [/i]}}]
targets: [{label: i, topic: /i, tag: Image}]
"""


def test_check_applies_what_if_options_to_both_files(run: Run, write: Callable[[str], Path]) -> None:
    env = write(NIGHT)
    assert run("check", env).code == 0
    at_night = run("check", env, "--set", "facts.night=true")
    assert (at_night.code, "unit eye.1 may not run now: night is true" in at_night.out) == (1, True)
    assert run("check", env, "--set", "facts.night=true", "--against", env).code == 0
    assert "unit eye.1 runs, but no target needs it" in run("check", env, "--without", "i").out


def test_each_command_names_the_fact_that_keeps_a_target_from_being_met(run: Run, write: Callable[[str], Path]) -> None:
    env = write(NIGHT)
    dark = (env, "--set", "facts.night=true")
    unmet = "target i wants Image, but needs transformations that are left out for now: eye (night is true)"
    solved = run("solve", *dark)
    assert unmet in solved.out
    assert "night is true" not in solved.err.replace("facts.night=true", ""), "no reason is told twice"
    assert run("solve", *dark, "--json").document["reasons"] == {"i": unmet}
    explained = run("explain", *dark).out
    assert "target i wants Image, but no transformation that offers it can run" in explained
    assert "    left out for now: eye, night is true" in explained
    assert "no output matches" not in explained
    assert explained.count("night is true") == 1, "no reason is told twice"
    assert unmet in run("compare", *dark, "--planner", "cpsat", "--planner", "branch-and-bound", "--json").out
    assert "left out for now: eye, night is true" in run("sensitivity", *dark).err


def test_transformations_of_one_reason_are_told_once_in_what_is_shown(run: Run, write: Callable[[str], Path]) -> None:
    """Reasons that name several transformations were followed by a line for each of them."""
    labels = ["ear", "ear of a cat", "eye", "nose", "skin"]
    library = "".join(f"  - {{label: {label}, requires: not night, outputs: {{i: Image}}}}\n" for label in labels)
    other = "  - {label: lamp, requires: not night, outputs: {l: Light}}\n"
    targets = "targets: [{label: i, topic: /i, tag: Image}]\n"
    env = write(f"facts: {{night: {{declared: true}}}}\ntransformations:\n{library}{other}{targets}")
    explained, solved = run("explain", env), run("solve", env)
    assert explained.out.splitlines()[1:] == [
        "target i wants Image, but no transformation that offers it can run",
        "    left out for now: ear, ear of a cat, eye, nose, skin, night is true",
        "left out for now: lamp, night is true",
    ]
    assert "left out for now: ear, ear of a cat, eye and 2 more (night is true)" in solved.out
    unnamed = [line for line in solved.err.splitlines() if "night" in line]
    assert unnamed == [f"left out for now: {label}, night is true" for label in ("lamp", "nose", "skin")]


def test_commands_that_are_advised_have_the_options_that_change_the_problem(
    run: Run, write: Callable[[str], Path], tmp_path: Path
) -> None:
    env, more = write(NIGHT), tmp_path / "more of it.yaml"
    more.write_text("format: cfgplan/1\ntransformations: [{label: lamp, outputs: {light: Light}}]\n")
    supposed = ("--without=lamp", f"--with={more}", "--set=facts.night=true")
    limits = ("--survive=0", "--horizon=60", "--max-cost=1.5")
    words = shlex.join([str(env), *supposed, *limits])
    assert f"`cfgplan explain {words}` says more about the reasons" in run("solve", env, *limits, *supposed).err
    launch = run("export", "launch", env, *supposed).err
    assert f"`cfgplan explain {shlex.join([str(env), *supposed])}` says why" in launch
    nothing = write("transformations: [{label: a, outputs: {o: A}}]\ntargets: [{label: t, topic: /t, tag: A}]\n")
    found = run("check", nothing, "--set", "a.labor=2").out
    assert f"`cfgplan solve {nothing} --set=a.labor=2` plans what to start" in found


def test_a_fact_that_is_set_without_its_prefix_is_answered_with_it(run: Run, write: Callable[[str], Path]) -> None:
    assert "write facts.night=true" in run("solve", write(NIGHT), "--set", "night=true").err


def test_export_launch_plans_with_what_if_options(run: Run, write: Callable[[str], Path]) -> None:
    assert run("export", "launch", write(NIGHT), "--set", "facts.night=true").code == 10
    refused = run("export", "yaml", write(NIGHT), "--set", "facts.night=true")
    assert "--with, --set and --observed are only for `export launch`" in refused.err


MODES = """
transformations:
  - {label: a, outputs: {o: A}, run: {state: spiral}}
  - {label: b, outputs: {o: B}, run: {state: spiral}}
targets: [{label: a, topic: /a, tag: A}, {label: b, topic: /b, tag: B}]
"""


def test_modes_that_would_share_a_state_are_named(run: Run, write: Callable[[str], Path]) -> None:
    env = write(MODES)
    assert "a, b share state spiral, and the targets need two units with it at once" in run("check", env).err
    assert "units a.1, b.1 save state spiral at once" in run("solve", env).err
    assert "spiral" not in run("check", env, "--without", "b").err
