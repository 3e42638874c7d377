"""What a life-cycle remembers of what can't be met."""

from __future__ import annotations

from dataclasses import replace

from cfgplan_runtime.lifecycle.deliberation import UnmetTargets

from cfgplan.domain import ComputationUnit, Environment, OutputPort, Similarity, Target, Transformation
from cfgplan.planning import Problem
from cfgplan.reasons import unmet_reasons

CAMERA = Transformation("camera", outputs=(OutputPort("image", "Image"),))
SOUND = Target("sound", "Sound", "/sound")
PROBLEM = Problem(Environment((), (CAMERA,), (SOUND,)), Similarity({"Sound": frozenset()}), 60)


def test_what_can_not_be_met_stays_so_whatever_runs() -> None:
    reach = UnmetTargets(PROBLEM, unmet_reasons(PROBLEM))
    running = replace(PROBLEM.environment, units=(ComputationUnit("camera.1", "camera"),))
    assert reach.holds_for(replace(PROBLEM, environment=running))


def test_another_library_matching_or_target_is_looked_at_anew() -> None:
    reach = UnmetTargets(PROBLEM, unmet_reasons(PROBLEM))
    environment = PROBLEM.environment
    for other in (
        replace(environment, library=(CAMERA, Transformation("microphone", outputs=(OutputPort("sound", "Sound"),)))),
        replace(environment, library=(replace(CAMERA, outputs=(OutputPort("image", "Sound"),)),)),
        replace(environment, targets=(SOUND, Target("image", "Image", "/image"))),
    ):
        assert not reach.holds_for(replace(PROBLEM, environment=other))
    assert not reach.holds_for(replace(PROBLEM, similarity=Similarity({"Sound": frozenset({"Image"})})))
