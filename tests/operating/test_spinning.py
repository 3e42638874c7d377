"""A source that never waits is told of, with the word that is missing."""

from __future__ import annotations

import pytest
from cfgplan_runtime.operating.operation import SPINS_S, Spinning
from cfgplan_runtime.supervision.observation import Observation

from cfgplan.domain import InputPort, OutputPort, RunOptions, Transformation

FREE = Transformation("camera", outputs=(OutputPort("image", "Image"),))
RATED = Transformation("camera", outputs=FREE.outputs, run=RunOptions(rate_hz=30))
FED = Transformation("camera", (InputPort("x", "X"),), FREE.outputs)


def observed(upkeep_us: int | None, steps_per_s: float) -> Observation:
    return Observation("camera.1", "camera", 0, upkeep_us, steps_per_s=steps_per_s)


def told(transformation: Transformation, *observations: Observation) -> list[str]:
    spinning, library = Spinning(), {"camera": transformation}
    return [
        text for second, one in enumerate(observations) for text in spinning.warnings([one], library, float(second))
    ]


@pytest.mark.parametrize("one", [observed(980_000, 50), observed(200_000, 40_000), observed(None, 40_000)])
def test_a_source_without_a_rate_that_takes_a_core_or_never_waits_is_told_of_once(one: Observation) -> None:
    (warning,) = told(FREE, *[one] * 30)
    assert "camera.1 never waits" in warning
    assert "run: {rate: 10}" in warning


def test_a_short_burst_is_not_told_of() -> None:
    burst = [observed(980_000, 9000)] * int(SPINS_S)
    assert told(FREE, *burst, observed(10_000, 10), *burst) == []


@pytest.mark.parametrize("transformation", [RATED, FED], ids=["a source with a rate", "no source"])
def test_who_has_work_to_do_is_not_told_of(transformation: Transformation) -> None:
    assert told(transformation, *[observed(1_000_000, 9000)] * 30) == []
