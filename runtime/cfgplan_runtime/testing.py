"""A conformance kit: whether a middleware keeps what `cfgplan_runtime.lifecycle.seams.Middleware` promises.

from cfgplan_runtime.testing import Bench, check_middleware

@contextmanager
def make():
    robot = Robot()
    yield Bench(Nodelets(robot), CAMERA, DETECTOR, BROKEN, robot.crash, robot.running, robot.published)

def test_conformance():
    check_middleware(make)
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace

import cfgplan_runtime.supervision.events as events
from cfgplan.domain import (
    ChangeSet,
    ComputationUnit,
    Environment,
    Host,
    Publication,
    Stream,
    Subscription,
    Target,
    Transformation,
)
from cfgplan_runtime.errors import ApplyError, StaleChangeSetError
from cfgplan_runtime.lifecycle.seams import Middleware

__all__ = ["Bench", "Hosts", "check_middleware"]

PATIENCE_S = 30.0
TOPIC = "/conformance"
FIRST, LAST = "!broken", "~broken"
"""Ids of units that can't be started, before and after all others."""


@dataclass(frozen=True)
class Hosts:
    """Two hosts, how to cut one off with all that runs there, and how to let it come back with nothing on it."""

    near: str
    far: str
    lose: Callable[[str], object]
    join: Callable[[str], object]


@dataclass
class Bench:
    """A middleware on which nothing runs yet, with what is needed to check it.

    `source` has one output and no input, `worker` one input and one output; a unit of `broken`, which has the worker's
    ports, can't be started. `crash` lets a unit end by itself; `units` and `topics` tell what really runs and what can
    really be subscribed to, whatever the middleware believes. `wait` lets so many seconds pass. Without `hosts` it is
    not checked that a lost one is.
    """

    middleware: Middleware
    source: Transformation
    worker: Transformation
    broken: Transformation
    crash: Callable[[str], object]
    units: Callable[[], Collection[str]]
    topics: Callable[[], Collection[str]]
    wait: Callable[[float], object] = time.sleep
    hosts: Hosts | None = None
    told: list[events.Event] = field(default_factory=list)

    def unit(self, number: int, transformation: Transformation, *, topic: str | None = None) -> ComputationUnit:
        """A unit that the first source feeds, if it has an input."""
        stream = Stream(f"{self.source.label}.1", self.source.outputs[0].name)
        feeds = tuple(Subscription(port.name, stream) for port in transformation.inputs)
        published = () if topic is None else (Publication(transformation.outputs[0].name, topic),)
        return ComputationUnit(f"{transformation.label}.{number}", transformation.label, feeds, published)

    def begin(self) -> Environment:
        """Start a source and a worker that is published."""
        self.middleware.listen(self.told.append)
        library = (self.source, self.worker, self.broken)
        target = Target("conformance", self.worker.outputs[0].tag, TOPIC)
        started = (self.unit(1, self.source), self.unit(1, self.worker, topic=TOPIC))
        self.middleware.apply(ChangeSet(started, added_transformations=library, added_targets=(target,)))
        return self.middleware.environment

    def await_event(self, kind: type[events.UnitDied | events.HostLost | events.HostJoined], name: str) -> None:
        """Wait until an event of a unit or a host is told."""

        def is_told() -> bool:
            return any(isinstance(event, kind) and name == _who(event) for event in self.told)

        assert self._becomes(is_told), f"{kind.__name__} of {name} is never told"

    def _becomes(self, so: Callable[[], bool]) -> bool:
        """Wait until something is so. Returns whether it is, within PATIENCE_S."""
        waited_s = 0.0
        while not so() and waited_s < PATIENCE_S:
            self.wait(0.01)
            waited_s += 0.01
        return so()

    def expect(self, environment: Environment, what: str) -> None:
        """What runs is what is said to run; a new unit that is kept may still be on its way."""
        believed = {unit.id: unit for unit in self.middleware.environment.units}
        assert believed == {unit.id: unit for unit in environment.units}, f"{what}: the environment is another one"
        self._becomes(lambda: believed.keys() <= set(self.units()))
        assert set(self.units()) == set(believed), f"{what}: other units run than the environment has"
        published = {publication.topic for unit in environment.units for publication in unit.publications}
        assert published <= set(self.topics()), f"{what}: a topic that a unit publishes on is not there"


def _who(event: events.UnitDied | events.HostLost | events.HostJoined) -> str:
    return event.unit if isinstance(event, events.UnitDied) else event.host


def check_middleware(make: Callable[[], AbstractContextManager[Bench]]) -> None:
    """Check a middleware, each promise on a new one. Raises AssertionError with the promise that it does not keep."""
    for check in CHECKS:
        with make() as bench:
            check(bench)


def _applies(bench: Bench) -> None:
    environment = bench.begin()
    assert {unit.id for unit in environment.units} == {f"{bench.source.label}.1", f"{bench.worker.label}.1"}
    bench.expect(environment, "after an update")
    seen = {observation.unit for observation in bench.middleware.observe()}
    assert seen == set(environment.unit), "observe() does not tell of every running unit"


