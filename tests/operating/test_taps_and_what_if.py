"""Control methods of the page: taps of inner streams, and the plans of supposed changes, asked of real runs."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from cfgplan_runtime import subscribe
from cfgplan_runtime.errors import NoSuchTopicError
from cfgplan_runtime.lifecycle.reports import Observed
from cfgplan_runtime.operating.control_client import Control, connect
from cfgplan_runtime.operating.operation import Operation, Settings
from cfgplan_runtime.operating.protocol import RefusedError
from cfgplan_runtime.operating.taps import TAP_S, LeasedTaps
from operated_world import PATIENCE_S, ROBOT, eventually, write_world

from cfgplan import api
from cfgplan.domain import Stream

IMAGE = "camera(piff).1/image"


@pytest.fixture
def operation(tmp_path: Path) -> Iterator[Operation]:
    env = write_world(tmp_path)
    with Operation(api.load(env), env, Settings()) as running:
        assert running.begun.wait(PATIENCE_S)
        yield running


@pytest.fixture
def asked(operation: Operation) -> Iterator[Control]:
    with connect(operation.id) as control:
        yield control


def seen_of(topic: str) -> Any:
    with subscribe(topic, timeout_s=PATIENCE_S, wait_s=PATIENCE_S) as topic_subscription:
        return next(iter(topic_subscription)).value


def units(control: Control) -> list[tuple[str, object]]:
    return [(unit["id"], unit.get("pid")) for unit in control.call("state")["units"]]


def test_a_tap_shows_a_stream_that_is_on_no_topic_and_changes_nothing_else(asked: Control) -> None:
    before = asked.call("plan")["plan"]["basis"]
    topic = asked.call("tap", stream=IMAGE)["topic"]
    assert seen_of(topic).shape == (32, 32)
    assert asked.call("plan")["plan"]["basis"] == before
    assert asked.call("state")["targets"][0]["met"]


def test_a_stream_that_is_on_a_topic_is_not_tapped(asked: Control) -> None:
    assert asked.call("tap", stream="detector(piff).1/ball") == {"topic": "/result"}


def test_a_tap_is_connected_again_to_the_unit_that_replaces_a_dead_one(asked: Control, operation: Operation) -> None:
    seen_of(asked.call("tap", stream=IMAGE)["topic"])
    asked.call("kill", unit="camera(piff).1")
    eventually(lambda: any(name == "camera(piff).1" for name, _ in units(asked)))
    assert seen_of(asked.call("tap", stream=IMAGE)["topic"]).shape == (32, 32)
    assert operation.all_met


@pytest.mark.parametrize(("stream", "mend"), [("camera(piff).1/imag", f"did you mean `{IMAGE}`"), ("x/y", None)])
def test_only_outputs_of_running_units_are_tapped(asked: Control, stream: str, mend: str | None) -> None:
    with pytest.raises(RefusedError, match="no unit that runs gives") as refused:
        asked.call("tap", stream=stream)
    assert (refused.value.mend or "").startswith(mend or "")


class FakeTaps:
    def __init__(self) -> None:
        self.open: set[Stream] = set()

    def tap(self, stream: Stream) -> str:
        self.open.add(stream)
        return f"/tap/{stream}"

    def untap(self, stream: Stream) -> None:
        self.open.remove(stream)


def test_a_tap_that_nobody_renews_is_closed(tmp_path: Path) -> None:
    runtime, now_s = FakeTaps(), [0.0]
    leased = LeasedTaps(runtime, tmp_path, lambda: now_s[0])
    renewed, left = Stream("a", "x"), Stream("b", "x")
    leased.renew(renewed), leased.renew(left)
    now_s[0] = TAP_S / 2
    leased.renew(renewed)
    now_s[0] = TAP_S
    leased.hear(Observed(()))
    assert runtime.open == {renewed}


def test_a_closed_tap_leaves_no_topic(operation: Operation) -> None:
    topic = operation.runtime.tap(Stream.parse(IMAGE))
    seen_of(topic)
    operation.runtime.untap(Stream.parse(IMAGE))
    with pytest.raises(NoSuchTopicError):
        subscribe(topic, run=operation.id)
    operation.runtime.untap(Stream.parse(IMAGE))


def supposed(control: Control, method: str, **params: str) -> dict[str, Any]:
    return control.call("what_if", change=method, params=params)


def test_a_supposed_removal_is_priced_with_its_proof_and_not_carried_out(asked: Control) -> None:
    before = units(asked)
    answer = supposed(asked, "remove_transformation", label="detector(piff)")
    assert answer["newly_unmet"] == ["ball"]
    assert answer["is_proven"]
    assert sorted(answer["change_set"]["stopped"]) == ["camera(piff).1", "detector(piff).1"]
    assert answer["cost_us"] == 0 < answer["cost_now_us"]
    assert "would not be met: target ball wants Ball" in answer["says"]
    assert units(asked) == before


def test_a_supposed_addition_costs_what_the_addition_then_costs(asked: Control) -> None:
    answer = supposed(asked, "add", name="paff", text=ROBOT)
    assert {unit["transformation"] for unit in answer["change_set"]["started"]} == {"camera(paff)", "detector(paff)"}
    review = asked.call("add", name="paff", text=ROBOT)["review"]
    assert review["change_set"]["started"] == answer["change_set"]["started"]
    assert (review["is_proven"], answer["is_proven"]) == (True, True)


def test_a_supposed_change_that_would_be_refused_is_refused_with_its_place(asked: Control) -> None:
    with pytest.raises(RefusedError) as refused:
        supposed(asked, "add", name="wrong", text="targets:\n  - {label: more, topic: /more, tag: Bal}\n")
    assert [(fault.line, fault.mend) for fault in refused.value.faults] == [(2, "did you mean `Ball`?")]
    with pytest.raises(RefusedError, match="can't be supposed"):
        supposed(asked, "kill", unit="camera(piff).1")
    with pytest.raises(RefusedError, match="there is no change 'stop'"):
        supposed(asked, "stop")
