"""Which tests a push runs, which skips fail in CI, and what a dead worker leaves: see tests/conftest.py."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest

TESTS = Path(__file__).parent
# pytest prints a failure once more where one of these is set.
ENVIRONMENT = {
    name: value for name, value in os.environ.items() if name not in ("CI", "BUILD_NUMBER", "PYTEST_ADDOPTS")
}


@pytest.fixture
def conftest(request: pytest.FixtureRequest) -> ModuleType:
    """The conftest.py of the whole suite."""
    plugin = request.config.pluginmanager.get_plugin(str(TESTS / "conftest.py"))
    assert isinstance(plugin, ModuleType)
    return plugin


def skipped(reason: str) -> pytest.TestReport:
    where = ("tests/test_x.py", 3, f"Skipped: {reason}")
    return pytest.TestReport(
        "tests/test_x.py::test_it", ("tests/test_x.py", 3, "test_it"), {}, "skipped", where, "call"
    )


def test_a_skip_that_no_line_lists_becomes_a_failure_with_its_reason(conftest: ModuleType) -> None:
    report = skipped("there is no Chromium at /usr/bin/chromium")
    conftest.fail_unlisted_skip(report)
    assert report.outcome == "failed"
    assert "there is no Chromium" in str(report.longrepr)


def test_a_listed_skip_stays_a_skip(conftest: ModuleType) -> None:
    report = skipped("no network namespaces: not permitted")
    conftest.fail_unlisted_skip(report)
    assert report.outcome == "skipped"


def test_an_expected_failure_is_no_skip(conftest: ModuleType) -> None:
    report = skipped("")
    report.wasxfail = "a known fault"  # type: ignore[attr-defined]
    conftest.fail_unlisted_skip(report)
    assert report.outcome == "skipped"


def test_each_listed_reason_is_one_that_a_test_or_a_peer_gives(conftest: ModuleType) -> None:
    sources = [
        path.read_text(encoding="utf-8")
        for folder in ("tests", "cfgplan", "experiments")
        for path in TESTS.parent.glob(f"{folder}/**/*.py")
        if path.name != "conftest.py"
    ]
    for allowed in conftest.ALLOWED_SKIPS:
        words = re.split(r"\.\*", allowed)
        assert any(all(re.search(word, source) for word in words) for source in sources), allowed


def test_only_the_night_runs_soaks(conftest: ModuleType) -> None:
    soak, usual = (SimpleNamespace(get_closest_marker={name: True}.get) for name in ("soak", "usefixtures"))
    assert conftest.soaks_left_out([soak, usual], share=6) == [soak]
    assert conftest.soaks_left_out([soak, usual], share=1) == []


class Seeded:
    """A test of one seed, as far as the choice of tests looks at it."""

    def __init__(self, test: str, seed: int) -> None:
        self.nodeid, self.callspec = f"{test}[{seed}]", SimpleNamespace(params={"seed": seed})


def test_a_push_takes_a_share_of_the_seeds_of_each_test_and_others_the_next_time(conftest: ModuleType) -> None:
    usual = SimpleNamespace(nodeid="usual", callspec=SimpleNamespace(params={"number": 1}))
    items = [usual, *(Seeded(f"test{n}", seed) for n in range(2) for seed in range(n, 13 + n))]

    def taken(seed: int, share: int = 6) -> set[str]:
        return {item.nodeid for item in items} - {item.nodeid for item in conftest.seeds_left_out(items, seed, share)}

    assert taken(1, share=1) == {item.nodeid for item in items}
    assert taken(1) == taken(1) != taken(2)
    assert [sum(name.startswith(f"test{n}") for name in taken(1)) for n in range(2)] == [3, 3]
    assert set.union(*map(taken, range(40))) == taken(1, share=1)
    assert all("usual" in taken(seed) for seed in range(40))
    assert taken(1, share=100) > {"usual"}


SUITE_WITH_DEATHS = """
import ctypes
import os
from pathlib import Path

import pytest


@pytest.mark.parametrize("number", range(12))
def test_some(number):
    if number == 5:
        os._exit(1)


@pytest.mark.xdist_group("together")
@pytest.mark.parametrize("number", range(3))
def test_group(number):
    if number == 1:
        ctypes.PyDLL(None).pause()  # holds the lock of the interpreter, as a solver's own code may do


@pytest.mark.flaky(reruns=1)
def test_second_try():
    if not Path("tried").exists():
        Path("tried").touch()
        os._exit(1)
"""


def test_the_other_tests_of_a_worker_that_dies_or_hears_nothing_run_once(tmp_path: Path) -> None:
    (tmp_path / "test_deaths.py").write_text(SUITE_WITH_DEATHS, encoding="utf-8")
    (tmp_path / "conftest.py").write_text("from suite import pytest_xdist_make_scheduler\n", encoding="utf-8")
    (tmp_path / "suite.py").symlink_to(TESTS / "conftest.py")
    for name in ("warm.py", "warm_cfgplan.py", "warm_python.py"):
        (tmp_path / name).symlink_to(TESTS / name)
    limits = ["-o", "faulthandler_timeout=5", "-o", "faulthandler_exit_on_timeout=true"]
    options = ["-n", "2", "--dist", "loadgroup", "-p", "no:cacheprovider", *limits]
    run = subprocess.run(
        [sys.executable, "-m", "pytest", *options],
        cwd=tmp_path,
        env=ENVIRONMENT,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert "2 failed, 14 passed, 1 rerun" in run.stdout
    killers = re.findall(r"crashed while running 'test_deaths.py::(.*)'", run.stdout)
    assert sorted(killers) == ["test_group[1]", "test_some[5]"]
