"""Qualities of service in files: which pairs they keep apart, and what check says of them."""

from __future__ import annotations

from itertools import product
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cfgplan.cli import main
from cfgplan.ros.qos import ServiceQuality, obstacles

seconds = st.none() | st.sampled_from([0.1, 0.5, 2.0])
qualities = st.builds(ServiceQuality, st.booleans(), st.booleans(), seconds, seconds, st.booleans())


@given(qualities)
def test_what_is_written_is_what_is_read(quality: ServiceQuality) -> None:
    assert ServiceQuality.read(str(quality)) == quality


@given(qualities, qualities)
def test_whoever_offers_all_is_heard_by_all_and_whoever_asks_for_nothing_hears_all(
    one: ServiceQuality, other: ServiceQuality
) -> None:
    assert not [*obstacles(one, one)]
    assert not [*obstacles(ServiceQuality(True, True, 0.0, 0.0, True), other)]
    assert not [*obstacles(one, ServiceQuality(reliable=False))]


def test_reliability_and_durability_keep_apart_as_ros_documents() -> None:
    levels = [ServiceQuality(reliable, kept) for reliable, kept in product((False, True), repeat=2)]
    for offered, asked in product(levels, levels):
        fits = offered.reliable >= asked.reliable and offered.transient_local >= asked.transient_local
        assert (not [*obstacles(offered, asked)]) == fits


FILE = """\
format: cfgplan/1
transformations:
  - {label: lidar, source: "external:/lidar", outputs: {scan: {tag: Scan, qos: OFFERED}}}
  - {label: guard, source: "external:/guard", inputs: {scan: {tag: Scan, qos: ASKED}}}
units:
  - {id: lidar.1, transformation: lidar}
  - {id: guard.1, transformation: guard, inputs: {scan: lidar.1/scan}}
targets: [{label: guard, run: guard}]
"""


@pytest.mark.parametrize(
    ("offered", "asked", "said"),
    [
        ("best_effort", "reliable", "it asks for reliable messages, and best effort is offered"),
        ("reliable", "reliable transient_local", "messages from before it came"),
        ("reliable deadline=1", "reliable deadline=0.5", "a message every 0.5 s"),
        ("reliable", "reliable lease=2", "a sign of life every 2 s"),
        ("reliable lease=1", "reliable lease=2 manual", "the node itself says that it lives"),
        ("reliable transient_local", "best_effort", None),
    ],
)
def test_a_pair_that_does_not_hear_each_other_is_named_first_with_the_mend(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], offered: str, asked: str, said: str | None
) -> None:
    env = tmp_path / "env.yaml"
    env.write_text(FILE.replace("OFFERED", offered).replace("ASKED", asked))
    assert main(["check", str(env)]) == (0 if said is None else 1)
    first = capsys.readouterr().out.splitlines()[0]
    if said is None:
        assert "is valid" in first
    else:
        assert "env.yaml:7:" in first
        assert "qos: guard.1 gets no messages of lidar.1/scan at scan: " in first
        assert said in first
        assert "put its relay between them" in first


def test_words_that_are_no_quality_of_service_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    env = tmp_path / "env.yaml"
    env.write_text(FILE.replace("OFFERED", "besteffort").replace("ASKED", "reliable"))
    assert main(["check", str(env)]) == 30
    assert "env.yaml:3:" in capsys.readouterr().err
