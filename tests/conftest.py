"""For all tests: how many run at a time, signals as at a shell, reruns, and which examples property tests draw.

A push draws a sixth of each property's examples, and a sixth of the values of each test's parameter `seed`, with a seed
made of the commit: the next commit draws others, and the same commit draws the same ones again. `CFGPLAN_SHARE=1` draws
all of them, as `.ci/nightly` does, and `CFGPLAN_SEED=N` repeats those of a seed. Soaks are run where all are drawn.

Modules are compiled once: where PYTHONDONTWRITEBYTECODE is set, each process of each test would compile the product.

`CFGPLAN_RERUNS=1`, which `.ci/run` sets, runs a test once more if it fails and waits for processes: the computer of the
CI stops whole processes for seconds. pytest lists each such test, and each is a race to mend.

A test that neither ends within the `timeout` of pyproject.toml nor hears of it has its process ended and fails.

`CFGPLAN_SKIPS=listed`, which `.ci/run` sets, fails a test that is skipped for a reason outside `ALLOWED_SKIPS`: the
packages that other reasons name are installed there.
"""

from __future__ import annotations

import compileall
import gc
import os
import re
import signal
import subprocess
import sys
from collections import defaultdict
from collections.abc import Generator, Iterator
from pathlib import Path
from random import Random
from typing import Any

import pytest
from hypothesis import HealthCheck, settings
from warm import module_command, warm_socket
from warm_python import warm_subprocess
from xdist.remote import Producer
from xdist.scheduler import LoadGroupScheduling
from xdist.workermanage import WorkerController

FEWEST_EXAMPLES = 10
"""A property with fewer examples draws all of them."""
SEEDED = "seed"
"""The parameter of tests of which a push takes a share of the values."""
PRODUCT = [Path(__file__).parents[1] / folder for folder in ("cfgplan", "runtime")]
SHARE = 1 if "CFGPLAN_EXAMPLES" in os.environ else int(os.environ.get("CFGPLAN_SHARE", "6"))
RERUNS = int(os.environ.get("CFGPLAN_RERUNS", "0"))
ALLOWED_SKIPS = (
    "reelay is not installed",
    "it has no bound for long",
    "does not support .*use the planner cpsat",
    "Web Service Challenge|the WSC 2008 sets|the sets are not beside the checkout",
    "no control groups",
    "no network namespaces",
    "there is no (GStreamer|systemd-analyze)",
    "root may (read|write) every",
    "only root can become another user",
    "the cases of wrong answers are no part of the project",
    "this version of OR-Tools answers right by itself",
    "only who sees wires can tell",
    "launch of ROS 2 is not installed",
)
"""Reasons for which a test may be skipped in CI, as regular expressions: the machine, the data or a peer lacks it."""
SKIPS_ARE_LISTED = os.environ.get("CFGPLAN_SKIPS") == "listed"
_ROOMS_WITH_PROCESSES = {"cli", "fleet", "lifecycle", "mqtt", "nao", "operating", "ros1", "ros2", "ros2real", "runtime"}
_OF_FUNCTIONS = "_hypothesis_internal_use_settings"


def _seed_of_the_commit() -> int:
    """The first digits of the commit that is checked out; 0 outside a git checkout."""
    asked = ["git", "-C", str(Path(__file__).parent), "rev-parse", "HEAD"]
    try:
        return int(subprocess.run(asked, capture_output=True, text=True, check=True).stdout[:8], 16)
    except (OSError, subprocess.CalledProcessError):
        return 0


