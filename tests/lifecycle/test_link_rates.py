"""Links that carry less than declared: a run measures them, and plans by what they carry."""

from __future__ import annotations

from cfgplan_runtime.children.messages import CrossingCounts
from cfgplan_runtime.lifecycle.link_rates import FREE_S, MEASURED_S, LinkRates, MeasuredLink
from cfgplan_runtime.lifecycle.perturbations import LinkMeasured
from cfgplan_runtime.lifecycle.reports import Decision
from cfgplan_runtime.supervision.events import CrossingsStatus
from hypothesis import given
from hypothesis import strategies as st
from simulated_life import Life, started

from cfgplan import api
from cfgplan.domain import Environment, Host, Link, OutputPort, Target, Transformation

HOSTS = (Host("r1"), Host("base"))
RAW, SMALL = 2_000_000, 100_000
"""Bytes of a picture."""


def camera(label: str, size_bytes: int, upkeep_us: int) -> Transformation:
    output = OutputPort("p", "Picture", rate_uhz=2_000_000, size_bytes=size_bytes)
    return Transformation(label, (), (output,), 1000, upkeep_us, source=f"units.py:{label}", host="r1")


def life(*cameras: Transformation, links: tuple[Link, ...] = ()) -> Life:
    target = Target("pictures", "Picture", "/pictures", host="base")
    environment = Environment(library=cameras, targets=(target,), hosts=HOSTS, links=links)
    return started(world=api.world(environment, horizon_s=600))


class Crossing:
    """The counts of one stream from r1 to base."""

    def __init__(self, run: Life, stream: str) -> None:
        self._run, self._stream, self._counts = run, stream, CrossingCounts()
        self.tell()

    def tell(self) -> None:
        self._run.runtime.backend.tell(CrossingsStatus({(self._stream, "r1", "base"): self._counts}))

    def pass_time(self, seconds: float, *, arrives: int, crowded: int = 0) -> None:
        """Let time pass in which `arrives` bytes per second arrive, and `crowded` elements have no room."""
        number = int(arrives * seconds)
        self._counts += CrossingCounts(10, crowded, 0, crowded, 2 * number if crowded else number, number)
        self._run.pass_time(seconds)
        self.tell()
        self._run.pass_time(0.1)


DEAR, CHEAP = camera("small", SMALL, 100_000), camera("raw", RAW, 1000)


def test_a_link_that_carries_too_little_makes_the_plan_compress_and_is_tried_again() -> None:
    run = life(CHEAP, DEAR)
    assert run.units == {"raw.1"}
    crossing = Crossing(run, "raw.1/p")
    crossing.pass_time(MEASURED_S + 1, arrives=2_500_000, crowded=3)
    assert run.units == {"small.1"}
    (measured,) = run.perturbations(LinkMeasured)
    assert measured.between == ("'base'", "'r1'")
    assert 1_250_000 <= (measured.rate or 0) <= 2_500_000
    small = Crossing(run, "small.1/p")
    for _ in range(30):
        small.pass_time(MEASURED_S + 1, arrives=200_000)
    assert run.units == {"raw.1"}  # it has been free for long: the larger stream is tried
    assert [each.rate for each in run.perturbations(LinkMeasured)] == sorted(
        each.rate or 0 for each in run.perturbations(LinkMeasured)
    )


def test_where_nothing_smaller_is_to_be_had_what_runs_goes_on() -> None:
    run = life(CHEAP)
    crossing = Crossing(run, "raw.1/p")
    crossing.pass_time(MEASURED_S + 1, arrives=2_500_000, crowded=3)
    assert run.units == {"raw.1"}
    review = run.reviews[-1]
    assert (review.decision, review.unmet) == (Decision.KEPT, {})
    assert "a link between hosts carries less than its streams need" in review.warnings


def test_a_free_link_is_not_measured() -> None:
    run = life(CHEAP, DEAR)
    crossing = Crossing(run, "raw.1/p")
    for _ in range(5):
        crossing.pass_time(MEASURED_S + 1, arrives=4_000_000)
    assert (run.perturbations(LinkMeasured), run.units) == ([], {"raw.1"})


def test_a_declared_link_is_measured_as_the_medium_that_it_is() -> None:
    run = life(CHEAP, DEAR, links=(Link(("r1", "base"), bandwidth=10_000_000, price_us=5),))
    crossing = Crossing(run, "raw.1/p")
    crossing.pass_time(MEASURED_S + 1, arrives=2_500_000, crowded=3)
    (measured,) = run.perturbations(LinkMeasured)
    assert (measured.between, run.units) == (("r1", "base"), {"small.1"})
    (link,) = run.manager._state.plan_input.world.environment.links
    assert (link.price_us, link.declared, link.bandwidth) == (5, 10_000_000, measured.rate)


def test_a_plan_is_stale_once_a_link_has_another_step_and_not_before() -> None:
    run = life(CHEAP)
    crossing = Crossing(run, "raw.1/p")

    def basis() -> object:
        future = run.manager.preview()
        run.settle()
        return future.result(0).basis

    before = basis()
    crossing.pass_time(MEASURED_S + 1, arrives=2_500_000, crowded=3)
    measured = basis()
    assert measured != before
    crossing.pass_time(MEASURED_S + 1, arrives=2_600_000, crowded=3)
    assert basis() == measured


@given(
    st.lists(st.tuples(st.floats(0, 1e9), st.booleans(), st.floats(5, 100)), max_size=40),
    st.floats(1, 1e9),
)
def test_a_measured_rate_is_no_more_than_a_step_above_what_a_crowded_link_gave(
    measurements: list[tuple[float, bool, float]], first: float
) -> None:
    link, now_s = MeasuredLink(round(first), 0.0), 0.0
    for per_s, is_crowded, after_s in measurements:
        now_s += after_s
        link = link.after(per_s, now_s, is_crowded=is_crowded)
        assert link.patience_s >= FREE_S
        if is_crowded and per_s >= 1000:
            assert link.rate <= 1.5 * per_s + 1


def test_counts_that_begin_again_are_no_measurement() -> None:
    """A restarted agent counts from 0."""
    world = Environment(hosts=HOSTS)
    before = {("raw.1/p", "r1", "base"): CrossingCounts(100, 5, 0, 5, 10**9, 10**8)}
    after = {("raw.1/p", "r1", "base"): CrossingCounts(1, 0, 0, 0, 100, 100)}
    rates = LinkRates().after(before, world, 0.0).after(after, world, MEASURED_S)
    assert rates.rates(world) == {}
