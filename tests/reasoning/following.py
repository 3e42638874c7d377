"""Progressing a formula through a trace of the tests."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from cfgplan_runtime.reasoning.monitor import Monitor
from cfgplan_runtime.reasoning.program import truth_of
from cfgplan_runtime.reasoning.truth import FALSE, TRUE, UNKNOWN, Truth, Verdict
from direct import State

TRUTH = {False: FALSE, None: UNKNOWN, True: TRUE}
VERDICT = {False: Verdict.FALSE, None: Verdict.UNKNOWN, True: Verdict.TRUE}


def truths(monitor: Monitor, state: Mapping[str, bool | None]) -> list[Truth]:
    """The truth of each proposition of a monitor in a state."""
    return [truth_of(each, lambda name: TRUTH[state[str(name)]]) for each in monitor.program.propositions]


def follow(monitor: Monitor, trace: Sequence[State]) -> Verdict:
    """The verdict after the states of a trace."""
    for time, state in trace:
        monitor.step(time, truths(monitor, state))
    return monitor.verdict
