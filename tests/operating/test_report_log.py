"""A manager's structured log, and that its description describes it."""

from __future__ import annotations

import json
import resource
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import pytest
from cfgplan_runtime.lifecycle.kinds import sentence
from cfgplan_runtime.lifecycle.perturbations import HorizonReached, Perturbation
from cfgplan_runtime.lifecycle.reports import (
    BackedOff,
    Ended,
    FactSilent,
    Observed,
    Perturbed,
    Report,
    ReviewBegan,
    Reviewed,
    TargetView,
    UnitEvent,
    WorldRefused,
)
from cfgplan_runtime.operating.records import logging_to, report_record, snapshot_record
from cfgplan_runtime.supervision.events import SIGNS, Event, UnitDied
from cfgplan_runtime.supervision.run_log import RunLog
from fake_manager import REVIEW, SNAPSHOT, observation

from cfgplan.errors import Fault
from cfgplan.unmet import Lack, Reason

DESCRIPTION = Path(__file__).parents[2] / "cfgplan" / "manual" / "events.md"
REPORTS: tuple[Report, ...] = (
    Perturbed(HorizonReached(60)),
    ReviewBegan(1, (HorizonReached(60),)),
    Reviewed(REVIEW),
    UnitEvent(UnitDied("detector.1", "killed by SIGKILL")),
    Observed((observation("detector.1"),)),
    BackedOff(SNAPSHOT.backing_off[0]),
    WorldRefused("env.yaml", (Fault("no such class", file="env.yaml"),)),
    FactSilent("visibility", 5.0, "3"),
    Ended(),
)


@pytest.fixture
def lines(tmp_path: Path) -> list[dict[str, Any]]:
    log = RunLog(tmp_path / "log.jsonl")
    write = logging_to(log)
    for report in REPORTS:
        write(report)
    log.close()
    return [json.loads(line) for line in (tmp_path / "log.jsonl").read_text().splitlines()]


def test_records_of_reasons_are_plain_texts() -> None:
    """A recording and `ctl state` broke off: msgspec writes no subclass of str."""
    reason = Reason(Lack("no output matches"), "a", "T")
    review = replace(REVIEW, unmet={"a": reason})
    view = TargetView("a", "T", "/a", 0, None, reason)
    state = snapshot_record(replace(SNAPSHOT, reviews=(review,), targets=(view,)))
    for record in (state, report_record(Reviewed(review))):
        assert json.loads(msgspec.json.encode(record)) == json.loads(json.dumps(record))
    assert state["targets"][0]["reason"] == "target a wants T, but no output matches"
    assert state["reviews"][0]["unmet_says"] == ["target a wants T, but no output matches"]


def test_no_report_has_a_field_that_would_hide_its_kind_or_another_key_of_the_log() -> None:
    reports = {type(report) for report in REPORTS} - {UnitEvent}  # which is written as its event
    for kind in (*Event.__subclasses__(), *Perturbation.__subclasses__(), *reports):
        assert not {"kind", "event", "time"} & set(kind.__struct_fields__), kind


def test_every_report_but_observations_is_one_line(lines: list[dict[str, Any]]) -> None:
    assert [line["event"] for line in lines] == [
        "Perturbed",
        "ReviewBegan",
        "Reviewed",
        "UnitDied",
        "BackedOff",
        "WorldRefused",
        "FactSilent",
        "Ended",
    ]
    assert all(line["time"] > 1.6e9 for line in lines)


def test_a_reviews_line_says_what_perturbed_what_was_decided_and_what_it_cost(lines: list[dict[str, Any]]) -> None:
    review = next(line for line in lines if line["event"] == "Reviewed")
    assert review["decision"] == "applied"
    assert [one["kind"] for one in review["perturbations"]] == ["UnitGone", "ReviewRequested"]
    assert (review["cost_before_us"], review["cost_us"]) == (1_000_000, 2_000_000)
    assert review["seconds"] == {"detect": 0.001, "plan": 0.002, "apply": 0.01}
    assert review["change_set"]["started"][0]["id"] == "detector.1"
    assert review["unmet"] == {"goal": "nothing gives Goal"}


def test_every_event_and_every_field_is_described(lines: list[dict[str, Any]]) -> None:
    text = DESCRIPTION.read_text()
    names = {kind.__name__ for union in (Report, Event, Perturbation) for kind in union.__subclasses__()}
    signs = {*SIGNS}
    names -= {Observed.__name__, UnitEvent.__name__, *(kind.__name__ for kind in signs)}
    names |= {field for line in lines for field in line}
    told = {*Event.__subclasses__(), *Perturbation.__subclasses__()} - signs
    names |= {field for kind in told for field in kind.__struct_fields__}
    assert [name for name in sorted(names) if f"`{name}`" not in text] == []


def test_what_happens_to_a_unit_on_a_host_is_told_with_its_host() -> None:
    report = UnitEvent(UnitDied("detector.1", "killed by SIGKILL"), "r2")
    assert sentence(report) == "r2: detector.1 died: killed by SIGKILL"
    assert report_record(report) == {
        "kind": "UnitDied",
        "unit": "detector.1",
        "cause": "killed by SIGKILL",
        "how": "died",
        "host": "r2",
    }


def test_a_log_that_can_take_no_more_loses_lines_and_nothing_else(tmp_path: Path) -> None:
    log = RunLog(tmp_path / "log.jsonl")
    log.close()
    logging_to(log)(Ended())
    assert (log.written, log.lost) == (0, 1)
    assert log.failure


def test_the_next_whole_line_after_one_that_was_cut_stands_by_itself(tmp_path: Path) -> None:
    log = RunLog(tmp_path / "log.jsonl")
    write = logging_to(log)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20, hard))
    try:
        write(Ended("cut"))
        write(Ended("lost"))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    write(Ended("whole"))
    log.close()
    cut, whole = (tmp_path / "log.jsonl").read_text().splitlines()
    assert len(cut) == 20
    assert (json.loads(whole)["cause"], json.loads(whole)["lines_lost_before"]) == ("whole", 2)
    assert (log.written, log.lost, log.failure) == (1, 2, "No space left on device")
