"""A conformance kit: tests whether a middleware keeps the promises of `cfgplan_runtime.lifecycle.seams.Middleware`.

from cfgplan_runtime.testing import Bench, check_middleware

@contextmanager
def make():
    robot = Robot()
    nodelets = Nodelets(robot)
    yield Bench(nodelets, CAMERA, DETECTOR, BROKEN, robot.crash, robot.running, robot.published, robot.gives)

def test_conformance():
    check_middleware(make)
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from functools import partial

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
from cfgplan_runtime.supervision.events import Applied

__all__ = ["Bench", "Endings", "Hosts", "check_middleware"]

TOPIC = "/conformance"
SOME_WAITING = 5
"""The elements that wait at a slow unit when it is told to end."""
FIRST, LAST = "!broken", "~broken"
"""Prefixes of ids of units that can't be started, sorted before and after all others."""


@dataclass(frozen=True)
class Hosts:
    """Two hosts, a function that cuts one off with its units, and one that lets it come back without units."""

    near: str
    far: str
    lose: Callable[[str], object]
    join: Callable[[str], object]


@dataclass(frozen=True)
class Endings:
    """Transformations to test whether unit code is let end. Each has a `run: {stop}`, and at most the worker's input.

    The code of each of `ways` notes the way in which it was let end, by label: for example that its generator or its
    file was closed. `noted` returns how many units of a transformation have noted that so far. `slow` needs a moment
    for each element, but less than its `stop` for a full input; `late` needs longer than its `stop`; `stubborn` stays
    in its first step, whatever it is told. `done` returns how many elements the units of a transformation have
    processed.
    """

    ways: Sequence[Transformation]
    noted: Callable[[str], int]
    slow: Transformation
    late: Transformation
    stubborn: Transformation
    done: Callable[[str], int]


