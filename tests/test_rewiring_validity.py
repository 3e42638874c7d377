"""The judge on failures after which units compete for streams: what one rule of the wiring alone refuses.

In each case as many units remain as are needed, and each of them can run by itself.
"""

from __future__ import annotations

from collections.abc import Iterable

import pytest

from cfgplan.domain import (
    ALL,
    ComputationUnit,
    Environment,
    Host,
    InputPort,
    OutputPort,
    Publication,
    Similarity,
    Stream,
    Subscription,
    Target,
    Transformation,
)
from cfgplan.planning import Failures
from cfgplan.validity import Rule, violations

IMAGE = {"Image": frozenset({"Image", "Wide"})}
SIMILARITY = Similarity({tag: frozenset({tag}) for tag in ("Wide", "Ball", "Alarm")} | IMAGE)
"""A wide image is an image."""
BALL = Target("ball", "Ball", "/ball")
WIDE = Target("wide", "Wide", "/wide")
UNWIRED = "if unit {} fails, the remaining units can't be wired to meet all targets"


def kind(label: str, *inputs: InputPort, gives: str = "", serves: int | None = None, **said: object) -> Transformation:
    outputs = (OutputPort("o", gives, serves=serves),) if gives else ()
    return Transformation(label, inputs, outputs, standby_us=1, **said)  # type: ignore[arg-type]


def unit(name: str, *feeders: str, topic: str = "", host: str | None = None) -> ComputationUnit:
    """A unit `label.n`, fed by these units at its input, or each at an input that the text names: `left:near.1`."""
    pairs = [feeder.rpartition(":") for feeder in feeders]
    fed = tuple(Subscription(port or "i", Stream(feeder, "o")) for port, _, feeder in pairs)
    published = (Publication("o", topic),) if topic else ()
    return ComputationUnit(name, name.partition(".")[0], fed, published, host)


def spare(name: str, host: str | None = None) -> ComputationUnit:
    return ComputationUnit(name, name.partition(".")[0], host=host, standby=True)


def unsurvived(
    library: Iterable[Transformation], units: Iterable[ComputationUnit], *targets: Target, hosts: tuple[Host, ...] = ()
) -> list[str]:
    """The failures that the judge says are not survived. All other rules hold, but some units may be needless."""
    environment = Environment(tuple(units), tuple(library), targets, hosts)
    found = violations(environment, SIMILARITY, Failures.UNITS)
    assert {violation.rule for violation in found} <= {Rule.SURVIVES, Rule.LEAN}
    return [str(violation) for violation in found if violation.rule is Rule.SURVIVES]


def of(failures: list[str], unit_id: str) -> list[str]:
    return [text for text in failures if f" {unit_id} fails" in text]


@pytest.mark.parametrize(("serves", "is_wired"), [(1, False), (2, True)])
def test_an_input_takes_streams_of_different_units_after_a_failure(serves: int, *, is_wired: bool) -> None:
    library = [
        kind("narrow", gives="Image", serves=2),
        kind("wide", gives="Wide", serves=serves),
        kind("finder", InputPort("i", "Image", count=2), gives="Ball"),
    ]
    units = [
        unit("narrow.1"), unit("narrow.2"), unit("wide.1", topic="/wide"),
        unit("finder.1", "narrow.1", "narrow.2", topic="/ball"),
    ]  # fmt: skip
    failures = of(unsurvived(library, units, BALL, WIDE), "narrow.1")
    assert failures == ([] if is_wired else [UNWIRED.format("narrow.1")])