@pytest.hookimpl(tryfirst=True)
def pytest_configure(config: pytest.Config) -> None:
    """Set the seed, and give back the signals that nohup and a shell's background jobs make children ignore."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:
        signal.signal(signal.SIGHUP, signal.SIG_DFL)
    if config.option.hypothesis_seed is None:
        config.option.hypothesis_seed = os.environ.get("CFGPLAN_SEED") or str(_seed_of_the_commit())
    if _keeps_bytecode(config) and not hasattr(config, "workerinput"):
        for folder in PRODUCT:
            compileall.compile_dir(folder, quiet=2)


def _keeps_bytecode(config: pytest.Config) -> bool:
    """Whether compiled modules may be kept; not in a run that is to leave nothing behind, as those of mutants are."""
    return not config.pluginmanager.is_blocked("cacheprovider")


@pytest.hookimpl(wrapper=True)
def pytest_collection(session: pytest.Session) -> Generator[None]:
    """Let pytest keep the test modules that it compiles; the processes of tests still write none beside their files."""
    was = sys.dont_write_bytecode
    sys.dont_write_bytecode = was and not _keeps_bytecode(session.config)
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()
        gc.freeze()
        sys.dont_write_bytecode = was


def pytest_report_header(config: pytest.Config) -> str:
    seed = config.option.hypothesis_seed
    return f"properties draw 1/{SHARE} of their examples: CFGPLAN_SHARE={SHARE} CFGPLAN_SEED={seed} repeats them"


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Draw seeds; lower the number of examples of each property and stateful test, once; mark what may be run again.

    Tests that one worker runs together, as those of ROS 2, come first: the others do the rest beside them.
    """
    left_out = {item.nodeid for item in seeds_left_out(items, int(config.option.hypothesis_seed))}
    left_out |= {item.nodeid for item in soaks_left_out(items)}
    if left_out:
        config.hook.pytest_deselected(items=[item for item in items if item.nodeid in left_out])
        items[:] = [item for item in items if item.nodeid not in left_out]
    items.sort(key=lambda item: item.get_closest_marker("xdist_group") is None)
    lowered: set[int] = set()
    for item in items:
        if RERUNS and item.path.parent.name in _ROOMS_WITH_PROCESSES:
            item.add_marker(pytest.mark.flaky(reruns=RERUNS))
        method = getattr(item, "obj", None)
        test = getattr(method, "__func__", method)
        machine: Any = getattr(item, "cls", None)
        if not getattr(test, "is_hypothesis_test", False):
            continue
        if isinstance(getattr(machine, "settings", None), settings):
            home, name = machine, "settings"
        else:
            home, name = test, _OF_FUNCTIONS
        if id(home) not in lowered:
            lowered.add(id(home))
            setattr(home, name, _share_of(getattr(home, name)))


