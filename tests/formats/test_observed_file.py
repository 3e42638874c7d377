"""Files of what a run has observed: what is read is what plans go by, and wrong contents have a place and a mend."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from cfgplan.domain import Environment, Host, OutputPort, Statement, Transformation
from cfgplan.errors import InputError
from cfgplan.facts import Fact
from cfgplan.formats.observed_file import read_observed
from cfgplan.qualities import MICRO, Better, Contribution, QualityAttribute, QualityRule

STATED = (
    Contribution("error", QualityRule.SET, MICRO // 5, observe="error"),
    Contribution("gain", QualityRule.SCALE, 2 * MICRO, observe="gain"),
)
ENVIRONMENT = Environment(
    library=(Transformation("sonar", (), (OutputPort("p", "P", STATED),), 1, 1),),
    qualities=(QualityAttribute("error", Better.LOWER), QualityAttribute("gain", Better.HIGHER)),
    facts=(Fact("light", MICRO), Fact("mode", "survey")),
)


def read(tmp_path: Path, qualities: str, *, environment: Environment = ENVIRONMENT) -> Environment:
    path = tmp_path / "now.json"
    path.write_text(f'{{"format_version": 1, "qualities": [{qualities}]}}')
    return read_observed(path, environment)


def part(planned: str, attribute: str = "error", host: str | None = None) -> str:
    there = "" if host is None else f', "host": "{host}"'
    return f'{{"output": "sonar/p", "attribute": "{attribute}", "planned": {planned}{there}}}'


def test_a_quality_with_a_host_is_used_there_only(tmp_path: Path) -> None:
    fleet = replace(ENVIRONMENT, hosts=(Host("r1"), Host("r2")))
    environment = read(tmp_path, part("0.5", host="r1"), environment=fleet)
    there = {host: environment.stated(Statement("sonar", "p", "error", host)) for host in (None, "r1", "r2")}
    assert {host: stated and stated.value for host, stated in there.items()} == {
        None: 200_000,
        "r1": 500_000,
        "r2": 200_000,
    }
    everywhere = read(tmp_path, f"{part('0.5', host='r1')}, {part('0.3')}", environment=fleet)
    there = {host: everywhere.stated(Statement("sonar", "p", "error", host)) for host in ("r1", "r2")}
    assert {host: stated and stated.value for host, stated in there.items()} == {"r1": 500_000, "r2": 300_000}


def used(environment: Environment, attribute: str = "error") -> int:
    stated = environment.stated(Statement("sonar", "p", attribute))
    assert stated is not None
    return stated.value


@pytest.mark.parametrize(("planned", "value"), [("0.513", 513_000), ("0.12345678", 123_457), ("3", 3 * MICRO)])
def test_what_is_planned_is_used(tmp_path: Path, planned: str, value: int) -> None:
    once = read(tmp_path, part(planned))
    assert used(once) == value
    assert used(read(tmp_path, part(planned), environment=once)) == value  # it counts from what is declared


@pytest.mark.parametrize(
    ("qualities", "message"),
    [
        (part("1e999999999"), "is too large"),
        (part("true"), "True is not a number"),
        (part('"0.5"'), "'0.5' is not a number"),
        (part("null"), "None is not a number"),
        (part("[1]"), "[1] is not a number"),
        (part("-3"), "is out of range"),
        (part("20", "gain"), "is out of range"),
        (f"{part('0.3')}, {part('0.9')}", "is there twice"),
        (part("0.3", "weight"), "states no sonar/p weight"),
        (part("0.3", host="r3"), "has no host `r3`"),
    ],
)
def test_wrong_contents_have_a_place_and_a_mend(tmp_path: Path, qualities: str, message: str) -> None:
    with pytest.raises(InputError) as raised:
        read(tmp_path, qualities)
    (fault,) = raised.value.faults
    assert message in fault.message
    assert "now.json" in str(raised.value)
    assert fault.mend is not None
    assert "ctl observed --out" in fault.mend


@pytest.mark.parametrize("value", ["null", "[1.5]", "{}"])
def test_a_fact_that_is_a_word_can_not_be_null_or_a_list(tmp_path: Path, value: str) -> None:
    path = tmp_path / "now.json"
    path.write_text(f'{{"format_version": 1, "facts": {{"mode": {value}}}}}')
    with pytest.raises(InputError) as raised:
        read_observed(path, ENVIRONMENT)
    (fault,) = raised.value.faults
    assert (fault.message, fault.line) == (f"fact 'mode' is a word, not {value}", 1)
