"""A few random environments of each kind; `experiments/planning/night.py` compares thousands."""

from __future__ import annotations

import pytest
from hypothesis import HealthCheck, given, reject, settings
from hypothesis import strategies as st
from kinds import KINDS, LeftOpenError


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=10, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_the_planner_is_as_good_as_the_oracle_on_each_kind(kind: str, data: st.DataObject) -> None:
    drawn = data.draw(KINDS[kind].drawn)
    try:
        assert KINDS[kind].differences(drawn) == []
    except LeftOpenError:
        reject()
