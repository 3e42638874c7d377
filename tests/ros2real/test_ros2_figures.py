"""A short version of `experiments/ros2`: each way of starting, rewiring and mending leads to results."""

from __future__ import annotations

import importlib.util
import shutil
import sys
from pathlib import Path
from types import ModuleType

import pytest

EXPERIMENTS = Path(__file__).parents[2] / "experiments" / "ros2"


def experiment(name: str) -> ModuleType:
    """A script of the experiments, as a module."""
    spec = importlib.util.spec_from_file_location(f"ros2_{name}", EXPERIMENTS / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = sys.modules[spec.name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_each_way_to_mend_a_crash_leads_to_new_results() -> None:
    figures = experiment("figures")
    found = figures.figures("ROS 2")
    assert list(found) == [each for each in found if each in figures.FIGURES]
    assert set(found) == set(figures.FIGURES)
    assert all(seconds > 0 for seconds in found.values())


@pytest.mark.parametrize("size", [100, 1_000_000])
def test_messages_pass_the_relay_and_their_age_is_measured(size: int) -> None:
    figures = experiment("figures")
    (median, last), relay_us = figures.relayed(size, 50, 50)
    assert 0 < median <= last
    assert relay_us > 0


def test_the_relay_is_measured_while_it_observes() -> None:
    observing = experiment("observing")
    assert observing.relay_us(0, 100, ["pose.covariance.0"], 2) > 0


@pytest.mark.parametrize("way", ["stamped", "simulated", "best_effort"])
def test_an_input_that_is_led_to_and_fro_between_detectors_gets_each_number_once(
    way: str,
) -> None:
    heard = experiment("switches").heard(way, 10)
    assert len(heard.switch_s) == 10
    assert (heard.repeated, heard.back) == (0, 0)
    assert heard.lost == 0 or way == "best_effort"


def test_a_lifecycle_node_is_replaced_without_a_loss_and_deactivated() -> None:
    found = experiment("replacing").replaced("stamped, beside a slow one", 2)
    assert (found.lost, found.repeated, found.missed, found.deactivated) == (0, 0, 0, 2)
    assert max(found.both_s) < experiment("replacing").SLOW_S


@pytest.mark.skipif(shutil.which("cc") is None, reason="there is no C compiler for the shim")
def test_a_subscription_that_is_moved_without_a_relay_gets_no_number_twice() -> None:
    found, cpu_us = experiment("moving").moved("stamp", 4)
    assert len(found.switch_s) == 4
    assert (found.repeated, found.back) == (0, 0)
    assert cpu_us > 0
