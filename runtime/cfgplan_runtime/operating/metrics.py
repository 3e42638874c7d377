"""A manager's metrics for Prometheus (extra `metrics`): counters of events, gauges of the present state."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Final, Generic, TypeVar
from wsgiref.simple_server import WSGIServer

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, start_http_server
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from cfgplan.facts import Fact
from cfgplan.qualities import MICRO
from cfgplan_runtime.children.messages import CrossingCounts, Flow, PortCounts
from cfgplan_runtime.errors import RuntimeFaultError
from cfgplan_runtime.lifecycle import reports
from cfgplan_runtime.lifecycle.kinds import growths
from cfgplan_runtime.operating.flows import Flows
from cfgplan_runtime.supervision.events import CertificateEnds, HostLost
from cfgplan_runtime.supervision.observation import Observation

LOOPBACK = "127.0.0.1"
_BUCKETS_S = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 30)


_US_PER_S: Final = 1_000_000
_TARGET: Final = ("target", "topic")
_UNIT: Final = ("unit", "transformation", "host")
_OWN_PART: Final = ("transformation", "output", "attribute", "host")
_CROSSING: Final = ("stream", "from", "to")
_PORT: Final = (*_UNIT, "port")

Measured = TypeVar("Measured")


@dataclass(frozen=True, slots=True)
class _Measure(Generic[Measured]):
    """A metric that is read at each scrape: a counter if its value only `rises`, else a gauge. None is left out."""

    name: str
    help_text: str
    read: Callable[[Measured], float | None]
    rises: bool = False

    def family(self, names: tuple[str, ...], seen: Iterable[tuple[tuple[str, ...], Measured]]) -> Metric:
        """The metric with a sample for each of `seen`, which has the values of the labels `names`."""
        kind = CounterMetricFamily if self.rises else GaugeMetricFamily
        family = kind(f"cfgplan_{self.name}", self.help_text, labels=names)
        for labels, one in seen:
            value = self.read(one)
            if value is not None:
                family.add_metric(labels, value)
        return family


_OF_ALL: Final[Sequence[_Measure[reports.Snapshot]]] = (
    _Measure("units", "Units that run.", lambda now: sum(not view.unit.standby for view in now.units)),
    _Measure(
        "spares",
        "Cold spares, which can run but do not.",
        lambda now: sum(view.unit.standby for view in now.units),
    ),
    _Measure(
        "prepared_spares", "Cold spares whose code is constructed.", lambda now: sum(v.is_prepared for v in now.units)
    ),
    _Measure("lost_hosts", "Hosts that nothing is planned on.", lambda now: len(now.lost_hosts)),
    _Measure("transformations", "Transformations in the library.", lambda now: len(now.environment.library)),
    _Measure("pending_perturbations", "Perturbations that wait for a review.", lambda now: len(now.pending)),
    _Measure("horizon_seconds", "Length of the horizon.", lambda now: now.horizon_s),
    _Measure("horizon_left_seconds", "Time until the horizon is reached.", lambda now: now.horizon_left_s),
    _Measure(
        "cost_cpu_seconds",
        "Expected CPU time of what runs, over the horizon.",
        lambda now: now.cost_us / _US_PER_S,
    ),
    _Measure(
        "deferred_saving_cpu_seconds",
        "What is put off until the horizon would save.",
        lambda now: now.saving_us / _US_PER_S,
    ),
)
_OF_HELD_OUT: Final[_Measure[reports.BackingOff]] = _Measure(
    "transformation_held_out_seconds",
    "For how long a transformation that keeps failing is not started.",
    lambda one: one.left_s,
)
_OF_FACTS: Final[_Measure[Fact]] = _Measure(
    "fact",
    "A fact of the world: its number, or whether it is true.",
    lambda fact: None if isinstance(fact.value, str) else fact.value if fact.value is True else fact.value / MICRO,
)
_OF_HEARD: Final[_Measure[float]] = _Measure(
    "fact_heard_seconds", "Time since a stream said the value of the fact.", lambda ago_s: ago_s
)
_OF_QUALITIES: Final[Sequence[_Measure[reports.QualityView]]] = (
    _Measure("quality_declared", "The own part of an output, as declared.", lambda one: one.stated / MICRO),
    _Measure("quality_planned", "The own part that plans go by.", lambda one: one.planned / MICRO),
    _Measure("quality_observed", "The own part that streams have taught.", lambda one: one.estimate / MICRO),
    _Measure("quality_observed_error", "The standard error of what was taught.", lambda one: one.error / MICRO),
)
_OF_TARGETS: Final[_Measure[reports.TargetView]] = _Measure(
    "target_met", "Whether a stream meets the target, and is not silent for too long.", lambda one: float(one.is_met)
)
_OF_FLOWS: Final[Sequence[_Measure[Flow]]] = (
    _Measure(
        "target_rate_hertz", "Elements per second on the topic, over the last seconds.", lambda flow: flow.rate_hz
    ),
    _Measure(
        "target_latency_seconds",
        "Median age of the elements when they come out.",
        lambda one: None if one.latency_ms is None else one.latency_ms / 1e3,
    ),
    _Measure("target_silent_seconds", "Time since the last element on the topic.", lambda one: one.silent_s),
    _Measure("target_elements", "Elements that came out on the topic.", lambda one: one.elements, rises=True),
)
_OF_UNITS: Final[Sequence[_Measure[Observation]]] = (
    _Measure("unit_cpu_seconds", "CPU time since the start.", lambda one: one.cpu_us / _US_PER_S, rises=True),
    _Measure("unit_steps", "Steps since the start.", lambda one: one.steps, rises=True),
    _Measure("unit_step_errors", "Steps that failed.", lambda one: one.errors, rises=True),
    _Measure("unit_memory_bytes", "Resident memory.", lambda one: one.memory_bytes),
    _Measure("unit_labor_cpu_seconds", "CPU time of the start.", lambda one: one.labor_us / _US_PER_S),
    _Measure(
        "unit_upkeep_cpu_ratio",
        "CPU time per second over the last observation.",
        lambda one: None if one.upkeep_us is None else one.upkeep_us / _US_PER_S,
    ),
)
_OF_INPUTS: Final[Sequence[_Measure[PortCounts]]] = (
    _Measure("unit_input_elements", "Elements taken in.", lambda one: one.elements, rises=True),
    _Measure(
        "unit_input_dropped_elements",
        "Elements dropped because there was no room.",
        lambda one: one.dropped,
        rises=True,
    ),
    _Measure("unit_input_waiting_elements", "Elements that wait at the input.", lambda one: one.waiting),
)
_OF_CROSSINGS: Final[Sequence[_Measure[CrossingCounts]]] = (
    _Measure("crossing_elements", "Elements that go to another host.", lambda one: one.elements, rises=True),
    _Measure(
        "crossing_dropped_elements", "Elements dropped because there was no room.", lambda one: one.dropped, rises=True
    ),
    _Measure("crossing_offered_bytes", "Bytes to be sent to another host.", lambda one: one.offered_bytes, rises=True),
    _Measure("crossing_arrived_bytes", "Bytes that have arrived there.", lambda one: one.arrived_bytes, rises=True),
    _Measure("crossing_waiting_elements", "Elements that have not arrived yet.", lambda one: one.waiting),
)
_GROWING: Final[Mapping[str, tuple[str, Sequence[str], Sequence[float] | None]]] = {
    "perturbations": ("Perturbations noticed.", ["kind"], None),
    "reviews": ("Review intervals, by how they ended.", ["decision"], None),
    "review_phase_seconds": (
        "Wall time of the phases of a review: detect, match, estimate, plan, judge, apply.",
        ["phase"],
        _BUCKETS_S,
    ),
    "unit_changes": ("Units that updates have started, rewired or stopped.", ["change"], None),
    "unit_failures": ("Units that ended unasked.", ["transformation", "how"], None),
    "events": ("Events of units and streams.", ["event"], None),
}
"""The metrics that grow with reports, as the table of what happens says: help, labels, and a histogram's buckets."""
_OF_OUTPUTS: Final[_Measure[PortCounts]] = _Measure(
    "unit_output_elements", "Elements given.", lambda one: one.elements, rises=True
)


