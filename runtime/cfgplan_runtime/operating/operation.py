"""A run in operation: a manager of real processes, and everything that observes and steers it."""

from __future__ import annotations

import contextlib
import queue
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass, field
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

from cfgplan import __version__
from cfgplan.api import World
from cfgplan.domain import Environment
from cfgplan.errors import InputError
from cfgplan.extras import needed
from cfgplan.transformations import Transformation
from cfgplan_runtime.children.messages import Flow
from cfgplan_runtime.children.source_faults import source_fault
from cfgplan_runtime.errors import RuntimeFaultError
from cfgplan_runtime.estimating.estimates_file import EstimatesError, load, save
from cfgplan_runtime.estimating.estimator import make_estimator
from cfgplan_runtime.lifecycle.basis import Preview
from cfgplan_runtime.lifecycle.changes import ReplaceWorld
from cfgplan_runtime.lifecycle.file_watch import WorldWatch
from cfgplan_runtime.lifecycle.manager import Manager
from cfgplan_runtime.lifecycle.policy import Policy
from cfgplan_runtime.lifecycle.reports import Decision, Ended, Observed, Phase, Report, Reviewed
from cfgplan_runtime.operating.control_server import ControlServer
from cfgplan_runtime.operating.crowded_links import CrowdedLinks
from cfgplan_runtime.operating.flows import Flows, Following
from cfgplan_runtime.operating.methods import Methods
from cfgplan_runtime.operating.moments import Moment, Moments
from cfgplan_runtime.operating.observed_facts import ObservedFacts
from cfgplan_runtime.operating.past import Past
from cfgplan_runtime.operating.printed import Printed
from cfgplan_runtime.operating.recorded_world import world_files
from cfgplan_runtime.operating.recording import Recorder
from cfgplan_runtime.operating.records import logging_to
from cfgplan_runtime.operating.sources import SourceCheck, Sources
from cfgplan_runtime.operating.stream_rates import StreamRates
from cfgplan_runtime.operating.taps import LeasedTaps
from cfgplan_runtime.runtime import Runtime
from cfgplan_runtime.streams.closable import Closable
from cfgplan_runtime.streams.run_folder import base_folder, claim_name
from cfgplan_runtime.supervision.observation import Ledger, Observation
from cfgplan_runtime.supervision.run_log import RunLog

if TYPE_CHECKING:
    from cfgplan.planning import Planner

MOST_WAITING = 10_000
SILENT_S = 5.0
"""Seconds after which a met target on whose topic nothing comes is reported."""
SPINS_S = 5.0
"""Seconds after which a source that never waits is reported."""
_SPINNING_US, _SPINNING_STEPS = 900_000, 5_000
"""A source spins if it takes so many microseconds of CPU time, or makes so many steps, per second."""
KEEP_ESTIMATES_S = 10.0
"""Estimates are saved at most this often, and at the end."""
_DRAIN_S = 2.0

News: TypeAlias = "Report | str"
"""Something to show: a report, or a warning as text."""


@dataclass(frozen=True)
class Settings:
    """How a run is operated. A file whose path is None is not written; `estimates` is kept from run to run.

    `adjust` is applied to the world whenever it is read, for example to replace the file's horizon.
    """

    planner: Planner | None = None
    estimator: str = "trend"
    guess: str = "declared"
    estimates: Path | None = None
    policy: Policy = field(default_factory=Policy)
    preload: Sequence[str] = ()
    log: Path | None = None
    record: Path | None = None
    metrics_port: int | None = None
    runtime: Callable[[Environment, Path], AbstractContextManager[Runtime]] | None = None
    """Makes what runs the units, given the environment and the folder that code is relative to. None: processes of this
    computer.
    """
    adjust: Callable[[World], World] = lambda world: world
    check: SourceCheck | None = source_fault
    """Finds what keeps the code of a transformation from being started. None: the code is on other computers."""
    reloads: bool = False
    """Whether units are restarted when their code changes."""
    use_cache: bool = True
    """Whether files that are read again use the cache folder, as `cfgplan.load` does."""
    name: str | None = None
    """A name by which `cfgplan ctl` and others find the run, besides its id."""
    first: Preview | None = None
    """The plan that was shown before the run: it is carried out first, unless it is stale by then."""
    told: Mapping[str, str] = field(default_factory=dict)
    """The faults of code that were shown with this plan, by the label of the transformation."""
    beside: Callable[[Operation], AbstractContextManager[object]] | None = None
    """Makes a context that is entered before the first review and left after the last one, such as a publisher of
    targets.
    """


