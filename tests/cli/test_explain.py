"""`cfgplan explain` as a user and as a script see it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from unicodedata import normalize

import pytest
from command import MODELS, Run

NAO = MODELS / "nao"
RING = MODELS / "counterexamples" / "ring-without-source.yaml"
BROKEN = """
transformations:
  - {label: camera, outputs: {image: Image and hasSource some Front}}
  - {label: detector, inputs: {image: Image and hasSource some Back}, outputs: {ball: Ball}}
targets: [{label: ball, topic: /ball, tag: Ball}]
"""


def test_it_tells_the_input_that_nothing_feeds_and_what_comes_nearest(run: Run, write: Callable[[str], Path]) -> None:
    result = run("explain", write(BROKEN))
    assert result.code == 10
    assert (
        "target ball wants Ball, but no transformation that offers it can run\n  detector: input image wants Image"
        in result.out
    )
    assert "nearest: camera/image gives Image and hasSource some Front: lacks ∃hasSource.Back" in result.out


SHARED = """
transformations:
  - {label: camera, outputs: {image: Image and Front}}
  - {label: one, inputs: {image: Image and Back}, outputs: {ball: Ball}}
  - {label: two, inputs: {image: Image and Back}, outputs: {goal: Goal}}
  - {label: score, inputs: {ball: Ball}, outputs: {score: Score}}
targets:
  - {label: a, topic: /a, tag: Ball}
  - {label: b, topic: /b, tag: Goal}
  - {label: c, topic: /c, tag: Score}
  - {label: d, topic: /d, tag: Ball}
  - {label: e, topic: /e, tag: Image}
"""


def test_a_fault_of_several_targets_is_told_once(run: Run, write: Callable[[str], Path]) -> None:
    """Each target once repeated the tree of the same fault, and each input the tags that come nearest."""
    path = write(SHARED)
    assert run("explain", path).out.splitlines()[1:] == [
        "targets a, d want Ball, but no transformation that offers it can run",
        "  one: input image wants Image and Back, but no output matches",
        "      nearest: camera/image gives Image and Front: lacks Back",
        "target b wants Goal, but no transformation that offers it can run",
        "  two: input image wants Image and Back, but no output matches, see above",
        "target c wants Score, but no transformation that offers it can run",
        "  score: input ball wants Ball, but no transformation that offers it can run",
        "    one: see above",
    ]
    shared = (
        "  targets a, d want Ball, target b wants Goal, target c wants Score, "
        "but input image of one, input image of two need Image and Back, and no output matches"
    )
    assert run("solve", path).out.splitlines()[1:] == [shared]
    assert run("solve", path, "--best-effort").out.splitlines()[-2:] == ["Given up: 4 of 5 targets.", shared]


def test_a_tree_that_was_cut_is_not_referred_to(run: Run, write: Callable[[str], Path]) -> None:
    """Text once could only refer to lines of its own tree, which are there."""
    long = [f"  - {{label: s{n}, inputs: {{i: X{n}}}, outputs: {{o: X{n + 1}}}}}" for n in range(40)]
    targets = ["  - {label: a, topic: /a, tag: X40}", "  - {label: b, topic: /b, tag: X2}"]
    path = write("\n".join(["transformations:", *long, "targets:", *targets]))
    told = run("explain", path).out
    assert " more lines, all in --json\n" in told
    assert told.count("  s1: input i wants X1, but no transformation that offers it can run\n") == 1
    assert told.count("    s0: input i wants X0, but no output matches\n") == 1


def test_support_that_is_only_circular_is_told_as_such(run: Run) -> None:
    result = run("explain", RING)
    assert "left: is fed only by itself, see above" in result.out
    document = run("explain", RING, "--json").document
    assert [each["transformation"] for each in document["unreachable"][0]["blocked"]] == ["left", "right"]


def test_a_requirement_that_is_too_dear_is_named_with_both_costs(run: Run) -> None:
    result = run("explain", NAO / "5-fusion-required.yaml", "--max-cost", "20")
    assert result.code == 11
    assert "target ball with required fuse_ball_pos: the cheapest plan for these alone costs" in result.out
    assert "39.9 s, and 20 s is allowed" in result.out


def test_without_a_subject_it_says_for_each_unit_what_it_serves_and_what_doing_without_costs(run: Run) -> None:
    result = run("explain", NAO / "3-puff-registered.yaml")
    assert "segmenter(piff).1          for ball  without it 1.95 s more" in result.out


def test_what_is_not_used_says_what_it_would_cost(run: Run) -> None:
    result = run("explain", NAO / "4-fusion-available.yaml", "--transformation", "fuse_ball_pos")
    assert "Not used: the best plan that uses it costs 21.3 s more." in result.out
    document = run("explain", NAO / "4-fusion-available.yaml", "--transformation", "fuse_ball_pos", "--json").document
    assert document["why"][0]["difference_us"] == 21_300_000


def test_units_and_streams_can_be_asked_for(run: Run) -> None:
    result = run("explain", NAO / "2-segmenter-lost.yaml", "--unit", "segmenter(piff).1")
    assert "serves target ball, feeds ball_detector(piff).1/hull" in result.out
    assert "Needed: there is no plan without it." in result.out
    result = run("explain", NAO / "2-segmenter-lost.yaml", "--stream", "segmenter(piff).1/hull")
    assert result.out.startswith("segmenter(piff)/hull runs as segmenter(piff).1, serves target ball")


@pytest.mark.parametrize(
    ("option", "name"),
    [
        ("--unit", "segmenter(piff).1"),
        ("--unit", "bottom_cam(piff).1"),
        ("--transformation", "segmenter(piff)"),
        ("--stream", "segmenter(piff).1/hull"),
        ("--stream", "segmenter(piff)/hull"),
    ],
)
def test_a_name_alone_says_what_it_is(run: Run, option: str, name: str) -> None:
    stage = NAO / "2-segmenter-lost.yaml"
    assert run("explain", stage, name).out == run("explain", stage, option, name).out


def test_a_name_that_nothing_has_is_told_the_nearest(run: Run) -> None:
    assert "did you mean `segmenter(piff)`?" in run("explain", NAO / "2-segmenter-lost.yaml", "segmentor(piff)").err


def test_an_unknown_subject_is_bad_input_with_the_nearest_name(run: Run) -> None:
    result = run("explain", NAO / "2-segmenter-lost.yaml", "--unit", "segmentor(piff).1")
    assert result.code == 30
    assert "did you mean `segmenter(piff).1`?" in result.err


def test_a_name_is_understood_however_its_accents_are_encoded(run: Run, write: Callable[[str], Path]) -> None:
    path = write(
        "transformations: [{label: Gärung, outputs: {o: T}}, {label: other, outputs: {o: T}}]\n"
        "targets: [{label: t, topic: /t, tag: T}]\n"
    )
    label = normalize("NFD", "Gärung")
    for more in (["--transformation", label], ["--without", label], ["--set", f"{label}.labor=2"]):
        found = run("explain", path, *more)
        assert found.code == 0, found.err
