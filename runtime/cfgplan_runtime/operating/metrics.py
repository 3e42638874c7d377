"""A manager's metrics for Prometheus (extra `metrics`): counters of what happened, gauges of what there is."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from wsgiref.simple_server import WSGIServer

from prometheus_client import CollectorRegistry, Counter, Histogram, start_http_server

from cfgplan_runtime.children.messages import Flow
from cfgplan_runtime.errors import RuntimeFaultError
from cfgplan_runtime.lifecycle.perturbations import UnitGone
from cfgplan_runtime.lifecycle.reports import Perturbed, Report, Review, Reviewed, Snapshot, UnitEvent
from cfgplan_runtime.operating.present_metrics import Present

LOOPBACK = "127.0.0.1"
_BUCKETS_S = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 30)


class Metrics:
    """Counts a manager's reports, and reads its snapshot at each scrape.

    Pass `listen` to `Manager.listen`; `snapshot` is `Manager.snapshot`, `flows` is `Flows.now`. Units that have ended
    are left out.
    """

    def __init__(
        self, snapshot: Callable[[], Snapshot] | None = None, flows: Callable[[], Mapping[str, Flow]] | None = None
    ) -> None:
        self.registry = CollectorRegistry()
        self._perturbations = Counter(
            "cfgplan_perturbations", "Perturbations noticed.", ["kind"], registry=self.registry
        )
        self._reviews = Counter(
            "cfgplan_reviews", "Review intervals, by how they ended.", ["decision"], registry=self.registry
        )
        self._phases = Histogram(
            "cfgplan_review_phase_seconds",
            "Wall time of the phases of a review: detect, match, estimate, plan, judge, apply.",
            ["phase"],
            buckets=_BUCKETS_S,
            registry=self.registry,
        )
        self._changes = Counter(
            "cfgplan_unit_changes",
            "Units that updates have started, rewired or stopped.",
            ["change"],
            registry=self.registry,
        )
        self._failures = Counter(
            "cfgplan_unit_failures", "Units that ended unasked.", ["transformation", "how"], registry=self.registry
        )
        self._events = Counter("cfgplan_events", "Events of units and streams.", ["event"], registry=self.registry)
        if snapshot is not None:
            self.registry.register(Present(snapshot, flows or dict))

    def listen(self, report: Report) -> None:
        """Count a report; from any thread."""
        match report:
            case Perturbed(perturbation):
                self._perturbations.labels(type(perturbation).__name__).inc()
                if isinstance(perturbation, UnitGone):
                    self._failures.labels(perturbation.transformation, perturbation.how).inc()
            case Reviewed(review):
                self._count(review)
            case UnitEvent(event):
                self._events.labels(type(event).__name__).inc()

    def _count(self, review: Review) -> None:
        self._reviews.labels(review.decision.value).inc()
        for phase, seconds in review.seconds.items():
            self._phases.labels(phase).observe(seconds)
        if review.decision.value == "applied" and review.change_set is not None:
            for change in ("started", "rewired", "stopped"):
                self._changes.labels(change).inc(len(getattr(review.change_set, change)))


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
