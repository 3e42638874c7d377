"""The table of what happens: each kind has a row, and nothing else in the product says anything about a kind."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterable, Iterator
from importlib.machinery import SourceFileLoader
from pathlib import Path
from types import CodeType
from typing import get_args

import cfgplan_runtime
import pytest
from cfgplan_runtime.lifecycle import kinds
from cfgplan_runtime.lifecycle.kinds import KINDS, Level, Urgency, growths, level, sentence
from cfgplan_runtime.lifecycle.perturbations import Perturbation, SubscriptionLost, UnitGone
from cfgplan_runtime.lifecycle.reports import (
    Decision,
    Ended,
    Perturbed,
    Report,
    Review,
    Reviewed,
    UnitEvent,
    WorldRefused,
)
from cfgplan_runtime.supervision.events import SIGNS, End, Event, UnitDied, UnitPrinted, UnitReady

import cfgplan

PRODUCT = [Path(package.__file__ or "").parent for package in (cfgplan, cfgplan_runtime)]
TABLE = Path(kinds.__file__)
CARRIERS = {Perturbed, UnitEvent}
"""Reports that carry an event or a perturbation, which has a row."""
GONE = UnitGone("camera.1", "camera", "died", "exited with 1")


def test_each_kind_of_event_perturbation_and_report_has_a_row() -> None:
    families = (Event, Perturbation, Report)
    assert {kind for family in families for kind in family.__subclasses__()} - CARRIERS == KINDS.keys()


def test_each_perturbation_can_be_the_cause_of_a_review() -> None:
    assert [kind for kind, row in KINDS.items() if issubclass(kind, Perturbation) and row.because is None] == []


def test_signs_of_life_are_the_events_that_nobody_is_told() -> None:
    signs = {kind for kind, row in KINDS.items() if row.urgency is Urgency.SIGN and issubclass(kind, Event)}
    assert signs == {*SIGNS}


FILES = [path for room in PRODUCT for path in room.rglob("*.py") if path != TABLE]


def names_in(tree: ast.AST) -> Iterator[str]:
    """The classes that a function matches on or asks for by `isinstance`."""
    for node in ast.walk(tree):
        asked: list[ast.AST] = []
        if isinstance(node, ast.MatchClass):
            asked = [node.cls]
        elif isinstance(node, ast.Call) and getattr(node.func, "id", None) == "isinstance":
            asked = [*ast.walk(node.args[1])]
        yield from (getattr(each, "attr", None) or getattr(each, "id", "") for each in asked)


def test_no_function_but_those_of_the_table_makes_a_text_of_a_kind() -> None:
    """A review is no event only, but a record that other places ask about."""
    kinds_ = {kind.__name__ for kind in KINDS} - {Reviewed.__name__}
    functions = [
        (path, node)
        for path in FILES
        if any(name in (text := path.read_text(encoding="utf-8")) for name in kinds_)
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.FunctionDef)
        and node.returns is not None
        and ast.unparse(node.returns) in ("str", "str | None")
        and any(isinstance(each, ast.JoinedStr) for each in ast.walk(node))
    ]
    assert len(functions) > 5
    found = [f"{path.name}: {node.name}" for path, node in functions if kinds_.intersection(names_in(node))]
    assert found == []


def texts_in(constants: Iterable[object]) -> Iterator[str]:
    for constant in constants:
        if isinstance(constant, str):
            yield constant
        elif isinstance(constant, CodeType):
            yield from texts_in(constant.co_consts)
        elif isinstance(constant, (tuple, frozenset)):
            yield from texts_in(constant)


def phrases(path: Path) -> set[str]:
    """The texts of a compiled module that have at least four words, except annotations with `|`."""
    code = SourceFileLoader("module", str(path)).get_code("module")
    assert code is not None
    found = (" ".join(text.split()) for text in texts_in(code.co_consts))
    return {text for text in found if len(text.split()) >= 4 and " | " not in text}


def test_no_sentence_of_the_table_is_said_elsewhere() -> None:
    own = phrases(TABLE)
    assert len(own) > 20
    assert {path.name: both for path in FILES if (both := own & phrases(path))} == {}


def test_the_page_knows_no_kind_by_name() -> None:
    names = re.compile("|".join(rf"\b{kind.__name__}\b" for kind in KINDS if kind is not Reviewed))
    scripts = [path for room in PRODUCT for path in room.rglob("*.js")]
    assert scripts
    assert [path.name for path in scripts if names.search(path.read_text(encoding="utf-8"))] == []


@pytest.mark.parametrize(
    ("report", "expected"),
    [
        (UnitEvent(UnitDied("camera.1", "no lens")), Level.ERROR),
        (UnitEvent(UnitPrinted("camera.1", "hello")), Level.INFORMATION),
        (Perturbed(GONE), Level.ERROR),
        (WorldRefused("env.yaml", ()), Level.INFORMATION),
        (Ended("the middleware is gone"), Level.ERROR),
        (Ended(), Level.INFORMATION),
    ],
    ids=lambda each: type(each).__name__,
)
def test_a_report_is_as_grave_as_it_says(report: Report, expected: Level) -> None:
    assert level(report) is expected


@pytest.mark.parametrize("how", get_args(End))
def test_a_unit_that_is_gone_has_ended_in_the_same_words_in_its_event_and_as_a_cause(how: End) -> None:
    assert sentence(UnitEvent(UnitDied("camera.1", "no lens", how))) == f"camera.1 {how}: no lens"
    because = KINDS[UnitGone].because
    assert because is not None
    assert because(UnitGone("camera.1", "camera", how, "no lens")) == f"camera.1 {how}"
    assert level(Perturbed(UnitGone("camera.1", "camera", how, "no lens"))) is Level.ERROR


def test_a_unit_that_is_gone_grows_two_metrics() -> None:
    assert [*growths(Perturbed(GONE))] == [
        ("perturbations", ("UnitGone",), 1),
        ("unit_failures", ("camera", "died"), 1),
    ]


def test_an_event_of_a_kind_that_a_middleware_has_made_up_is_news_without_a_sentence() -> None:
    class Blinked(UnitReady, frozen=True):
        """Not of Event itself, so that no other test takes it for a kind."""

    report = UnitEvent(Blinked("camera.1", 0))
    assert (sentence(report), level(report)) == (None, Level.INFORMATION)
    assert [*growths(report)] == [("events", ("Blinked",), 1)]


def test_a_lost_subscription_is_no_cause_of_its_own_beside_a_death() -> None:
    assert KINDS[SubscriptionLost].implied_by is UnitGone


def test_a_review_names_each_cause_once_with_all_transformations_that_are_left_out_for_it() -> None:
    avoided = {"camera": "units.py:1", "lidar": "r1 is gone", "map": "units.py:1"}
    review = Review(2, 0.0, 0.0, (), Decision.KEPT, 60, 0, avoided=avoided)
    assert "without camera, map (units.py:1), lidar (r1 is gone); " in kinds.review_sentence(review)
