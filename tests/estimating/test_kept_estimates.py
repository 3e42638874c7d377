"""What was learned, kept between runs."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import pytest
from cfgplan_runtime.estimating.estimates_file import EstimatesError, default_file, load, save
from cfgplan_runtime.estimating.estimator import make_estimator
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from observing import HORIZON_S, WORK, Watched

from cfgplan.domain import Host

RUNS = st.lists(st.lists(st.integers(0, 10**6), max_size=30), min_size=1, max_size=4)
shared_folder = settings(
    max_examples=30, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow]
)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "state" / "estimates.json"


@shared_folder
@given(runs=RUNS, failures=st.integers(0, 3), later_s=st.floats(0, 1e6))
def test_estimates_are_the_same_after_a_restart(
    runs: list[list[int]], failures: int, later_s: float, file: Path
) -> None:
    before, after = make_estimator(), make_estimator()
    before.estimated([WORK], HORIZON_S)
    watched = Watched(before)
    for upkeeps in runs:
        watched.run_once(upkeeps)
        for _ in range(failures):
            before.failed("work", watched.now_s)
    save(before, file, watched.now_s)
    after.observe([], later_s)
    load(after, file, later_s)
    same = make_estimator()
    same.observe([], watched.now_s)
    same.take_over(before.evidence)
    first, second = same.estimate(WORK, HORIZON_S), after.estimate(WORK, HORIZON_S)
    assert second.labor_us == pytest.approx(first.labor_us, rel=1e-3, abs=1)
    assert second.upkeep_us == pytest.approx(first.upkeep_us, rel=1e-3, abs=1)
    assert (second.labor_origin, second.upkeep_origin) == (first.labor_origin, first.upkeep_origin)


def test_without_a_file_learning_begins_with_nothing(file: Path) -> None:
    estimator = make_estimator()
    load(estimator, file, 0.0)
    assert estimator.estimated([WORK], HORIZON_S) == (WORK,)


def learned(file: Path) -> bytes:
    estimator = make_estimator()
    watched = Watched(estimator)
    watched.run(lambda now_s: 1000 * (now_s % 7), 60)
    estimator.failed("work", watched.now_s)
    save(estimator, file, watched.now_s)
    return file.read_bytes()


@shared_folder
@given(data=st.data())
def test_a_damaged_file_is_set_aside_or_of_no_harm(data: st.DataObject, file: Path) -> None:
    good = bytearray(learned(file))
    for _ in range(data.draw(st.integers(1, 4))):
        good[data.draw(st.integers(0, len(good) - 1))] = data.draw(st.integers(0, 255))
    file.write_bytes(bytes(good[: data.draw(st.integers(0, len(good)))]))
    estimator = make_estimator()
    try:
        load(estimator, file, 5.0)
    except EstimatesError:
        assert not file.exists()
        assert estimator.estimated([WORK], HORIZON_S) == (WORK,)
    Watched(estimator).run(lambda _: 5_000, 30)
    assert estimator.upkeep_us(WORK, HORIZON_S) >= 0


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"\x00\xff\xfe",
        b"[" * 100_000,
        b"{}",
        b'{"format": "cfgplan-estimates/9", "evidence": {}}',
        b'{"format": "cfgplan-estimates/1", "evidence": {"work": {}}}',
    ],
)
def test_what_is_no_estimates_file_is_renamed_and_told(content: bytes, file: Path) -> None:
    file.parent.mkdir()
    file.write_bytes(content)
    with pytest.raises(EstimatesError, match=r"damaged .*renamed to estimates\.json\.damaged"):
        load(make_estimator(), file, 0.0)
    assert file.with_name("estimates.json.damaged").read_bytes() == content
    learned(file)
    load(make_estimator(), file, 0.0)


def test_samples_out_of_order_are_damage(file: Path) -> None:
    estimator = make_estimator()
    watched = Watched(estimator)
    watched.run(lambda _: 1000, 60)
    estimator.evidence["work"].upkeep.samples.reverse()
    save(estimator, file, watched.now_s)
    with pytest.raises(EstimatesError, match="out of order"):
        load(make_estimator(), file, 0.0)


def test_a_write_that_fails_leaves_the_old_file(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = learned(file)

    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(EstimatesError, match="No space left"):
        save(make_estimator(), file, 0.0)
    assert [path.name for path in file.parent.iterdir()] == [file.name]
    assert file.read_bytes() == before


def test_a_folder_that_may_not_be_written_to_is_told(tmp_path: Path) -> None:
    (tmp_path / "state").write_text("a file, not a folder")
    with pytest.raises(EstimatesError, match="can't be kept"):
        save(make_estimator(), tmp_path / "state" / "estimates.json", 0.0)
    with pytest.raises(EstimatesError, match="can't be read"):
        load(make_estimator(), tmp_path / "state" / "estimates.json", 0.0)


def test_a_pipe_or_a_folder_is_neither_read_nor_renamed_nor_replaced(tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "folder", tmp_path / "pipe"):
        with pytest.raises(EstimatesError, match="this is not a file"):
            load(make_estimator(), path, 0.0)
        with pytest.raises(EstimatesError, match="this is not a file"):
            save(make_estimator(), path, 0.0)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["folder", "pipe"]
    assert (tmp_path / "pipe").is_fifo()


def test_a_transformation_that_was_changed_meanwhile_is_learned_anew(file: Path) -> None:
    estimator = make_estimator()
    estimator.estimated([WORK], HORIZON_S)
    watched = Watched(estimator)
    watched.run(lambda _: 1000, 60)
    save(estimator, file, watched.now_s)
    later = make_estimator()
    load(later, file, 0.0)
    changed = type(WORK)("work", labor_us=5, upkeep_us=6, source="units.py:Other")
    assert later.estimated([changed], HORIZON_S) == (changed,)


def test_each_environment_file_has_its_own_estimates(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    first, second = default_file(tmp_path / "a" / "env.yaml"), default_file(tmp_path / "b" / "env.yaml")
    assert first != second
    assert first.parent == second.parent == tmp_path / "cfgplan" / "estimates"
    assert first.name.startswith("env-")
    monkeypatch.chdir(tmp_path)
    assert default_file(Path("a/env.yaml")) == first


def test_no_parameter_of_a_transformation_is_written_down(file: Path) -> None:
    estimator = make_estimator()
    estimator.estimated([replace(WORK, params={"password": "hunter2"})], HORIZON_S)
    Watched(estimator).run(lambda _: 1000, 10)
    save(estimator, file, 10.0)
    assert b"hunter2" not in file.read_bytes()


def test_what_was_learned_on_hosts_is_kept_and_a_file_without_hosts_is_read(file: Path) -> None:
    host, before, after = Host("r1"), make_estimator(), make_estimator()
    before.labor_us(WORK, HORIZON_S, host)
    watched = Watched(before, host="r1")
    watched.run(lambda _: 80_000, 60, labor_us=400_000)
    save(before, file, watched.now_s)
    load(after, file, 0.0)
    assert (after.labor_us(WORK, HORIZON_S, host), after.upkeep_us(WORK, HORIZON_S, host)) == (400_000, 80_000)
    file.write_text('{"format": "cfgplan-estimates/1", "evidence": {}}')
    without = make_estimator()
    load(without, file, 0.0)
    assert without.labor_us(WORK, HORIZON_S, host) == WORK.labor_us
