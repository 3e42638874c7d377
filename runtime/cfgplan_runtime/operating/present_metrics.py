"""Prometheus metrics of what there is at a scrape: configuration, targets, units and their ports."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import TypeAlias

from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from cfgplan.costs import MICROSECONDS
from cfgplan_runtime.children.messages import Flow
from cfgplan_runtime.lifecycle.reports import Snapshot, UnitView
from cfgplan_runtime.supervision.observation import Observation

LabelledValues: TypeAlias = Iterable[tuple[tuple[str, ...], float]]


class Present(Collector):
    """Reads a snapshot and the flows at each scrape, in the scraper's thread."""

    def __init__(self, snapshot: Callable[[], Snapshot], flows: Callable[[], Mapping[str, Flow]]) -> None:
        self._snapshot = snapshot
        self._flows = flows

    def collect(self) -> Iterable[Metric]:
        now = self._snapshot()
        yield from _configuration(now)
        yield from _targets(now, self._flows())
        yield from _units(now.units)
        yield from _ports(now.units)


def _configuration(now: Snapshot) -> Iterable[Metric]:
    for name, help_text, value in (
        ("units", "Units that run.", sum(not view.unit.standby for view in now.units)),
        ("spares", "Cold spares, which can run but do not.", sum(view.unit.standby for view in now.units)),
        ("lost_hosts", "Hosts that nothing is planned on.", len(now.lost_hosts)),
        ("transformations", "Transformations in the library.", len(now.environment.library)),
        ("pending_perturbations", "Perturbations that wait for a review.", len(now.pending)),
        ("horizon_seconds", "Length of the horizon.", now.horizon_s),
        ("horizon_left_seconds", "Time until the horizon is reached.", now.horizon_left_s),
        ("cost_cpu_seconds", "Expected CPU time of what runs, over the horizon.", now.cost_us / MICROSECONDS),
        ("deferred_saving_cpu_seconds", "What is put off until the horizon would save.", now.saving_us / MICROSECONDS),
    ):
        yield _gauge(name, help_text, (), [((), value)])
    yield _gauge(
        "transformation_held_out_seconds",
        "For how long a transformation that keeps failing is not started.",
        ("transformation",),
        [((one.transformation,), one.left_s) for one in now.backing_off],
    )


def _targets(now: Snapshot, flows: Mapping[str, Flow]) -> Iterable[Metric]:
    names = ("target", "topic")
    met = [((one.label, one.topic), float(one.is_met)) for one in now.targets]
    yield _gauge("target_met", "Whether a stream meets the target, and is not silent for too long.", names, met)
    known = [((one.label, one.topic), flows[one.topic]) for one in now.targets if one.topic in flows]
    rates = [(labels, flow.rate_hz) for labels, flow in known]
    yield _gauge("target_rate_hertz", "Elements per second on the topic, over the last seconds.", names, rates)
    ages = [(labels, flow.latency_ms / 1e3) for labels, flow in known if flow.latency_ms is not None]
    yield _gauge("target_latency_seconds", "Median age of the elements when they come out.", names, ages)
    silent = [(labels, flow.silent_s) for labels, flow in known if flow.silent_s is not None]
    yield _gauge("target_silent_seconds", "Time since the last element on the topic.", names, silent)
    elements = [(labels, flow.elements) for labels, flow in known]
    yield _counter("target_elements", "Elements that came out on the topic.", names, elements)


def _units(units: Iterable[UnitView]) -> Iterable[Metric]:
    seen = _observed(units)

    def values(read: Callable[[Observation], float]) -> LabelledValues:
        return [(labels, read(one)) for labels, one in seen]

    names = ("unit", "transformation", "host")
    yield _counter(
        "unit_cpu_seconds", "CPU time since the start.", names, values(lambda one: one.cpu_us / MICROSECONDS)
    )
    yield _counter("unit_steps", "Steps since the start.", names, values(lambda one: one.steps))
    yield _counter("unit_step_errors", "Steps that failed.", names, values(lambda one: one.errors))
    yield _gauge("unit_memory_bytes", "Resident memory.", names, values(lambda one: one.memory_bytes))
    yield _gauge(
        "unit_labor_cpu_seconds", "CPU time of the start.", names, values(lambda one: one.labor_us / MICROSECONDS)
    )
    yield _gauge(
        "unit_upkeep_cpu_ratio",
        "CPU time per second over the last observation.",
        names,
        [(labels, one.upkeep_us / MICROSECONDS) for labels, one in seen if one.upkeep_us is not None],
    )


def _ports(units: Iterable[UnitView]) -> Iterable[Metric]:
    names = ("unit", "transformation", "host", "port")
    seen = _observed(units)
    inputs = [((*labels, port), counts) for labels, one in seen for port, counts in sorted(one.inputs.items())]
    outputs = [((*labels, port), counts) for labels, one in seen for port, counts in sorted(one.outputs.items())]
    taken = [(labels, counts.elements) for labels, counts in inputs]
    yield _counter("unit_input_elements", "Elements taken in.", names, taken)
    dropped = [(labels, counts.dropped) for labels, counts in inputs]
    yield _counter("unit_input_dropped_elements", "Elements dropped because there was no room.", names, dropped)
    waiting = [(labels, counts.waiting) for labels, counts in inputs]
    yield _gauge("unit_input_waiting_elements", "Elements that wait at the input.", names, waiting)
    given = [(labels, counts.elements) for labels, counts in outputs]
    yield _counter("unit_output_elements", "Elements given.", names, given)


def _observed(units: Iterable[UnitView]) -> list[tuple[tuple[str, ...], Observation]]:
    return [
        ((view.unit.id, view.unit.transformation, view.host or ""), view.observation)
        for view in units
        if view.observation is not None
    ]


def _gauge(name: str, help_text: str, names: tuple[str, ...], values: LabelledValues) -> Metric:
    family = GaugeMetricFamily(f"cfgplan_{name}", help_text, labels=names)
    for labels, value in values:
        family.add_metric(labels, value)
    return family


def _counter(name: str, help_text: str, names: tuple[str, ...], values: LabelledValues) -> Metric:
    family = CounterMetricFamily(f"cfgplan_{name}", help_text, labels=names)
    for labels, value in values:
        family.add_metric(labels, value)
    return family