def seeds_left_out(items: list[pytest.Item], seed: int, share: int = SHARE) -> list[pytest.Item]:
    """The tests that a push leaves out: it takes one in `share` of the seeds of each test function, at least one."""
    by_test: defaultdict[str, list[tuple[Any, pytest.Item]]] = defaultdict(list)
    for item in items:
        parameters = getattr(getattr(item, "callspec", None), "params", {})
        if SEEDED in parameters:
            by_test[item.nodeid.partition("[")[0]].append((parameters[SEEDED], item))
    found = []
    for test, seeded in sorted(by_test.items()):
        seeds = sorted({value for value, _ in seeded})
        taken = Random(f"{seed} {test}").sample(seeds, -(-len(seeds) // share))
        found += [item for value, item in seeded if value not in taken]
    return found


def soaks_left_out(items: list[pytest.Item], share: int = SHARE) -> list[pytest.Item]:
    """The tests that only the night runs: soaks, which meet again what other tests show one by one."""
    return [item for item in items if share > 1 and item.get_closest_marker("soak")]


def _share_of(whole: settings) -> settings:
    number = max(min(FEWEST_EXAMPLES, whole.max_examples), whole.max_examples // SHARE)
    # A busy computer draws and runs slowly, which says nothing about a strategy or a property.
    ignored = {*whole.suppress_health_check, HealthCheck.too_slow}
    kept = {"derandomize": False, "database": None, "deadline": None}
    return settings(whole, max_examples=number, suppress_health_check=ignored, **kept)


@pytest.fixture(scope="session")
def warm_cfgplan() -> str:
    """The server of warm commands, which runs from here on: see tests/warm.py."""
    return warm_socket()


@pytest.fixture(scope="module")
def warm_runs() -> Iterator[None]:
    """Runs of planners are forks of a process that has imported all of them. Each plans once."""
    from cfgplan.comparing import runs

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(runs, "CHILD", tuple(module_command("planned_once")))
        yield


@pytest.fixture(scope="module")
def warm_nurseries() -> Iterator[None]:
    """Nurseries of this process are forks of a process that has imported what they need."""
    from cfgplan_runtime.processes import nursery_link

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(nursery_link, "subprocess", warm_subprocess("cfgplan_runtime.processes.nursery", "numpy.random"))
        yield


@pytest.fixture(scope="module")
def warm_agents() -> Iterator[None]:
    """Agents of `LocalAgents`, and their nurseries, are forks of processes that have imported what they need."""
    from cfgplan_runtime.fleet import local

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(local, "subprocess", warm_subprocess("cfgplan_runtime.fleet.agent", "zenoh", "numpy.random"))
        yield


def pytest_xdist_auto_num_workers() -> int:
    """One more than there are cores, since many tests wait for processes that they have started."""
    return (os.cpu_count() or 1) + 1


class Scheduling(LoadGroupScheduling):
    """Like `--dist loadgroup`, and goes on after the death of a worker.

    pytest-xdist 3.8 runs the test that killed a worker again in the next one, and gives that one a single group: since
    a worker runs a test once it knows the next one or that there is none, the run then waits for ever.
    """

    def remove_node(self, node: WorkerController) -> str | None:
        """Return the test in which a worker died, None if it had none left; its other tests wait for a worker again."""
        units = self.assigned_work.pop(node)
        left = [(scope, test) for scope, unit in units.items() for test, is_done in unit.items() if not is_done]
        for scope, test in left[1:]:
            self.workqueue.setdefault(scope, {})[test] = False
        for other in self.nodes:
            self._reschedule(other)
        return left[0][1] if left else None

    def mark_test_pending(self, item: str) -> None:
        """Have the test in which a worker died run once more: see pytest-rerunfailures."""
        self.workqueue.setdefault(self._split_scope(item), {})[item] = False
        for node in self.nodes:
            self._reschedule(node)

    def _reschedule(self, node: WorkerController) -> None:
        if node not in self.registered_collections:
            return
        super()._reschedule(node)
        while self.workqueue and not node.shutting_down and self._pending_of(self.assigned_work[node]) < 2:
            self._assign_work_unit(node)
        if not self.workqueue:
            node.shutdown()


def pytest_xdist_make_scheduler(config: pytest.Config, log: Producer) -> Scheduling | None:
    return Scheduling(config, log) if config.getvalue("dist") == "loadgroup" else None


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport() -> Generator[None, pytest.TestReport, pytest.TestReport]:
    report = yield
    if SKIPS_ARE_LISTED:
        fail_unlisted_skip(report)
    return report


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report() -> Generator[None, pytest.CollectReport, pytest.CollectReport]:
    report = yield
    if SKIPS_ARE_LISTED:
        fail_unlisted_skip(report)
    return report


def fail_unlisted_skip(report: pytest.TestReport | pytest.CollectReport) -> None:
    """Turn a skip for a reason outside `ALLOWED_SKIPS` into a failure that names the reason."""
    if report.outcome != "skipped" or hasattr(report, "wasxfail"):
        return
    reason = report.longrepr[2] if isinstance(report.longrepr, tuple) else str(report.longrepr)
    if not any(re.search(allowed, reason) for allowed in ALLOWED_SKIPS):
        report.outcome = "failed"
        report.longrepr = f"ALLOWED_SKIPS of tests/conftest.py does not list the reason of this skip: {reason}"