@dataclass
class Bench:
    """A middleware without units, with the functions that test it.

    `source` has one output and no input, `worker` one input and one output; a unit of `broken`, which has the worker's
    ports, can't be started. `crash` lets a unit end by itself. The other functions return the true state, whatever the
    middleware believes: `units` the running units, `topics` the topics that can be subscribed to, `gives` whether an
    element comes on a topic now, and `wires` the streams (`unit/port`) that feed each input (`unit/port`) and topic.
    `wait` lets seconds pass; after `patience_s` a promise counts as broken. Without `hosts` the loss of hosts is not
    tested, without `endings` the end of unit code; without `wires` connections are tested only by elements.
    """

    middleware: Middleware
    source: Transformation
    worker: Transformation
    broken: Transformation
    crash: Callable[[str], object]
    units: Callable[[], Collection[str]]
    topics: Callable[[], Collection[str]]
    gives: Callable[[str], bool]
    wait: Callable[[float], object] = time.sleep
    hosts: Hosts | None = None
    wires: Callable[[], Mapping[str, Collection[str]]] | None = None
    patience_s: float = 30.0
    endings: Endings | None = None
    told: list[events.Event] = field(default_factory=list)

    def unit(
        self, number: int, transformation: Transformation, *, topic: str | None = None, source: int = 1
    ) -> ComputationUnit:
        """A unit of a transformation, whose inputs are fed by source number `source`."""
        stream = Stream(f"{self.source.label}.{source}", self.source.outputs[0].name)
        feeds = tuple(Subscription(port.name, stream) for port in transformation.inputs)
        published = () if topic is None else (Publication(transformation.outputs[0].name, topic),)
        return ComputationUnit(f"{transformation.label}.{number}", transformation.label, feeds, published)

    def begin(self) -> Environment:
        """Start a source, and a worker that publishes on a topic."""
        self.middleware.listen(self.told.append)
        library = (self.source, self.worker, self.broken)
        target = Target("conformance", self.worker.outputs[0].tag, TOPIC)
        started = (self.unit(1, self.source), self.unit(1, self.worker, topic=TOPIC))
        return self.apply(ChangeSet(started, added_transformations=library, added_targets=(target,)))

    def apply(self, change_set: ChangeSet) -> Environment:
        """Apply a change set that can be carried out, and compare the true state with its result."""
        before = self.middleware.environment
        applied = self.middleware.apply(change_set, basis=before)
        assert isinstance(applied, Applied), f"apply() returned {applied!r:.60}, and not Applied"
        assert applied.unswitched >= 0, "Applied says that less than no input has not switched"
        after = before.update(change_set)
        self.expect(after, "after an update")
        return after

    def await_event(self, kind: type[events.UnitDied | events.HostLost | events.HostJoined], name: str) -> None:
        """Wait until an event of a unit or a host is reported."""

        def is_told() -> bool:
            return any(isinstance(event, kind) and name == _who(event) for event in self.told)

        assert self._becomes(is_told), f"{kind.__name__} of {name} is never told"
        self.wait(0.05)
        number = sum(isinstance(event, kind) and name == _who(event) for event in self.told)
        assert number == 1, f"{kind.__name__} of {name} is told {number} times"

    def _becomes(self, so: Callable[[], bool]) -> bool:
        """Wait until `so()` is true. Returns whether it is within `patience_s` seconds."""
        waited_s = 0.0
        while waited_s < self.patience_s:
            if so():
                return True
            self.wait(0.01)
            waited_s += 0.01
        return so()

    def expect(self, environment: Environment, what: str) -> None:
        """Require that the middleware's environment is this one, and that running units, connections and elements agree
        with it. A kept new unit may still be starting.
        """
        found = self.middleware.environment
        believed = {unit.id: unit for unit in found.units}
        assert believed == {unit.id: unit for unit in environment.units}, f"{what}: the environment is another one"
        for part in ("library", "targets", "hosts", "qualities"):
            assert getattr(found, part) == getattr(environment, part), f"{what}: the environment has another {part}"
        self._becomes(lambda: believed.keys() <= set(self.units()))
        assert set(self.units()) == set(believed), f"{what}: other units run than the environment has"
        published = {publication.topic for unit in environment.units for publication in unit.publications}
        assert published <= set(self.topics()), f"{what}: a topic that a unit publishes on is not there"
        if self.wires is not None:
            wires, wanted = self.wires, _wires(environment)
            self._becomes(lambda: _sets(wires()) == wanted)
            assert _sets(wires()) == wanted, f"{what}: other wires are there than the environment has"
        flowing = _flowing(environment)
        for topic in sorted({*published, TOPIC}):
            comes = topic in flowing
            is_so = self._becomes(partial(self._gives, topic, comes))
            assert is_so, f"{what}: {'nothing comes' if comes else 'elements come'} on {topic}"

    def _gives(self, topic: str, comes: bool) -> bool:
        return self.gives(topic) == comes


def _sets(wires: Mapping[str, Collection[str]]) -> dict[str, set[str]]:
    return {inlet: set(streams) for inlet, streams in wires.items() if streams}


def _wires(environment: Environment) -> dict[str, set[str]]:
    """The streams that should feed each input and topic."""
    wanted: dict[str, set[str]] = {}
    for unit in environment.units:
        for wire in unit.subscriptions:
            wanted.setdefault(f"{unit.id}/{wire.port}", set()).add(str(wire.stream))
        for publication in unit.publications:
            wanted.setdefault(publication.topic, set()).add(f"{unit.id}/{publication.port}")
    return wanted


def _flowing(environment: Environment) -> set[str]:
    """The topics on which elements should come: all their inputs are fed."""
    alive: set[str] = set()
    while True:
        more = {
            unit.id
            for unit in environment.units
            if {port.name for port in environment.transformation[unit.transformation].inputs}
            <= {wire.port for wire in unit.subscriptions if wire.stream.unit in alive}
        }
        if more == alive:
            giving = [unit for unit in environment.units if unit.id in alive]
            return {publication.topic for unit in giving for publication in unit.publications}
        alive = more


def _who(event: events.UnitDied | events.HostLost | events.HostJoined) -> str:
    return event.unit if isinstance(event, events.UnitDied) else event.host


def check_middleware(make: Callable[[], AbstractContextManager[Bench]]) -> None:
    """Check a middleware, each promise on a new one. Raises AssertionError with the promise that it breaks."""
    left_out: Collection[Callable[[Bench], None]] = ()
    for check in CHECKS:
        if check in left_out:
            continue
        with make() as bench:
            left_out = [*(() if bench.hosts else HOST_CHECKS), *(() if bench.endings else ENDING_CHECKS)]
            try:
                check(bench)
            except AssertionError:
                raise
            except Exception as error:
                text = f"the middleware raised {type(error).__name__}, which it does not promise: {error}"
                raise AssertionError(text) from error