class Operation(Closable):
    """A run from its start to its end; a context manager that leaves nothing behind.

    `path` is the environment file: it is watched, and unit code is relative to its folder. A run starts without units,
    whatever the file says of running ones. `news` is a queue of reports and warnings to show; a full one drops
    the oldest. Raises InputError for a world or a file that can't be used.
    """

    def __init__(self, world: World, path: Path, settings: Settings = Settings()) -> None:
        self.news: queue.Queue[News] = queue.Queue(MOST_WAITING)
        self.log: RunLog | None = None
        self.recorder: Recorder | None = None
        self.metrics_port: int | None = None
        self.ledger = Ledger()
        self._unmet: frozenset[str] | None = None
        """The targets that the last decisive review gave up."""
        self._silent: frozenset[str] = frozenset()
        """The targets that count as unmet because nothing comes on their topics."""
        self._quiet_s: dict[str, float] = {}
        """For each quiet topic of a met target: since when; infinite once that was reported."""
        self._spinning = Spinning()
        self._crowded = CrowdedLinks()
        self.failure = ""
        """Why the manager ended without being asked; empty otherwise."""
        self.begun = threading.Event()
        """Set once the first review is over."""
        self._settings = settings
        self._path = path
        self._following: Following | None = None
        """Fetches the elements to record."""
        self._is_closed_at_once = False
        self._full: set[Path] = set()
        self._kept_s = time.monotonic()
        try:
            with ExitStack() as stack:
                self._start(stack, settings.adjust(world))
                self._stack = stack.pop_all()
        except BaseException:
            if self.recorder is not None:
                self.recorder.recording.path.unlink(missing_ok=True)
            raise

    @property
    def id(self) -> str:
        """The run's id."""
        return self.runtime.id

    @property
    def environment(self) -> str:
        """The environment file's name."""
        return self._path.name

    @property
    def dropped(self) -> int:
        """How many elements were dropped because the recorder did not fetch them in time."""
        return 0 if self._following is None else self._following.dropped

    @property
    def all_met(self) -> bool:
        """Whether every target is met: none was given up by the last decisive review, and none is silent."""
        return self._unmet is not None and not self._unmet | self._silent

    def observe(self) -> None:
        """Note in the ledger what units have used by now. Does nothing after the end, and during a review, since its
        update may wait long for a new unit.
        """
        if self.manager.snapshot().phase is not Phase.STABLE:
            return
        with contextlib.suppress(RuntimeFaultError):
            self.ledger.note(self.runtime.observe(), time.monotonic())

    def stop(self) -> None:
        """Begin to stop: units work off their input, files are completed. Returns at once; `wait` waits for the end."""
        threading.Thread(target=self.manager.stop, name="cfgplan-stopping", daemon=True).start()

    def stop_at_once(self) -> None:
        """End every process now."""
        self._is_closed_at_once = True
        self.runtime.close()

    def wait(self, timeout_s: float | None = None) -> bool:
        """Wait until the manager has ended, for whatever reason. Returns whether it has."""
        return self.manager.wait(timeout_s)

    def close(self) -> None:
        """Stop, if not stopped yet, and remove everything the run made."""
        self._stack.close()

    def _start(self, stack: ExitStack, world: World) -> None:
        settings = self._settings
        if settings.record is not None:
            self.recorder = Recorder(settings.record)
            stack.callback(self._finish_recording, self.recorder)
        if settings.log is not None:
            self.log = _open_log(settings.log)
            stack.callback(self.log.close)
        folder = (self._path if self._path.is_dir() else self._path.parent).resolve()
        if settings.runtime is None:
            self.runtime = stack.enter_context(Runtime(folder=folder, preload=settings.preload))
        else:
            self.runtime = stack.enter_context(settings.runtime(world.environment, folder))
        if settings.name is not None:
            try:
                claim_name(base_folder() / self.id, settings.name)
            except RuntimeFaultError as error:
                raise InputError.of(str(error)) from None
        if self.recorder is not None:
            facts = {"run": self.id, "environment": str(self._path.resolve()), "version": __version__}
            self.recorder.recording.describe(facts)
            for name, text in world_files(world, folder):
                self.recorder.recording.attach(name, text)
        self._estimator = make_estimator(settings.estimator, settings.guess)
        self._load_estimates()
        self.flows = Flows()
        self.runtime.listen(self.flows.hear)
        self.manager = Manager(
            world,
            self.runtime,
            planner=settings.planner,
            estimator=self._estimator,
            policy=settings.policy,
            first=settings.first,
        )
        if self.log is not None:
            self.manager.listen(logging_to(self.log))
        if self.recorder is not None:
            self.manager.listen(self.recorder.report)
        printed, self.rates, self._past = Printed(), StreamRates(), Past()
        self.manager.listen(printed.hear)
        self.manager.listen(self.rates.hear)
        taps = LeasedTaps(self.runtime, base_folder() / self.id)
        self.manager.listen(taps.hear)
        moments = Moments(self._moment)
        self.manager.listen(moments.hear)
        methods = Methods(self.manager, self.flows, printed, self._past, self.rates, taps, moments).by_name()
        if self.recorder is not None:
            listener = self.recorder.element
            self._following = Following(self.runtime, self._recorded_topics, listener, self.show, "recorded")
            stack.callback(self._following.close)
        self._observed = ObservedFacts(self.runtime, self.manager, self.show)
        stack.callback(self._observed.close)
        self._server = ControlServer(base_folder() / self.id, methods, str(self._path.resolve()))
        stack.callback(self._server.close)
        if settings.metrics_port is not None:
            self._serve_metrics(stack, settings.metrics_port)
        self.manager.listen(self._hear)
        self._sources = Sources(
            folder,
            settings.check,
            library=lambda: self.manager.world.environment.library,
            running=lambda: self.runtime.environment.units,
            request=self.manager.request,
            tell=self.show,
            tell_old=self.manager.note_old_code,
            reloads=settings.reloads,
            told=settings.told,
        )
        self.manager.listen(self._sources.hear)
        self._sources.look_at(world.environment.library)
        if settings.beside is not None:
            stack.enter_context(settings.beside(self))
        self.manager.start()
        stack.callback(self._stop_manager)
        world_watch = WorldWatch(self._path, self._take_world, self.manager.refuse, use_cache=settings.use_cache)
        for watch in (self._sources, world_watch):
            watch.start()
            stack.callback(watch.close)

    def _moment(self) -> Moment:
        snapshot = self.manager.snapshot()
        return snapshot, self.rates.of_topics(self.flows, snapshot.targets)

    def _recorded_topics(self) -> list[str]:
        return [target.topic for target in self.manager.world.environment.stream_targets]

    def _take_world(self, world: World, by: str) -> None:
        adjusted = self._settings.adjust(world)
        # Once the manager has accepted the world, the watch of sources reports the faults.
        self.manager.request(ReplaceWorld(adjusted, by, self._sources.faults_of(adjusted.environment.library)))

    def _hear(self, report: Report) -> None:
        self._tell_of_full_disks()
        match report:
            case Reviewed(review):
                self._observed.follow()
                if self._following is not None:
                    self._following.look()
                if review.decision not in (Decision.FAILED, Decision.UNDECIDED):
                    self._unmet = frozenset(review.unmet) - self.manager.silent
                self.begun.set()
                if time.monotonic() - self._kept_s >= KEEP_ESTIMATES_S:
                    self._keep_estimates()
            case Observed(observations):
                self.ledger.note(observations, time.monotonic())
                self._silent = self.manager.silent
                self._tell_of_silence()
                library = self.manager.world.environment.transformation
                for warning in self._spinning.warnings(observations, library, time.monotonic()):
                    self.show(warning)
                for warning in self._crowded.warnings(self.flows.crossings, time.monotonic()):
                    self.show(warning)
                return
            case Ended(cause):
                self.failure = "" if self._is_closed_at_once else cause
                self.begun.set()
        event = self._past.take(report)
        if event is not None and self._server.has_subscribers:
            self._server.publish(event)
        self.show(report)

    def _tell_of_full_disks(self) -> None:
        """Warn once for each file that can't be written any more."""
        for file in (self.log, None if self.recorder is None else self.recorder.recording):
            if file is not None and file.failure is not None and file.path not in self._full:
                self._full.add(file.path)
                self.show(f"{file.path} can't be written any more: {file.failure}; lost lines are counted")

    def _tell_of_silence(self) -> None:
        """Warn once for each met target on whose topic nothing comes, and again if something has come in between."""
        now, flows = time.monotonic(), self.flows.now()
        for target in self.manager.targets:
            if not target.topic:
                continue
            silent_s = flows.get(target.topic, Flow()).silent_s
            if not target.is_met or (silent_s is not None and silent_s < SILENT_S):
                self._quiet_s.pop(target.topic, None)
            elif now - self._quiet_s.setdefault(target.topic, now) >= SILENT_S:
                self._quiet_s[target.topic] = inf
                self.show(f"{target.label} is met by {target.stream}, but nothing comes on {target.topic}")

    def show(self, news: News) -> None:
        """Queue a report or a warning for showing."""
        while True:
            try:
                self.news.put_nowait(news)
                return
            except queue.Full:
                with contextlib.suppress(queue.Empty):
                    self.news.get_nowait()

    def _serve_metrics(self, stack: ExitStack, port: int) -> None:
        needed("metrics", "prometheus_client")
        from cfgplan_runtime.operating.metrics import Metrics, serve

        metrics = Metrics(self.manager.snapshot, self.flows)
        self.manager.listen(metrics.listen)
        server = serve(port, metrics)
        self.metrics_port = server.port
        stack.callback(server.close)

    def _load_estimates(self) -> None:
        if self._settings.estimates is not None:
            try:
                load(self._estimator, self._settings.estimates, time.monotonic())
            except EstimatesError as error:
                self.show(str(error))

    def _keep_estimates(self) -> None:
        self._kept_s = time.monotonic()
        if self._settings.estimates is not None:
            try:
                save(self._estimator, self._settings.estimates, time.monotonic())
            except EstimatesError as error:
                self.show(str(error))

    def _stop_manager(self) -> None:
        if self._is_closed_at_once:
            self.manager.close()
        else:
            self.manager.stop()
            if self._following is not None:
                self._following.drain(_DRAIN_S)
        self._keep_estimates()

    def _finish_recording(self, recorder: Recorder) -> None:
        if not recorder.close():
            self.show(f"{recorder.recording.path}: the disk does not answer; the recording has no proper end")


class Spinning:
    """Finds sources that spin: they have no rate, and give elements without a pause."""

    def __init__(self) -> None:
        self._since_s: dict[str, float] = {}

    def warnings(
        self, observations: Iterable[Observation], library: Mapping[str, Transformation], now_s: float
    ) -> Iterator[str]:
        """Take in observations. Returns a warning for each unit that has spun for long enough, once."""
        for one in observations:
            known = library.get(one.transformation)
            is_free = known is not None and not known.inputs and known.outputs and known.run.rate_hz is None
            upkeep_us = one.upkeep_us or 0
            if not is_free or (upkeep_us < _SPINNING_US and one.steps_per_s < _SPINNING_STEPS):
                self._since_s.pop(one.unit, None)
            elif now_s - self._since_s.setdefault(one.unit, now_s) >= SPINS_S:
                self._since_s[one.unit] = inf
                yield (
                    f"{one.unit} never waits: {one.steps_per_s:.0f} steps a second take {upkeep_us / 10_000:.0f} % of "
                    "a core; say how often it gives an element (`run: {rate: 10}`), or let its code wait"
                )


def _open_log(path: Path) -> RunLog:
    try:
        return RunLog(path)
    except OSError as error:
        raise InputError.unwritable(error, str(path)) from None
