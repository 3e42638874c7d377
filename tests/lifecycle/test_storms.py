"""After a storm of perturbations what runs is exactly as good as a fresh optimal plan."""

from __future__ import annotations

import random
from pathlib import Path

import pytest
from cfgplan_runtime import Manager, Runtime
from cfgplan_runtime.errors import RuntimeFaultError
from cfgplan_runtime.lifecycle.changes import ReviewNow
from cfgplan_runtime.lifecycle.reports import Decision
from living import Life
from real_run import PATIENCE_S
from storms import Storm, assert_as_good_as_it_can_be, library, targets

from cfgplan import api
from cfgplan.domain import Environment
from cfgplan.errors import InputError

SIMULATED = {0: "a.py:b", 1: "a.py:b", 2: "a.py:b"}


@pytest.mark.parametrize("is_free_to_start", [True, False])
def test_200_perturbations_in_thought(is_free_to_start: bool) -> None:
    known = library(random.Random(1), code=SIMULATED, is_free_to_start=is_free_to_start)
    life = Life(*known, targets=tuple(targets()), horizon_s=300)
    life.settle()
    storm = Storm(2, known, targets())
    for _ in range(200):
        for _ in range(storm.randoms.choice((1, 1, 1, 3))):
            life.manager.request(storm.change(life.manager))
        life.pass_time(storm.randoms.choice((0.001, 0.02, 1.0, 30.0)))
    life.pass_time(1)
    life.ask(ReviewNow())
    assert life.reviews[-1].decision in (Decision.APPLIED, Decision.KEPT)
    assert_as_good_as_it_can_be(life.manager, life.runtime.environment, is_free_to_start=is_free_to_start)


def test_30_perturbations_on_real_processes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    (tmp_path / "storm_units.py").write_text(UNITS)
    known = library(random.Random(3), code={width: f"storm_units.py:give{width}" for width in range(3)})
    world = api.world(Environment((), tuple(known), tuple(targets())), horizon_s=300)
    storm = Storm(4, known, targets())
    with Runtime(folder=tmp_path) as runtime, Manager(world, runtime) as manager:
        assert manager.settle(PATIENCE_S)
        for _ in range(30):
            outcome = manager.request(storm.change(manager))
            try:
                outcome.result(storm.randoms.choice((0.01, PATIENCE_S)))
            except (InputError, TimeoutError):
                pass
            except RuntimeFaultError as error:
                raise AssertionError("the manager has ended") from error
        assert manager.settle(PATIENCE_S)
        assert manager.request(ReviewNow()).result(PATIENCE_S) is not None
        assert manager.settle(PATIENCE_S)
        assert_as_good_as_it_can_be(manager, runtime.environment, is_free_to_start=False)


UNITS = """
import time

def give0(seed=0):
    while True:
        time.sleep(0.02)
        yield 1

def give1(x0, seed=0):
    return x0

def give2(x0, x1, seed=0):
    return x0 + x1
"""