def _applies(bench: Bench) -> None:
    environment = bench.begin()
    assert {unit.id for unit in environment.units} == {f"{bench.source.label}.1", f"{bench.worker.label}.1"}
    observations = bench.middleware.observe()
    seen = {observation.unit: observation.transformation for observation in observations}
    assert seen == {unit.id: unit.transformation for unit in environment.units}, "observe() tells of other units"
    for observation in observations:
        costs = (observation.labor_us, observation.upkeep_us or 0)
        assert min(costs) >= 0, f"observe() tells a negative cost of {observation.unit}"


def _rewires(bench: Bench) -> None:
    bench.begin()
    bench.apply(ChangeSet((bench.unit(2, bench.source),)))
    bench.apply(ChangeSet(rewired=(bench.unit(1, bench.worker, topic=TOPIC, source=2),)))
    bench.apply(ChangeSet(stopped=(f"{bench.source.label}.1",)))
    again = bench.unit(2, bench.worker, topic=TOPIC, source=2)
    bench.apply(ChangeSet((again,), stopped=(f"{bench.worker.label}.1",)))


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
    bench.apply(ChangeSet(rewired=(rewired,), removed_targets=("conformance",)))
    assert TOPIC not in set(bench.topics()), "a topic that nobody publishes on and nobody wants is still there"


def _tells_of_deaths(bench: Bench) -> None:
    for end in (bench.crash, bench.middleware.kill):
        if not bench.middleware.environment.units:
            bench.begin()
        source = f"{bench.source.label}.1"
        before = bench.middleware.environment
        bench.told.clear()
        end(source)
        bench.await_event(events.UnitDied, source)
        bench.expect(before.without_unit(source), "after a unit has died")
        again = (bench.unit(1, bench.source),)
        bench.apply(ChangeSet(again, rewired=(bench.unit(1, bench.worker, topic=TOPIC),)))


def _goes_on_where_nothing_is_waited_for(bench: Bench) -> None:
    bench.middleware.abandon()
    environment = bench.begin()
    bench.middleware.abandon()
    bench.expect(environment, "after abandon() without an update")


def _buries_what_a_lost_host_ran(bench: Bench) -> None:
    hosts = bench.hosts
    assert hosts is not None
    bench.middleware.listen(bench.told.append)
    source, worker = replace(bench.unit(1, bench.source), host=hosts.near), bench.unit(1, bench.worker, topic=TOPIC)
    again = replace(worker, host=hosts.far)
    declared = (Host(hosts.near), Host(hosts.far))
    library = (bench.source, bench.worker)
    before = bench.apply(ChangeSet((source, again), added_transformations=library, added_hosts=declared))
    hosts.lose(hosts.far)
    bench.await_event(events.HostLost, hosts.far)
    bench.expect(replace(before, units=(source,)), "after a host was lost")
    assert not any(isinstance(event, events.UnitDied) for event in bench.told), "a lost unit's end is told by itself"
    hosts.join(hosts.far)
    bench.await_event(events.HostJoined, hosts.far)
    bench.apply(ChangeSet((again,)))


def _stops(bench: Bench) -> None:
    bench.begin()
    bench.middleware.stop()
    assert not bench.middleware.environment.units, "after stop() the environment has units"
    assert not set(bench.units()), "after stop() units run"
    assert not bench.gives(TOPIC), "after stop() elements come"


def _lets_code_end(bench: Bench) -> None:
    """Unit code can clean up, whether its unit is replaced or the run ends."""
    endings = bench.endings
    assert endings is not None
    bench.begin()
    first = tuple(bench.unit(1, way) for way in endings.ways)
    bench.apply(ChangeSet(first, added_transformations=tuple(endings.ways)))
    assert not any(endings.noted(way.label) for way in endings.ways), "code notes its end while its unit runs"
    second = tuple(bench.unit(2, way) for way in endings.ways)
    bench.apply(ChangeSet(second, stopped=tuple(unit.id for unit in first)))
    _expect_noted(bench, endings, 1, "when its unit is replaced")
    bench.middleware.stop()
    _expect_noted(bench, endings, 2, "at stop()")
    cut = {event.unit for event in bench.told if isinstance(event, events.UnitCutShort)}
    assert not cut, f"{', '.join(sorted(cut))} was killed although its code ends in time"


