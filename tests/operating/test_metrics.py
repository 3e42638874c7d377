"""Metrics, scraped as Prometheus does."""

from __future__ import annotations

import socket
import urllib.request
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import pytest
from cfgplan_runtime.children.messages import CrossingCounts, Flow, PortCounts
from cfgplan_runtime.errors import RuntimeFaultError
from cfgplan_runtime.lifecycle.perturbations import HorizonReached, UnitGone
from cfgplan_runtime.lifecycle.reports import Decision, Perturbed, Reviewed, Snapshot, UnitEvent, UnitView
from cfgplan_runtime.operating.flows import Flows
from cfgplan_runtime.operating.metrics import Metrics, MetricsServer, serve
from cfgplan_runtime.supervision.events import (
    CertificateEnds,
    CrossingsStatus,
    Event,
    HostLost,
    TopicsStatus,
    UnitDied,
)
from fake_manager import DETECTOR, REVIEW, SNAPSHOT, observation
from prometheus_client.parser import text_string_to_metric_families

from cfgplan.facts import Fact

PORTS = {"image": PortCounts(elements=90, dropped=4, waiting=7)}
SEEN = replace(observation("detector.1"), inputs=PORTS, outputs={"ball": PortCounts(elements=80)})
UNIT = {"unit": "detector.1", "transformation": "detector", "host": "nao1"}


class StillFlows(Flows):
    """Flows as they were told, however long ago."""

    def hear(self, event: Event) -> None:
        super().hear(event)
        if isinstance(event, TopicsStatus):
            self.told = event.flows

    def now(self) -> dict[str, Flow]:
        return self.told


class Scraped:
    def __init__(self) -> None:
        self.snapshot = replace(SNAPSHOT, units=(UnitView(DETECTOR, "nao1", SEEN),))
        flows = self.flows = StillFlows()
        flows.hear(TopicsStatus({"/result": Flow(rate_hz=29.5, latency_ms=12.0, elements=300)}))
        image, gone = ("camera.1/image", "r1", "base"), ("", "r1", "base")
        flows.hear(CrossingsStatus({image: CrossingCounts(900, 30, 8), gone: CrossingCounts(70, 5)}))
        self.metrics = Metrics(self._look, flows)
        self.server: MetricsServer = serve(0, self.metrics)

    def _look(self) -> Snapshot:
        return self.snapshot

    def __call__(self, name: str, **labels: str) -> float | None:
        """The value of one sample at this moment."""
        address = f"http://127.0.0.1:{self.server.port}/metrics"
        with urllib.request.urlopen(address, timeout=60) as answer:
            text = answer.read().decode()
        for family in text_string_to_metric_families(text):
            for sample in family.samples:
                if sample.name == f"cfgplan_{name}" and sample.labels == labels:
                    return float(sample.value)
        return None


@pytest.fixture
def scrape() -> Iterator[Scraped]:
    scraped = Scraped()
    yield scraped
    scraped.server.close()


def test_perturbations_are_counted_by_kind(scrape: Scraped) -> None:
    for _ in range(3):
        scrape.metrics.listen(Perturbed(HorizonReached(60)))
    scrape.metrics.listen(Perturbed(UnitGone("detector.1", "detector", "hung", "silent")))
    assert scrape("perturbations_total", kind="HorizonReached") == 3
    assert scrape("perturbations_total", kind="UnitGone") == 1
    assert scrape("unit_failures_total", transformation="detector", how="hung") == 1


def test_reviews_are_counted_and_their_phases_timed(scrape: Scraped) -> None:
    scrape.metrics.listen(Reviewed(REVIEW))
    scrape.metrics.listen(Reviewed(replace(REVIEW, decision=Decision.DEFERRED, seconds={"plan": 0.5})))
    assert scrape("reviews_total", decision="applied") == 1
    assert scrape("reviews_total", decision="deferred") == 1
    assert scrape("review_phase_seconds_count", phase="plan") == 2
    assert scrape("review_phase_seconds_sum", phase="plan") == pytest.approx(0.502)
    assert scrape("review_phase_seconds_bucket", phase="plan", le="0.1") == 1
    assert scrape("unit_changes_total", change="started") == 1, "what is deferred changes nothing"


def test_events_are_counted_by_name(scrape: Scraped) -> None:
    scrape.metrics.listen(UnitEvent(UnitDied("detector.1", "killed by SIGKILL")))
    assert scrape("events_total", event="UnitDied") == 1


def test_a_unit_shows_what_it_uses_in_seconds_and_bytes(scrape: Scraped) -> None:
    assert scrape("unit_cpu_seconds_total", **UNIT) == 0.9
    assert scrape("unit_upkeep_cpu_ratio", **UNIT) == 0.02
    assert scrape("unit_labor_cpu_seconds", **UNIT) == 0.3
    assert scrape("unit_memory_bytes", **UNIT) == 25 << 20
    assert scrape("unit_steps_total", **UNIT) == 100


def test_a_units_ports_show_elements_drops_and_queue(scrape: Scraped) -> None:
    assert scrape("unit_input_elements_total", **UNIT, port="image") == 90
    assert scrape("unit_input_dropped_elements_total", **UNIT, port="image") == 4
    assert scrape("unit_input_waiting_elements", **UNIT, port="image") == 7
    assert scrape("unit_output_elements_total", **UNIT, port="ball") == 80


