"""Warnings of rclpy about quality of service become lines of the run."""

from __future__ import annotations

import pytest
from cfgplan_runtime.ros2.quality_warnings import QualityWarnings

HEARD = (
    "[WARN] [1795872868.96] [shouter_1]: New publisher discovered on topic '{}', offering incompatible QoS. "
    "No messages will be received from it. Last incompatible policy: {}"
)
SAID = (
    "[WARN] [1795872869.15] [talker_1]: New subscription discovered on topic '{}', requesting incompatible QoS. "
    "No messages will be sent to it. Last incompatible policy: RELIABILITY"
)
MENDED = "cfgplan: {}: the relay's first offer did not fit ({}), and was changed to one that fits"


@pytest.mark.parametrize(
    ("line", "shown"),
    [
        (HEARD.format("quiet", "DURABILITY"), MENDED.format("quiet", "durability")),
        (HEARD.format("/robot/quiet", "DEADLINE_QOS_POLICY"), MENDED.format("/robot/quiet", "deadline")),
        (SAID.format("~/loud"), MENDED.format("~/loud", "reliability")),
        (SAID.format("/talker_1/loud"), MENDED.format("/talker_1/loud", "reliability")),
        (
            HEARD.format("/tf", "RELIABILITY"),
            "cfgplan: /tf: a publisher there offers another reliability: its messages do not arrive",
        ),
        (
            SAID.format("/tf"),
            "cfgplan: /tf: a subscription there asks for another reliability: it gets no messages",
        ),
        ("[WARN] a warning of another kind", "[WARN] a warning of another kind"),
    ],
)
def test_a_warning_is_told_in_the_words_of_the_run(line: str, shown: str) -> None:
    assert QualityWarnings().line("shouter.1", line, ["quiet", "~/loud"]) == shown


def test_a_warning_is_told_once_for_each_node() -> None:
    warnings = QualityWarnings()
    line = HEARD.format("quiet", "DURABILITY")
    assert warnings.line("shouter.1", line, ["quiet"])
    assert warnings.line("shouter.1", line, ["quiet"]) is None
    assert warnings.line("shouter.2", line, ["quiet"])
    warnings.forget("shouter.1")
    assert warnings.line("shouter.1", line, ["quiet"])
