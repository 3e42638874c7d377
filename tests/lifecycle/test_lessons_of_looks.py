"""A look teaches all that its streams have said, and the review at its end plans with that."""

from __future__ import annotations

from cfgplan_runtime.lifecycle.perturbations import LookOver, QualitiesObserved
from simulated_life import started
from test_qualities_of_a_run import ERROR, choice, looks_of, pass_until_a_look, saying, sensor

from cfgplan import api
from cfgplan.domain import Environment, OutputPort, Target, Transformation
from cfgplan.qualities import MICRO, Contribution, QualityRule, Wish


def test_the_estimate_after_a_look_is_of_all_elements_of_the_look() -> None:
    """The standard error of ten elements would be 25 mm, and of all thirty 13 mm."""
    run = choice({"sonar": 0.2, "lidar": 0.3}, sonar=saying(lambda _: 0.2), lidar=saying(lambda _: 0.3, noise=0.2))
    pass_until_a_look(run)
    run.pass_time(4)
    assert len(run.perturbations(LookOver)) == 1
    (lidar,) = (one for one in run.manager.snapshot().qualities if one.transformation == "lidar")
    assert lidar.error < 18_000


def test_a_look_counts_though_other_streams_have_made_reviews_in_vain() -> None:
    """The odometer gets worse by 2 % a second, and has no alternative: reviews of qualities wait for 16 s."""
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
        "lidar": saying(lambda _: 0.1),
        "odometer": saying(lambda at_s: 0.1 * 1.02**at_s),
    }
    run = started(world=api.world(environment, horizon_s=3600), behaviours=behaviours)
    pass_until_a_look(run)
    in_vain = [one for one in run.reviews if isinstance(one.perturbations[0], QualitiesObserved)]
    assert len(in_vain) > 3
    run.pass_time(5)
    assert len(looks_of(run)) == 1
    assert run.units == {"lidar.1", "odometer.1"}
