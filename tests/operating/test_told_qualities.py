"""Qualities that topics of ROS tell beside the streams."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

from cfgplan_runtime.operating.told_qualities import ToldQualities

from cfgplan.domain import Environment, OutputPort, Transformation
from cfgplan.qualities import Better, Contribution, QualityAttribute, QualityRule


def test_absurd_numbers_and_what_is_no_number_are_not_passed_on() -> None:
    stated = Contribution("error", QualityRule.SET, 200_000, observe="diagnostics.sonar.error")
    library = (Transformation("sonar", outputs=(OutputPort("p", "P", (stated,)),)),)
    environment = Environment(library=library, qualities=(QualityAttribute("error", Better.LOWER),))
    told, faults, takes = list[float](), list[str](), list[Callable[[object], None]]()
    manager: Any = SimpleNamespace(
        world=SimpleNamespace(environment=environment),
        listen=lambda _: None,
        tell_quality=lambda _, value: told.append(value),
    )
    reader: Any = SimpleNamespace(read=lambda *given: takes.append(given[-1]) or 1)
    ToldQualities(reader, manager, faults.append)
    for text in ("0.2", "0.3", "65535", "nan", "0.2", "0.3", "-inf", "0.4"):
        takes[0]({"status": [{"name": "sonar", "values": [{"key": "error", "value": text}]}]})
    assert told == [0.2, 0.3, 0.2, 0.3, 0.4]
    assert faults == ["/diagnostics does not report sonar/p error: error is not a number"]