class Present(Collector):
    """Reads a snapshot and the flows at each scrape, in the scraper's thread."""

    def __init__(self, snapshot: Callable[[], reports.Snapshot], flows: Flows) -> None:
        self._snapshot = snapshot
        self._flows = flows

    def collect(self) -> Iterable[Metric]:
        now, flows = self._snapshot(), self._flows.now()
        yield from (measure.family((), [((), now)]) for measure in _OF_ALL)
        held_out = [((one.transformation, one.host or ""), one) for one in now.backing_off]
        yield _OF_HELD_OUT.family(("transformation", "host"), held_out)
        yield _OF_FACTS.family(("fact",), [((fact.key,), fact) for fact in now.facts])
        own_parts = [((one.transformation, one.output, one.attribute, one.host or ""), one) for one in now.qualities]
        yield from (measure.family(_OWN_PART, own_parts) for measure in _OF_QUALITIES)
        yield _OF_HEARD.family(("fact",), [((name,), ago_s) for name, ago_s in now.facts_heard_s.items()])
        targets = [((one.label, one.topic), one) for one in now.targets]
        yield _OF_TARGETS.family(_TARGET, targets)
        known = [(labels, flows[one.topic]) for labels, one in targets if one.topic in flows]
        yield from (measure.family(_TARGET, known) for measure in _OF_FLOWS)
        seen = [
            ((view.unit.id, view.unit.transformation, view.host or ""), view.observation)
            for view in now.units
            if view.observation is not None
        ]
        yield from (measure.family(_UNIT, seen) for measure in _OF_UNITS)
        inputs = [((*labels, port), counts) for labels, one in seen for port, counts in sorted(one.inputs.items())]
        outputs = [((*labels, port), counts) for labels, one in seen for port, counts in sorted(one.outputs.items())]
        yield from (measure.family(_PORT, inputs) for measure in _OF_INPUTS)
        yield _OF_OUTPUTS.family(_PORT, outputs)
        crossings = sorted(self._flows.crossings.items())
        yield from (measure.family(_CROSSING, crossings) for measure in _OF_CROSSINGS)