def _undoes(bench: Bench) -> None:
    before = bench.begin()
    worker = bench.unit(2, bench.worker, topic=TOPIC)
    for name in (FIRST, LAST):  # change sets are in the order of ids: nothing, or half of it, was done before it fails
        broken = replace(bench.unit(1, bench.broken, topic="/broken"), id=name)
        try:
            bench.middleware.apply(ChangeSet((worker, broken), stopped=(f"{bench.worker.label}.1",)), basis=before)
        except ApplyError as error:
            assert broken.id in error.units, "ApplyError does not name the unit that could not be started"
        else:
            raise AssertionError("an update of which a unit can't be started raises no ApplyError")
        bench.expect(before, "after an update that failed")
        assert "/broken" not in set(bench.topics()), "a topic of an update that failed is there"


def _keeps_only_what_has_not_failed(bench: Bench) -> None:
    before = bench.begin()
    worker, broken = bench.unit(2, bench.worker, topic=TOPIC), bench.unit(1, bench.broken)
    try:
        change_set = ChangeSet((worker, broken), stopped=(f"{bench.worker.label}.1",))
        bench.middleware.apply(change_set, basis=before, keeps_new=True)
    except ApplyError:
        left = replace(worker, subscriptions=(), publications=())
        kept = (left,) if worker.id in bench.middleware.environment.unit else ()
        bench.expect(replace(before, units=(*before.units, *kept)), "after an update that failed and keeps new units")
    else:
        raise AssertionError("an update of which a unit can't be started raises no ApplyError")


def _refuses_what_is_stale(bench: Bench) -> None:
    before = bench.begin()
    for change_set, basis in (
        (ChangeSet((bench.unit(2, bench.worker),)), Environment()),
        (ChangeSet((bench.unit(1, bench.worker),)), None),
        (ChangeSet(stopped=("nobody.1",)), None),
    ):
        try:
            bench.middleware.apply(change_set, basis=basis)
        except StaleChangeSetError:
            bench.expect(before, "after an update that was refused")
        else:
            raise AssertionError("a change set that does not fit what runs raises no StaleChangeSetError")


def _unpublishes(bench: Bench) -> None:
    bench.begin()
    rewired = bench.unit(1, bench.worker)
    bench.middleware.apply(ChangeSet(rewired=(rewired,), removed_targets=("conformance",)))
    assert TOPIC not in set(bench.topics()), "a topic that nobody publishes on and nobody wants is still there"
    bench.expect(bench.middleware.environment, "after a topic has gone")


def _tells_of_deaths(bench: Bench) -> None:
    for end in (bench.crash, bench.middleware.kill):
        if not bench.middleware.environment.units:
            bench.begin()
        source, worker = f"{bench.source.label}.1", f"{bench.worker.label}.1"
        bench.told.clear()
        end(source)
        bench.await_event(events.UnitDied, source)
        (left,) = bench.middleware.environment.units
        assert (left.id, left.subscriptions) == (worker, ()), "a dead unit leaves no gap where it fed another"
        assert set(bench.units()) == {worker}, "a dead unit still runs"
        again = (bench.unit(1, bench.source),)
        bench.middleware.apply(ChangeSet(again, rewired=(bench.unit(1, bench.worker, topic=TOPIC),)))
        bench.expect(bench.middleware.environment, "after a repair")


def _goes_on_where_nothing_is_waited_for(bench: Bench) -> None:
    bench.middleware.abandon()
    environment = bench.begin()
    bench.middleware.abandon()
    bench.expect(environment, "after abandon() without an update")


def _buries_what_a_lost_host_ran(bench: Bench) -> None:
    hosts = bench.hosts
    if hosts is None:
        return
    bench.middleware.listen(bench.told.append)
    source, worker = replace(bench.unit(1, bench.source), host=hosts.near), bench.unit(1, bench.worker, topic=TOPIC)
    again = replace(worker, host=hosts.far)
    declared = (Host(hosts.near), Host(hosts.far))
    library = (bench.source, bench.worker)
    bench.middleware.apply(ChangeSet((source, again), added_transformations=library, added_hosts=declared))
    before = bench.middleware.environment
    bench.expect(before, "after an update on two hosts")
    hosts.lose(hosts.far)
    bench.await_event(events.HostLost, hosts.far)
    bench.expect(replace(before, units=(source,)), "after a host was lost")
    assert not any(isinstance(event, events.UnitDied) for event in bench.told), "a lost unit's end is told by itself"
    hosts.join(hosts.far)
    bench.await_event(events.HostJoined, hosts.far)
    bench.middleware.apply(ChangeSet((again,)))
    bench.expect(before, "after a host has come back")


def _stops(bench: Bench) -> None:
    bench.begin()
    bench.middleware.stop()
    assert not bench.middleware.environment.units, "after stop() the environment has units"
    assert not set(bench.units()), "after stop() units run"


CHECKS: tuple[Callable[[Bench], None], ...] = (
    _applies,
    _undoes,
    _keeps_only_what_has_not_failed,
    _refuses_what_is_stale,
    _unpublishes,
    _tells_of_deaths,
    _goes_on_where_nothing_is_waited_for,
    _buries_what_a_lost_host_ran,
    _stops,
)