@pytest.mark.parametrize(
    ("serves", "standby", "is_wired"), [(1, "near.2", False), (1, "far.2", True), (2, "near.2", True)]
)
def test_inputs_of_a_distinct_group_are_fed_by_different_transformations_after_a_failure(
    serves: int, standby: str, *, is_wired: bool
) -> None:
    eyes = [InputPort(name, "Image", distinct="eyes") for name in ("left", "right")]
    library = [
        kind("near", gives="Image", serves=1),
        kind("far", gives="Image", serves=1),
        kind("wide", gives="Wide", serves=serves),
        kind("stereo", *eyes, gives="Ball"),
    ]
    units = [
        unit("near.1"), unit("far.1"), unit("wide.1", topic="/wide"), spare(standby),
        unit("stereo.1", "left:near.1", "right:far.1", topic="/ball"),
    ]  # fmt: skip
    failures = of(unsurvived(library, units, BALL, WIDE), "far.1")
    assert failures == ([] if is_wired else [UNWIRED.format("far.1")])


@pytest.mark.parametrize(("serves", "is_wired"), [(2, False), (3, True)])
def test_an_input_that_takes_all_streams_takes_its_share_of_each_after_a_failure(
    serves: int, *, is_wired: bool
) -> None:
    library = [
        kind("wide", gives="Wide", serves=serves),
        kind("finder", InputPort("i", "Image"), gives="Ball"),
        kind("careful", InputPort("i", "Image", count=ALL), InputPort("j", "Image"), gives="Ball"),
    ]
    units = [unit("wide.1", topic="/wide"), unit("finder.1", "wide.1", topic="/ball"), spare("careful.2")]
    failures = of(unsurvived(library, units, BALL, WIDE), "finder.1")
    assert failures == ([] if is_wired else [UNWIRED.format("finder.1")])


def test_an_input_that_takes_all_streams_has_a_unit_started_that_gives_one() -> None:
    library = [
        kind("wide", gives="Wide", serves=1),
        kind("clock", gives="Alarm", serves=1),
        kind("finder", InputPort("i", "Wide"), gives="Ball"),
        kind("waker", InputPort("i", "Alarm", count=ALL), gives="Ball"),
    ]
    units = [unit("wide.1"), unit("finder.1", "wide.1", topic="/ball"), spare("waker.2")]
    assert of(unsurvived(library, units, BALL), "finder.1") == [
        "if unit finder.1 fails, nothing else can meet target ball"
    ]
    assert of(unsurvived(library, [*units, spare("clock.2")], BALL), "finder.1") == []


@pytest.mark.parametrize(("serves", "is_wired"), [(1, False), (2, True)])
def test_a_target_that_wants_a_unit_takes_a_stream_for_it_after_a_failure(serves: int, *, is_wired: bool) -> None:
    library = [kind("wide", gives="Wide", serves=serves), kind("screen", InputPort("i", "Image"))]
    units = [unit("wide.1", topic="/wide"), unit("wide.2"), unit("screen.1", "wide.2")]
    failures = of(unsurvived(library, units, WIDE, Target("shown", run="screen")), "wide.2")
    assert failures == ([] if is_wired else [UNWIRED.format("wide.2")])


@pytest.mark.parametrize(("serves", "is_wired"), [(1, False), (2, True)])
def test_a_spare_starts_with_company_on_its_own_host_which_is_fed_too(serves: int, *, is_wired: bool) -> None:
    """The company that runs is on another host, and takes a stream that the spare's own may need."""
    library = [
        kind("near", gives="Image", serves=serves),
        kind("driver", InputPort("i", "Image")),
        kind("finder", gives="Ball"),
        kind("other", gives="Ball", beside=("driver",)),
        kind("second", beside=("driver",)),
    ]
    units = [
        unit("near.1", host="a"), unit("driver.1", "near.1", host="a"), unit("second.1", host="a"),
        unit("finder.1", topic="/ball", host="a"), spare("other.2", host="b"), spare("driver.2", host="b"),
    ]  # fmt: skip
    targets = (BALL, Target("second", run="second"))
    failures = of(unsurvived(library, units, *targets, hosts=(Host("a"), Host("b"))), "finder.1")
    assert failures == ([] if is_wired else [UNWIRED.format("finder.1")])