class Metrics:
    """Counts a manager's reports, and reads its snapshot at each scrape.

    Pass `listen` to `Manager.listen`. `snapshot` is `Manager.snapshot`; `flows` has the rates and counts of streams.
    Units that have ended are left out.
    """

    def __init__(self, snapshot: Callable[[], reports.Snapshot] | None = None, flows: Flows | None = None) -> None:
        self.registry = CollectorRegistry()
        self._growing = {
            name: (Counter if buckets is None else partial(Histogram, buckets=buckets))(
                f"cfgplan_{name}", help_text, labels, registry=self.registry
            )
            for name, (help_text, labels, buckets) in _GROWING.items()
        }
        self._certificates = Gauge(
            "cfgplan_certificate_days_left",
            "Days until the certificate of a host ends, from 30 days before.",
            ["host"],
            registry=self.registry,
        )
        if snapshot is not None:
            self.registry.register(Present(snapshot, flows or Flows()))

    def listen(self, report: reports.Report) -> None:
        """Count a report; from any thread."""
        for name, labels, amount in growths(report):
            metric = self._growing[name].labels(*labels)
            metric.observe(amount) if isinstance(metric, Histogram) else metric.inc(amount)
        match report:
            case reports.UnitEvent(CertificateEnds(host, _, days_left)):
                self._certificates.labels(host).set(days_left)
            case reports.UnitEvent(HostLost(host)):
                with suppress(KeyError):  # it may come back with a new certificate; it tells again if that ends soon
                    self._certificates.remove(host)


class MetricsServer:
    """Serves metrics at `http://<address>:<port>/metrics` until it is closed."""

    def __init__(self, server: WSGIServer, thread: threading.Thread) -> None:
        self._server = server
        self._thread = thread

    @property
    def port(self) -> int:
        return self._server.server_port

    @property
    def address(self) -> str:
        return str(self._server.server_address[0])

    def close(self) -> None:
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


def serve(port: int, metrics: Metrics, address: str = LOOPBACK) -> MetricsServer:
    """Serve metrics from a thread; port 0 takes a free one. Raises RuntimeFaultError if the port can't be had."""
    try:
        return MetricsServer(*start_http_server(port, address, metrics.registry))
    except (OSError, OverflowError) as error:
        raise RuntimeFaultError(f"metrics can't be served on {address}:{port}: {error}; give another port") from None
