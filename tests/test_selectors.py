"""Selectors of hosts: expressions over labels, decided by plain evaluation."""

from __future__ import annotations

import re

import pytest

from cfgplan.domain import Environment, Host, Transformation
from cfgplan.errors import InvalidValueError


@pytest.mark.parametrize(
    ("text", "chosen"),
    [
        ("robot", "ab"),
        ("not robot", "c"),
        ("robot and gpu and not spot", "a"),
        ("robot ⊓ ¬gpu ⊔ c", "bc"),
        ("not (robot and gpu)", "bc"),
        ("a or 'base station'", "ac"),
        ("⊤", "abc"),
        ("⊥", ""),
        ("Thing", "a"),
        ("min or only", "b"),
        ("unknown", ""),
    ],
)
def test_a_selector_chooses_hosts_by_their_labels_and_names(text: str, chosen: str) -> None:
    hosts = (
        Host("a", labels=("robot", "gpu", "Thing")),
        Host("b", labels=("robot", "min")),
        Host("c", labels=("base station",)),
    )
    environment = Environment(hosts=hosts)
    assert environment.hosts_for(Transformation("t", on=text)) == tuple(chosen)
    assert Environment().hosts_for(Transformation("t", on=text)) == (None,)


def test_a_selector_and_a_choice_of_hosts_both_hold() -> None:
    environment = Environment(hosts=(Host("a", labels=("gpu",)), Host("b", labels=("gpu",)), Host("c")))
    assert environment.hosts_for(Transformation("t", hosts=("b", "c"), on="gpu")) == ("b",)


@pytest.mark.parametrize(
    "text", ["h0.1", "robot and h0.1", "not h0.1", "(h0.1 or gpu)", "h0.1 or h0.2", "robot (h0.1)"]
)
def test_a_name_with_a_dot_is_asked_for_in_quotes(text: str) -> None:
    mend = "join two labels" if text.startswith("robot (") else """write a name with such signs in quotes: "'h0.1'\""""
    with pytest.raises(InvalidValueError, match=re.escape(mend)):
        Transformation("t", on=text)
    environment = Environment(hosts=(Host("h0.1"), Host("h0.2")))
    assert environment.hosts_for(Transformation("t", on="'h0.1'")) == ("h0.1",)


@pytest.mark.parametrize("text", ["", "robot and", "robot some gpu", "(robot", "robot gpu", "not"])
def test_what_is_no_selector_is_refused(text: str) -> None:
    with pytest.raises(InvalidValueError, match="selects no hosts"):
        Transformation("t", on=text)