def test_streams_between_hosts_show_their_drops(scrape: Scraped) -> None:
    hosts = {"from": "r1", "to": "base"}
    assert scrape("crossing_elements_total", stream="camera.1/image", **hosts) == 900
    assert scrape("crossing_dropped_elements_total", stream="camera.1/image", **hosts) == 30
    assert scrape("crossing_waiting_elements", stream="camera.1/image", **hosts) == 8
    assert scrape("crossing_dropped_elements_total", stream="", **hosts) == 5


def test_a_target_shows_whether_it_is_met_its_rate_and_latency(scrape: Scraped) -> None:
    assert scrape("target_met", target="ball", topic="/result") == 1
    assert scrape("target_met", target="goal", topic="/goal") == 0
    assert scrape("target_rate_hertz", target="ball", topic="/result") == 29.5
    assert scrape("target_latency_seconds", target="ball", topic="/result") == 0.012
    assert scrape("target_elements_total", target="ball", topic="/result") == 300
    assert scrape("target_rate_hertz", target="goal", topic="/goal") is None


def test_a_met_target_on_which_nothing_comes_is_shown_at_no_hertz(scrape: Scraped) -> None:
    scrape.flows.hear(TopicsStatus({"/result": Flow()}))
    assert scrape("target_met", target="ball", topic="/result") == 1
    assert scrape("target_rate_hertz", target="ball", topic="/result") == 0
    assert scrape("target_silent_seconds", target="ball", topic="/result") is None
    scrape.flows.hear(TopicsStatus({"/result": Flow(silent_s=75.0)}))
    assert scrape("target_silent_seconds", target="ball", topic="/result") == 75


def test_the_configuration_shows_its_cost_and_horizon(scrape: Scraped) -> None:
    assert scrape("cost_cpu_seconds") == 2.0
    assert scrape("horizon_seconds") == 60
    assert scrape("units") == 1
    assert scrape("transformation_held_out_seconds", transformation="segmenter", host="") == 4


def test_cold_spares_and_those_that_are_prepared_are_counted(scrape: Scraped) -> None:
    spares = [replace(DETECTOR, id=f"detector.{n}", subscriptions=(), publications=(), standby=True) for n in (2, 3)]
    views = (*scrape.snapshot.units, UnitView(spares[0]), UnitView(spares[1], is_prepared=True))
    scrape.snapshot = replace(scrape.snapshot, units=views)
    assert [scrape(name) for name in ("units", "spares", "prepared_spares")] == [1, 2, 1]


def test_a_unit_that_has_ended_is_not_shown_any_more(scrape: Scraped) -> None:
    scrape.snapshot = replace(SNAPSHOT, units=())
    assert scrape("unit_steps_total", **UNIT) is None
    assert scrape("units") == 0


def test_every_metric_is_described(scrape: Scraped) -> None:
    text = (Path(__file__).parents[2] / "cfgplan" / "manual" / "events.md").read_text()
    families = list(scrape.metrics.registry.collect())
    names = [f"{one.name}_total" if one.type == "counter" else one.name for one in families]
    assert [name for name in names if f"`{name.removeprefix('cfgplan_')}`" not in text] == []


def test_metrics_are_served_on_loopback_only(scrape: Scraped) -> None:
    with socket.create_connection(("127.0.0.1", scrape.server.port), timeout=60) as connection:
        assert connection.getpeername()[0] == "127.0.0.1"
    assert scrape.server.address == "127.0.0.1"


def test_a_port_in_use_is_told(scrape: Scraped) -> None:
    with pytest.raises(RuntimeFaultError, match="give another port"):
        serve(scrape.server.port, Metrics())


def test_a_closed_server_gives_its_port_back() -> None:
    for _ in range(5):  # another process may take the port in between
        server = serve(0, Metrics())
        server.close()
        with suppress(RuntimeFaultError):
            serve(server.port, Metrics()).close()
            return
    pytest.fail("no port was given back")


def test_facts_are_numbers_and_words_are_none(scrape: Scraped) -> None:
    facts = (
        Fact("visibility", 4_000_000, now=2_500_000),
        Fact("night", True),
        Fact("day", False),
        Fact("mode", "survey"),
    )
    scrape.snapshot = replace(SNAPSHOT, facts=facts, facts_heard_s={"visibility": 0.25})
    told = {name: scrape("fact", fact=name) for name in ("visibility", "night", "day", "mode")}
    assert told == {"visibility": 2.5, "night": 1.0, "day": 0.0, "mode": None}
    assert scrape("fact_heard_seconds", fact="visibility") == 0.25


def test_the_days_left_of_a_certificate_are_shown_until_its_host_is_lost(scrape: Scraped) -> None:
    for host, days in (("r1", 12), ("r2", 3), ("r1", 11)):
        scrape.metrics.listen(UnitEvent(CertificateEnds(host, "2026-12-09 18:00 UTC", days)))
    scrape.metrics.listen(UnitEvent(HostLost("r3", "its agent is gone")))
    assert scrape("certificate_days_left", host="r1") == 11
    assert scrape("certificate_days_left", host="r2") == 3
    scrape.metrics.listen(UnitEvent(HostLost("r1", "its agent is gone")))
    assert scrape("certificate_days_left", host="r1") is None
    assert scrape("certificate_days_left", host="r2") == 3
