"""Which skips fail in CI: see `ALLOWED_SKIPS` in tests/conftest.py."""

from __future__ import annotations

import re
from pathlib import Path
from types import ModuleType

import pytest

TESTS = Path(__file__).parent


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
