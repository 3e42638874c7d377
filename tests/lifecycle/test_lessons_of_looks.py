"""A look teaches all that its streams have said, and the review at its end plans with that."""

from __future__ import annotations

import pytest
from cfgplan_runtime.children.messages import Qualities, Quality
from cfgplan_runtime.lifecycle.perturbations import LookOver, QualitiesObserved
from cfgplan_runtime.supervision.simulated_backend import Behaviour
from simulated_life import Life, started
from test_qualities_of_a_run import ERROR, choice, looks_of, pass_until_a_look, saying, sensor

from cfgplan import api
from cfgplan.domain import Environment, OutputPort, Target, Transformation
from cfgplan.qualities import MICRO, Better, Contribution, QualityAttribute, QualityRule, Wish


def test_the_estimate_after_a_look_is_of_all_elements_of_the_look() -> None:
    """The standard error of ten elements would be 25 mm, and of all thirty 13 mm."""
    run = choice({"sonar": 0.2, "lidar": 0.3}, sonar=saying(lambda _: 0.2), lidar=saying(lambda _: 0.3, noise=0.2))
    pass_until_a_look(run)
    run.pass_time(4)
    assert len(run.perturbations(LookOver)) == 1
    (lidar,) = (one for one in run.manager.snapshot().qualities if one.transformation == "lidar")
    assert lidar.error < 18_000


def test_a_look_that_finds_something_new_goes_on_until_all_its_attributes_were_observed() -> None:
    """The lidar is worse than declared, which shows at once; its short delay shows after five elements, in 10 s."""
    delay = QualityAttribute("delay", Better.LOWER, worst=10 * MICRO)

    def giving(label: str, declared_us: int) -> Transformation:
        stated = (Contribution(one, QualityRule.SET, declared_us, observe=one) for one in ("error", "delay"))
        return Transformation(
            label, (), (OutputPort("p", "Position", tuple(stated)),), 1000, 10_000, source=f"units.py:{label}"
        )

    def slow(at_s: float) -> Qualities:
        late = {"delay": Quality(1, 0.05, 0.0)} if round(at_s) % 2 else {}
        return {"p": {"error": Quality(10, 0.4, 0.0), **late}}

    wishes = Wish("error", None, 20 * MICRO), Wish("delay", None, 20 * MICRO)
    environment = Environment(
        library=(giving("sonar", 200_000), giving("lidar", 250_000)),
        targets=(Target("position", "Position", "/position", quality=wishes),),
        qualities=(ERROR, delay),
    )
    same = {"p": dict.fromkeys(("error", "delay"), Quality(10, 0.2, 0.0))}
    behaviours = {"sonar": Behaviour(says=lambda _: same), "lidar": Behaviour(says=slow)}
    run = started(world=api.world(environment, horizon_s=3600), behaviours=behaviours)
    pass_until_a_look(run)
    begun_s = run.now
    while not run.perturbations(LookOver):
        run.pass_time(0.5)
    seen = {one.attribute: one.planned for one in run.manager.snapshot().qualities if one.transformation == "lidar"}
    assert seen == {"error": 400_000, "delay": 50_000}
    assert run.now - begun_s == pytest.approx(10, abs=2)


def test_a_look_that_finds_something_new_in_all_its_attributes_ends_early() -> None:
    run = choice({"sonar": 0.2, "lidar": 0.3}, sonar=saying(lambda _: 0.2), lidar=saying(lambda _: 0.1))
    pass_until_a_look(run)
    run.pass_time(2.5)
    assert len(run.perturbations(LookOver)) == 1


def test_the_review_at_the_end_of_a_look_tells_which_qualities_it_takes_along() -> None:
    """The lidar is as declared; the odometer has changed since the last review of qualities."""
    run = drifting_odometer(lidar=0.3)
    pass_until_a_look(run)
    while not run.perturbations(LookOver):
        run.pass_time(0.5)
    observed, over = run.reviews[-1].perturbations
    assert isinstance(observed, QualitiesObserved)
    assert [one.split()[0] for one in observed.outputs] == ["odometer/p"]
    assert isinstance(over, LookOver)


def test_a_look_counts_though_other_streams_have_made_reviews_in_vain() -> None:
    """The odometer gets worse by 2 % a second, and has no alternative: reviews of qualities wait for 16 s."""
    run = drifting_odometer(lidar=0.1)
    pass_until_a_look(run)
    in_vain = [one for one in run.reviews if isinstance(one.perturbations[0], QualitiesObserved)]
    assert len(in_vain) > 3
    run.pass_time(5)
    assert len(looks_of(run)) == 1
    assert run.units == {"lidar.1", "odometer.1"}


def drifting_odometer(lidar: float) -> Life:
    """A sonar or a lidar, which is declared as 0.3 m, and an odometer that gets worse by 2 % a second."""
    stated = (Contribution("error", QualityRule.SET, MICRO // 10, observe="error"),)
    odometer = Transformation("odometer", (), (OutputPort("p", "Speed", stated),), 1000, 1000, source="units.py:o")
    weighed = (Wish("error", None, 20 * MICRO),)
    targets = (
        Target("position", "Position", "/position", quality=weighed),
        Target("speed", "Speed", "/speed", quality=weighed),
    )
    library = sensor("sonar", 0.2, 10_000), sensor("lidar", 0.3, 10_000), odometer
    environment = Environment(library=library, targets=targets, qualities=(ERROR,))
    behaviours = {
        "sonar": saying(lambda _: 0.2),
        "lidar": saying(lambda _: lidar),
        "odometer": saying(lambda at_s: 0.1 * 1.02**at_s),
    }
    return started(world=api.world(environment, horizon_s=3600), behaviours=behaviours)