def _expect_noted(bench: Bench, endings: Endings, number: int, when: str) -> None:
    for way in endings.ways:
        assert bench._becomes(lambda way=way: endings.noted(way.label) >= number), (  # type: ignore[misc]
            f"the code of {way.label} is not let end {when}"
        )


def _gives_first_what_was_taken_in(bench: Bench) -> None:
    endings = bench.endings
    assert endings is not None
    unit, taken = _fill(bench, endings.slow)
    bench.apply(ChangeSet(stopped=(unit,)))
    done = endings.done(endings.slow.label)
    assert done >= taken, f"a unit that had got {taken} elements was stopped after {done}"
    assert not _cuts(bench, unit), "a unit that ends within its `stop` is killed"


def _kills_what_does_not_end(bench: Bench) -> None:
    endings = bench.endings
    assert endings is not None
    for transformation, waits in ((endings.late, True), (endings.stubborn, False)):
        if not bench.middleware.environment.units:
            bench.begin()
        if waits:
            unit, taken = _fill(bench, transformation)
        else:
            unit, taken = _feed(bench, transformation), 0
            done = partial(endings.done, transformation.label)
            assert bench._becomes(lambda done=done: done() > 0), f"{unit} gets nothing"  # type: ignore[misc]
        bench.apply(ChangeSet(stopped=(unit,)))
        cuts = _cuts(bench, unit)
        assert len(cuts) == 1, f"UnitCutShort of {unit}, which does not end in time, is told {len(cuts)} times"
        stop_s = (transformation.run.stop_us or 0) / 1e6
        assert cuts[0].after_s >= stop_s, f"{unit} is killed after {cuts[0].after_s} s, before its `stop` is over"
        lost, most = cuts[0].waiting, taken - endings.done(transformation.label)
        assert not waits or lost >= most, f"{lost} elements are told as lost with {unit}, and {most} are"
        died = [event for event in bench.told if isinstance(event, events.UnitDied) and event.unit == unit]
        assert not died, f"{unit} was told to end, and its end is told as a death"


def _feed(bench: Bench, transformation: Transformation) -> str:
    """Start a unit of a transformation, fed by the source. Returns its id."""
    if not bench.middleware.environment.units:
        bench.begin()
    unit = bench.unit(1, transformation)
    bench.apply(ChangeSet((unit,), added_transformations=(transformation,)))
    return unit.id


def _fill(bench: Bench, transformation: Transformation) -> tuple[str, int]:
    """Start a unit of a transformation, and wait until elements wait at it. Returns its id, and how many it has got."""
    unit = _feed(bench, transformation)
    got = [0]

    def is_filled() -> bool:
        for observation in bench.middleware.observe():
            if observation.unit == unit:
                waiting = sum(counts.waiting for counts in observation.inputs.values())
                got[0] = observation.steps + waiting
                return waiting >= SOME_WAITING
        return False

    assert bench._becomes(is_filled), f"observe() tells of no elements that wait at {unit}, which is slow"
    return unit, got[0]


def _cuts(bench: Bench, unit: str) -> list[events.UnitCutShort]:
    return [event for event in bench.told if isinstance(event, events.UnitCutShort) and event.unit == unit]


HOST_CHECKS: tuple[Callable[[Bench], None], ...] = (_buries_what_a_lost_host_ran,)
ENDING_CHECKS: tuple[Callable[[Bench], None], ...] = (
    _lets_code_end,
    _gives_first_what_was_taken_in,
    _kills_what_does_not_end,
)
CHECKS: tuple[Callable[[Bench], None], ...] = (
    _applies,
    _rewires,
    _undoes,
    _keeps_only_what_has_not_failed,
    _refuses_what_is_stale,
    _unpublishes,
    _tells_of_deaths,
    _goes_on_where_nothing_is_waited_for,
    *HOST_CHECKS,
    _stops,
    *ENDING_CHECKS,
)
