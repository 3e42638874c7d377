"""Acceptance tests of a fleet of three computers: swaps, cut and overloaded links, killed agents and units.

    python experiments/fleet/acceptance.py [--case NAME ...] [--short]

The computers are network namespaces (`network.py`) whose agents have certificates; the manager runs on `base`. Each
case prints its figures and its limit. The exit code is 1 if a limit is missed, 77 if namespaces are not available.
With --short, time limits are ignored, since a busy computer misses them.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import re
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

from computers import (
    HOSTS,
    PATIENCE_S,
    QUEUE,
    RATE_HZ,
    SLOW_LINKS,
    SOME,
    UNITS,
    Fleet,
    Listener,
    events,
    eventually,
    library,
    stream,
    targets,
    unit,
)
from fleet_storm import faults_after
from network import Network, run_within

LEASE_S = 2.0
"""The lease of most cases, as by default."""
PATIENT_LEASE_S = 10.0
"""The lease of short cases that need all hosts: a busy computer stops an agent for seconds now and then."""


@dataclass(frozen=True)
class Seen:
    """The result of a case: figures as text, whether they are correct, and whether they keep the time limits."""

    text: str
    is_right: bool
    is_in_time: bool = True


def swaps(fleet: Fleet, short: bool) -> Seen:
    """200 swaps across hosts at 200 Hz: nothing lost, repeated, out of order; median under 60 ms."""
    from cfgplan.domain import ChangeSet

    number, took_s = 12 if short else 200, []
    with stream(fleet, "r1", "r2") as (runtime, listener):
        for index in range(2, number + 2):
            new = unit(f"same.{index}", HOSTS[index % 3], x="count.1/n", topic="/result")
            start = time.monotonic()
            runtime.apply(ChangeSet(started=(new,), stopped=(f"same.{index - 1}",)))
            took_s.append(time.monotonic() - start)
        listener.await_more()
    median_s = statistics.median(took_s)
    text = f"{number} swaps, {len(listener.values)} elements, {listener.wrong()} wrong, median {ms(median_s)}"
    text += f", longest silence {ms(listener.silence_s())}"
    return Seen(text, listener.wrong() == 0, median_s < 0.06)


def cut(fleet: Fleet, short: bool) -> Seen:
    """Link cut for 0.3 s and 1 s (lease 2 s): nothing lost, no host taken for lost."""
    texts, holds = [], True
    for span_s in (0.3,) if short else (0.3, 1.0):
        with stream(fleet, "r1", "r2") as (runtime, listener):
            before = len(listener.values)
            fleet.network.cut("r2")
            time.sleep(span_s)
            fleet.network.mend("r2")
            listener.await_more(round(RATE_HZ * (span_s + 1)))
            lost = events(runtime, "HostLost")
            silence_s = max(b - a for a, b in pairwise(listener.at_s[before - 1 :]))
            texts.append(f"{span_s} s: {listener.wrong()} wrong, {len(lost)} hosts lost, silence {ms(silence_s)}")
            holds = holds and listener.wrong() == 0 and not lost
    return Seen("; ".join(texts), holds)


def swap_in_cut(fleet: Fleet, short: bool) -> Seen:
    """A swap that begins as the old host is cut for 1 s, or 2.5 s (lease 4 s): nothing lost, repeated, out of order."""
    from cfgplan.domain import ChangeSet

    span_s = 2.5 if fleet.lease_s > LEASE_S else 0.3 if short else 1.0
    with stream(fleet, "r1", "r2") as (runtime, listener):
        fleet.network.cut("r2")
        threading.Timer(span_s, fleet.network.mend, ["r2"]).start()
        start = time.monotonic()
        new = unit("same.2", "base", x="count.1/n", topic="/result")
        runtime.apply(ChangeSet(started=(new,), stopped=("same.1",)))
        took_s = time.monotonic() - start
        listener.await_more()
    return Seen(f"{listener.wrong()} wrong, took {ms(took_s)}", listener.wrong() == 0)


def old_term(fleet: Fleet, short: bool) -> Seen:  # noqa: ARG001
    """The order of an old term is refused."""
    from cfgplan_runtime.errors import RuntimeFaultError

    from cfgplan.domain import ChangeSet

    with fleet.runtime() as old, fleet.runtime() as new:
        refused = ""
        try:
            old.apply(ChangeSet(started=(unit("count.1", "r1"),)))
        except RuntimeFaultError as error:
            refused = str(error)
        new.apply(ChangeSet(started=(unit("count.2", "r1"),)))
        causes = sorted({event.cause for event in events(old, "HostLost")})
        ran = [one.unit for one in new.observe()]
    return Seen(f"{refused}; r1: {', '.join(causes)}", bool(refused) and causes != [] and ran == ["count.2"])


def returning(fleet: Fleet, short: bool) -> Seen:  # noqa: ARG001
    """A host returns: its leftover units end within 1 s, and the elements that they sent meanwhile are reported as
    lost.
    """
    from cfgplan.domain import ChangeSet

    with stream(fleet, "r2", "r1") as (runtime, listener):
        beside = witness(fleet, runtime, "r2")
        runtime.apply(ChangeSet(started=(unit("same.2", "r2", x="count.1/n", topic="/witness"),)))
        beside.await_more()
        eventually(lambda: runtime.pid("count.1") is not None)
        process = Path(f"/proc/{runtime.pid('count.1')}")
        start_s = time.monotonic()
        fleet.network.cut("r2")
        noticed_s = eventually(lambda: bool(events(runtime, "HostLost")))
        beside.await_more(1)
        fleet.network.mend("r2")
        least = beside.values[-1] - listener.values[-1]
        gone_s = eventually(lambda: not process.exists())
        most = RATE_HZ * (time.monotonic() - start_s)
        back_s = gone_s + eventually(lambda: bool(events(runtime, "HostJoined")))
        eventually(lambda: bool(events(runtime, "ElementsLost")))
        (lost,) = events(runtime, "ElementsLost")
    text = (
        f"lost after {ms(noticed_s)}; stale unit gone {ms(gone_s)} after the link was there again, host {ms(back_s)}; "
    )
    text += f"{lost.elements} elements told as lost, {least} to {most:.0f} given"
    return Seen(text, 0.8 * least < lost.elements < 1.2 * most + 40, gone_s < 1.0)


def witness(fleet: Fleet, runtime: Any, host: str) -> Listener:
    """Return a listener to a topic at a host. It gets every element that a unit there publishes, also elements that are
    lost on the way to other hosts.
    """
    from cfgplan_runtime.streams.run_folder import topics_of

    from cfgplan.domain import ChangeSet, Target

    runtime.apply(ChangeSet(added_targets=(Target("witness", "Y", "/witness", host=host),)))
    eventually(lambda: "/witness" in topics_of(fleet.run_folder(host)))
    return Listener(fleet.run_folder(host), "/witness")


@contextlib.contextmanager
def managed(fleet: Fleet) -> Iterator[tuple[Any, Listener, Any]]:
    """Yield a manager, a listener at the base, and the unit that sends numbers to it from r1 or r2."""
    from dataclasses import replace

    from cfgplan_runtime import Manager

    import cfgplan
    from cfgplan.domain import Environment, Host

    numbers, *_, same = library()
    placed = replace(numbers, hosts=("base",)), replace(same, hosts=("r1", "r2"))
    environment = Environment(library=placed, targets=targets()[:1], hosts=tuple(Host(name) for name in HOSTS))
    with (
        fleet.runtime(is_empty=True) as runtime,
        Manager(cfgplan.world(environment, horizon_s=600), runtime) as manager,
    ):
        manager.settle()
        listener = Listener(runtime.id)
        listener.await_more(RATE_HZ)
        yield runtime, listener, next(one for one in runtime.environment.units if one.transformation == "same")


def agent_killed(fleet: Fleet, short: bool) -> Seen:  # noqa: ARG001
    """An agent is killed: the manager moves its unit to another host, silence under 100 ms."""
    with managed(fleet) as (runtime, listener, moving):
        start = time.monotonic()
        fleet.kill_agent(moving.host)
        return after(runtime, listener, start, 0.1)


def unit_killed(fleet: Fleet, short: bool) -> Seen:  # noqa: ARG001
    """A unit on another host is killed: silence under 60 ms."""
    with managed(fleet) as (runtime, listener, moving):
        eventually(lambda: runtime.pid(moving.id) is not None)
        start = time.monotonic()
        os.kill(runtime.pid(moving.id), 9)
        return after(runtime, listener, start, 0.06)


def cut_for_good(fleet: Fleet, short: bool) -> Seen:  # noqa: ARG001
    """A link is cut for good (lease 1 s): silence under 1.5 s."""
    with managed(fleet) as (runtime, listener, moving):
        start = time.monotonic()
        fleet.network.cut(moving.host)
        try:
            return after(runtime, listener, start, 1.5)
        finally:
            fleet.network.mend(moving.host)


def after(runtime: Any, listener: Listener, start_s: float, limit_s: float) -> Seen:
    """Return the result after a failure at a moment, once results come again."""
    known = len(listener.values)
    eventually(lambda: listener.at_s[-1] > start_s + 0.02 and len(listener.values) > known + RATE_HZ)
    silence_s, repeated = listener.silence_s(start_s), sum(b <= a for a, b in pairwise(list(listener.values)))
    lost = [f"{event.host}: {event.cause}" for event in events(runtime, "HostLost")]
    text = f"silence {ms(silence_s)}, {listener.wrong()} lost, {repeated} repeated; {', '.join(lost) or 'no host lost'}"
    return Seen(text, not repeated, silence_s < limit_s)


def overload(fleet: Fleet, short: bool) -> Seen:
    """147 Mbit/s of images over a link of 80: drops are counted, no other stream of the host is silent for 100 ms."""
    from cfgplan.domain import ChangeSet

    span_s = 6.0 if short else 15.0
    with stream(fleet, "r1", "base") as (runtime, listener):
        runtime.apply(
            ChangeSet(started=(unit("images.1", "r1"), unit("same.2", "base", x="images.1/n", topic="/images")))
        )
        images = Listener(runtime.id, "/images", number=lambda image: int(image[0, 0]))
        images.await_more(40 if short else 200)
        undisturbed_s = listener.silence_s(images.at_s[0])
        fleet.network.limit("r1", 80)
        start, seen_before, wrong_before = time.monotonic(), len(images.values), images_lost(images.values)
        time.sleep(span_s)
        silence_s = listener.silence_s(start)
        came, lost = len(images.values) - seen_before, images_lost(images.values) - wrong_before
        eventually(lambda: dropped_by(runtime, "same.2") > 0, 5.0)
        counted = dropped_by(runtime, "same.2")
        fleet.network.unlimit("r1")
    text = f"{came} images came, {lost} did not, {counted} told as dropped; "
    text += f"numbers: {listener.wrong()} wrong, longest silence {ms(silence_s)} ({ms(undisturbed_s)} before)"
    return Seen(text, lost > 0 and counted > 0 and not events(runtime, "HostLost"), silence_s < 0.1)


def slow_links(fleet: Fleet, short: bool) -> Seen:
    """0.5 MB at 0.6 Hz over 5 Mbit/s, 2 MB at 2 Hz and 10 MB at 0.4 Hz over 50: all arrive, others wait under 0.1 s."""
    from cfgplan.domain import ChangeSet

    texts, holds, is_in_time = [], True, True
    for label, (size, rate_hz, mbit_s) in list(SLOW_LINKS.items())[: 1 if short else None]:
        with stream(fleet, "r1", "base") as (runtime, listener):
            source = f"large{label}.1"
            runtime.apply(
                ChangeSet(started=(unit(source, "r1"), unit("same.2", "base", x=f"{source}/n", topic="/images")))
            )
            large = Listener(runtime.id, "/images", number=lambda one: int(one[0]))
            large.await_more(2)
            fleet.network.limit("r1", mbit_s)
            time.sleep(5.0)  # what was under way at the higher rate delays all else once
            start, before, span_s = time.monotonic(), len(large.values), 6.0 if short else 30.0
            time.sleep(span_s)
            came, silence_s = len(large.values) - before, listener.silence_s(start)
            fleet.network.unlimit("r1")
            wrong = listener.wrong() + images_lost(large.values)
            what = f"{size / 1e6:g} MB at {rate_hz:g} Hz over {mbit_s:g} Mbit/s"
            texts.append(f"{what}: {came} in {span_s:.0f} s, {wrong} wrong, another stream silent for {ms(silence_s)}")
            holds = holds and came >= int(rate_hz * span_s) - 2 and wrong == 0 and not events(runtime, "HostLost")
            is_in_time = is_in_time and silence_s < 0.1
    return Seen("; ".join(texts), holds, is_in_time)


def crowded_link(fleet: Fleet, short: bool) -> Seen:  # noqa: ARG001
    """2 MB at 2 Hz, 32 Mbit/s, over a 20 Mbit/s link: a run reports the overload, both rates, and the consequence."""
    from cfgplan_runtime.operating.crowded_links import CrowdedLinks
    from cfgplan_runtime.operating.flows import Flows

    from cfgplan.domain import ChangeSet

    with stream(fleet, "r1", "base") as (runtime, _):
        flows, links, told = Flows(), CrowdedLinks(), list[str]()
        runtime.listen(flows.hear)
        runtime.apply(ChangeSet(started=(unit("large2.1", "r1"), unit("same.2", "base", x="large2.1/n", topic="/big"))))
        Listener(runtime.id, "/big", number=lambda one: int(one[0])).await_more(2)
        fleet.network.limit("r1", 20.0)
        end_s = time.monotonic() + PATIENCE_S
        while not told and time.monotonic() < end_s:
            time.sleep(0.5)
            told += links.warnings(flows.crossings, time.monotonic())
        fleet.network.unlimit("r1")
        figures = [float(one) for one in re.findall(r"([\d.]+) Mbit/s", " ".join(told))]
        holds = len(figures) == 2 and figures[1] < figures[0] <= 40 and figures[1] <= 24
        is_exact = holds and figures[0] >= 24 and figures[1] >= 12
        hosts_lost = events(runtime, "HostLost")
    return Seen(told[0] if told else f"nothing was told in {PATIENCE_S:.0f} s", holds and not hosts_lost, is_exact)


def measured_rate(fleet: Fleet, short: bool) -> Seen:  # noqa: ARG001
    """32 Mbit/s of pictures over a link of 20 Mbit/s: the run measures the link, and compresses the pictures from then
    on.
    """
    from cfgplan_runtime import Manager
    from cfgplan_runtime.lifecycle.perturbations import LinkMeasured
    from cfgplan_runtime.lifecycle.reports import Perturbed, Report

    import cfgplan
    from cfgplan.domain import Environment, Host, InputPort, OutputPort, RunOptions, Target, Transformation

    size, rate_hz, _ = SLOW_LINKS["2"]
    raw = OutputPort("n", "Raw", rate_uhz=round(rate_hz * 1e6), size_bytes=size)
    packed = OutputPort("n", "Packed", rate_uhz=round(rate_hz * 1e6), size_bytes=size // 20)
    picture = OutputPort("n", "Picture")

    def made(label: str, host: str, upkeep_us: int, output: OutputPort, code: str, needs: str = "") -> Transformation:
        inputs, run = (InputPort("x", needs),) if needs else (), RunOptions(rate_hz=None if needs else rate_hz)
        more = {"params": {} if needs else {"size": size}, "source": f"measured_units.py:{code}", "host": host}
        return Transformation(label, inputs, (output,), 1000, upkeep_us, run=run, **more)

    library = (
        made("camera", "r1", 1000, raw, "large"),
        made("pack", "r1", 50_000, packed, "pack", "Raw"),
        made("unpack", "base", 50_000, picture, "unpack", "Packed"),
        made("plain", "base", 1000, picture, "same", "Raw"),
    )
    target = Target("pictures", "Picture", "/pictures", host="base")
    environment = Environment(library=library, targets=(target,), hosts=tuple(Host(name) for name in HOSTS))
    measured = list[LinkMeasured]()

    def note(report: Report) -> None:
        if isinstance(report, Perturbed) and isinstance(report.perturbation, LinkMeasured):
            measured.append(report.perturbation)

    with (
        fleet.runtime(is_empty=True) as runtime,
        Manager(cfgplan.world(environment, horizon_s=600), runtime, report=note) as manager,
    ):
        manager.settle()
        before = {unit.transformation for unit in runtime.environment.units}
        pictures = Listener(runtime.id, "/pictures", number=lambda one: int(one[0]))
        pictures.await_more(4)
        fleet.network.limit("r1", 20.0)
        took_s = eventually(lambda: "pack" in {unit.transformation for unit in runtime.environment.units})
        manager.settle()
        pictures.await_more(10)
        now = {unit.transformation for unit in runtime.environment.units}
        hosts_lost = events(runtime, "HostLost")
        fleet.network.unlimit("r1")
    rates = ", ".join(f"{(one.rate or 0) * 8 / 1e6:.0f}" for one in measured)
    text = f"after {took_s:.0f} s {', '.join(sorted(now))} run; {rates} Mbit/s measured"
    right = before == {"camera", "plain"} and now == {"camera", "pack", "unpack"}
    return Seen(text, right and not hosts_lost and all(0 < (one.rate or 0) * 8 / 1e6 <= 24 for one in measured[:1]))


def lossy_links(fleet: Fleet, short: bool) -> Seen:
    """20 % of all packets lost and 100 ms of delay, one way: no host is lost, no unit moves, and every lost element is
    counted; on an idle computer none is lost.
    """
    with managed(fleet) as (runtime, listener, moving), contextlib.ExitStack() as stack:
        stack.enter_context(fleet.network.lossy(0.2, 0.1))
        start_s, before = time.monotonic(), len(listener.values)
        time.sleep(15.0 if short else 60.0)
        came, silence_s = len(listener.values) - before, listener.silence_s(start_s)
        lost = [f"{event.host}: {event.cause}" for event in events(runtime, "HostLost")]
        stays = [unit.id for unit in runtime.environment.units if unit.transformation == "same"] == [moving.id]
        stack.close()
        listener.await_more(RATE_HZ)
        with contextlib.suppress(TimeoutError):  # the counts come later than the elements
            eventually(lambda: dropped_between_hosts(runtime) >= listener.wrong(), 10.0)
        dropped = dropped_between_hosts(runtime)
    text = f"{', '.join(lost) or 'no host lost'}, {'no' if stays else 'a'} unit moved; {came} elements, "
    text += f"{listener.wrong()} wrong, {dropped} told as dropped, longest silence {ms(silence_s)}"
    return Seen(text, not lost and stays and listener.wrong() <= dropped, listener.wrong() == 0)


def clocks(fleet: Fleet, short: bool) -> Seen:  # noqa: ARG001
    """A source moves between hosts whose clocks are 0.5 s ahead and behind: silence under 50 ms."""
    from cfgplan.domain import ChangeSet

    fleet.restart("r1", ahead_ns=500_000_000)
    fleet.restart("r2", ahead_ns=-500_000_000)
    silences = []
    with stream(fleet, "r1", "base") as (runtime, listener):
        for number, host in ((2, "r2"), (3, "r1")):
            listener.await_more(RATE_HZ // 2)
            start = time.monotonic()
            same = unit("same.1", "base", x=f"count.{number}/n", topic="/result")
            new = unit(f"count.{number}", host)
            runtime.apply(ChangeSet(started=(new,), rewired=(same,), stopped=(f"count.{number - 1}",)))
            listener.await_more(RATE_HZ // 2)
            silences.append(listener.silence_s(start))
        is_ordered = all(before < after for before, after in pairwise(list(listener.times_ns)))
    fleet.restart("r1")
    fleet.restart("r2")
    text = f"silence {ms(silences[0])} and {ms(silences[1])}, {'in' if is_ordered else 'out of'} order"
    return Seen(text, is_ordered, max(silences) < 0.05)


def source_in_cut(fleet: Fleet, short: bool) -> Seen:
    """A source is swapped in a cut of 2.5 s (lease 4 s): its last elements arrive, or are counted as lost."""
    from cfgplan.domain import ChangeSet

    span_s = 1.0 if short else 2.5
    with stream(fleet, "r1", "base") as (runtime, listener):
        beside = witness(fleet, runtime, "r1")
        runtime.apply(ChangeSet(started=(unit("same.2", "r1", x="count.1/n", topic="/witness"),)))
        beside.await_more()
        fleet.network.cut("r1")
        threading.Timer(span_s, fleet.network.mend, ["r1"]).start()
        time.sleep(span_s / 2)
        same = unit("same.1", "base", x="count.2/n", topic="/result")
        change = ChangeSet(started=(unit("count.2", "r2"),), rewired=(same,), stopped=("count.1", "same.2"))
        runtime.apply(change)
        eventually(lambda: any(after < before for before, after in pairwise(list(listener.values))))
        listener.await_more()
        values, times_ns = list(listener.values), list(listener.times_ns)
        # The second source begins anew with 0, which is 1 "wrong"; of it the first may have had no room.
        seam = next(index for index, (before, after) in enumerate(pairwise(values)) if after < before)
        unheard = values[seam + 1]
        given = sum(times_ns[seam] < at_ns < times_ns[seam + 1] for at_ns in list(beside.times_ns))
        lost = listener.wrong() - 1 + given
        with contextlib.suppress(TimeoutError):  # units tell their counts once a second
            eventually(lambda: dropped_by(runtime, "same.1") >= lost, 10.0)
        counted, hosts_lost = dropped_by(runtime, "same.1"), events(runtime, "HostLost")
    text = f"{lost} lost, {counted} counted, {unheard} of them the new source's; {len(hosts_lost)} hosts lost"
    return Seen(text, abs(lost - counted) <= unheard and not hosts_lost)


def source_ends_in_cut(fleet: Fleet, short: bool) -> Seen:
    """A source ends, and another one is killed, in a cut of 2.5 s (lease 4 s): their last elements arrive."""
    from cfgplan.domain import ChangeSet

    span_s, texts, are_whole = 1.0 if short else 2.5, [], True
    for label in ("some", "count"):
        with fleet.runtime() as runtime:
            listener, beside = Listener(runtime.id), witness(fleet, runtime, "r1")
            same = unit("same.1", "base", x=f"{label}.1/n", topic="/result")
            beside_it = unit("same.2", "r1", x=f"{label}.1/n", topic="/witness")
            runtime.apply(ChangeSet(started=(unit(f"{label}.1", "r1"), same, beside_it)))
            eventually(lambda runtime=runtime, label=label: runtime.pid(f"{label}.1") is not None)
            eventually(lambda listener=listener: bool(listener.values) and listener.values[-1] > SOME - RATE_HZ)
            fleet.network.cut("r1")
            if label == "some":
                eventually(lambda beside=beside: beside.values[-1] == SOME - 1)
            else:
                beside.await_more(RATE_HZ // 2)
                os.kill(runtime.pid("count.1"), 9)
            time.sleep(span_s / 2)
            fleet.network.mend("r1")
            # The kill may come after an element was put on the way to the witness and before it was for the other host.
            late = int(label == "count")
            with contextlib.suppress(TimeoutError):
                eventually(
                    lambda listener=listener, beside=beside, late=late: listener.values[-1] >= beside.values[-1] - late,
                    30.0,
                )
            texts.append(f"{label}: up to {listener.values[-1]} of {beside.values[-1]}, {listener.wrong()} wrong")
            are_whole = are_whole and listener.wrong() == 0 and listener.values[-1] >= beside.values[-1] - late
    return Seen("; ".join(texts), are_whole)


def load(fleet: Fleet, short: bool) -> Seen:
    """5 minutes in which other processes want all cores: no host is taken for lost."""
    span_s = 2.0 if short else 300.0
    burn = [sys.executable, "-c", "while True: pass"]
    with contextlib.ExitStack() as stack, stream(fleet, "r1", "r2") as (runtime, listener):
        for _ in range(2 * (os.cpu_count() or 1)):
            stack.callback(stack.enter_context(subprocess.Popen(burn)).kill)
        time.sleep(span_s)
        lost = events(runtime, "HostLost")
        text = f"{span_s:.0f} s, {len(lost)} hosts lost, {listener.wrong()} of {len(listener.values)} elements wrong"
        return Seen(f"{text}, longest silence {ms(listener.silence_s())}", not lost and listener.wrong() == 0)


def environment_file(fleet: Fleet, name: str = "", *, source: str, worker: str, targets: str = "") -> Path:
    """Write an environment file: numbers from a host through a worker on another host to a topic at the base.

    `[r1, r2]` allows either host; the target `other` needs r1.
    """
    path, code = fleet.folder / f"environment{name}.yaml", UNITS / "measured_units.py"
    path.write_text(f"""\
format: cfgplan/1
horizon: 600
hosts: [{{name: base}}, {{name: r1}}, {{name: r2}}]
transformations:
  - {{label: count, source: "{code}:count", host: {source}, run: {{rate: {RATE_HZ}}}, outputs: {{n: N}}}}
  - {{label: same, source: "{code}:same", host: {worker}, run: {{queue: {QUEUE}}}, inputs: {{x: N}}, outputs: {{n: Y}}}}
  - {{label: other, source: "{code}:count", host: r1, run: {{rate: {RATE_HZ}}}, outputs: {{n: Other}}}}
targets:
  - {{label: result, tag: Y, topic: /result, host: base}}
{targets}""")
    return path


def manager_killed(fleet: Fleet, short: bool) -> Seen:
    """A manager is killed and restarted on its host, on another, beside a living one: 0 lost, silence under 50 ms."""
    path, texts, silences = environment_file(fleet, source="r1", worker="r2"), [], list[float]()
    with contextlib.ExitStack() as stack:
        manager = stack.enter_context(fleet.manager("base", path))
        manager.await_review()
        ran = fleet.units("r1"), fleet.units("r2")
        listener = Listener(fleet.run_folder("base"))
        for name, host, is_killed in (("there", "base", True), ("on r1", "r1", True), ("beside it", "base", False)):
            listener.await_more(RATE_HZ // 2)
            start, old = time.monotonic(), manager
            if is_killed:
                old.process.kill()
            manager = stack.enter_context(fleet.manager(host, path))
            manager.await_review()
            took_s = time.monotonic() - start
            old.process.terminate()
            listener.await_more(RATE_HZ if short else 5 * RATE_HZ)
            silences.append(listener.silence_s(start))
            texts.append(f"{name} after {ms(took_s)}: silence {ms(silences[-1])}")
        wrong, runs_on = listener.wrong(), ran == (fleet.units("r1"), fleet.units("r2"))
        os.kill(fleet.units("r2")["same.1"], 9)
        eventually(lambda: fleet.units("r2").keys() == {"same.1"} and fleet.units("r2") != ran[1])
        listener.await_more()
    return Seen(f"{'; '.join(texts)}; {wrong} wrong", runs_on and wrong == 0, max(silences) < 0.05)


def partition(fleet: Fleet, short: bool) -> Seen:  # noqa: ARG001
    """A manager is cut off with one of three hosts: no run takes over there, another one does on the
    remaining hosts.
    """

    def path(name: str, targets: str = "") -> Path:
        return environment_file(fleet, name, source="base", worker="[r1, r2]", targets=targets)

    with contextlib.ExitStack() as stack:
        old = stack.enter_context(fleet.manager("r1", path("old")))
        old.await_review()
        listener = Listener(fleet.run_folder("base"))
        listener.await_more()
        fleet.network.cut("r1")
        smaller = stack.enter_context(fleet.manager("r1", path("smaller")))
        smaller.process.wait(PATIENCE_S)
        larger = stack.enter_context(fleet.manager("base", path("larger")))
        larger.await_review()
        listener.await_more()
        fleet.network.mend("r1")
        larger.await_text("host r1 is there")
        path("old", "  - {label: other, tag: Other, topic: /other, host: r1}\n")
        took_s = old.await_text("host r1 is gone: it obeys another manager")
        listener.await_more(RATE_HZ)
        units = sorted(unit.partition(".")[0] for host in HOSTS for unit in fleet.units(host))
    is_refused = "1 of 3 hosts can be reached" in smaller.said.read_text()
    text = f"the smaller part does {'not ' if is_refused else ''}take over; an old order is refused after {ms(took_s)}"
    return Seen(f"{text}; there are {', '.join(units)}", is_refused and units == ["count", "same"])


def storm(fleet: Fleet, short: bool) -> Seen:
    """200 perturbations, cut links and lost hosts: the final configuration costs as much as a fresh plan, without
    orphans.
    """
    happened, faults = faults_after(fleet, seed=0, perturbations=20 if short else 200)
    return Seen(f"{happened}: {'; '.join(faults) or 'as good as a fresh plan, no orphan'}", not faults)


def images_lost(values: Sequence[int]) -> int:
    """Return the number of missing images, by their numbers modulo 256."""
    return sum((after - before) % 256 - 1 for before, after in pairwise(list(values)))


def dropped_by(runtime: Any, name: str) -> int:
    """Return the number of elements that were dropped on their way to a unit."""
    return sum(one.dropped for one in runtime.observe() if one.unit == name)


def dropped_between_hosts(runtime: Any) -> int:
    """Return the number of elements that were dropped on their way to other hosts, to units and to topics."""
    told = events(runtime, "CrossingsStatus")
    return sum(counts.dropped for counts in told[-1].crossings.values()) if told else 0


def ms(seconds: float) -> str:
    return f"{1000 * seconds:.0f} ms"


CASES: dict[str, tuple[Callable[[Fleet, bool], Seen], float]] = {
    "swaps": (swaps, LEASE_S),
    "cut": (cut, LEASE_S),
    "swap in a cut": (swap_in_cut, LEASE_S),
    "old term": (old_term, LEASE_S),
    "manager killed": (manager_killed, LEASE_S),
    "partition": (partition, LEASE_S),
    "unit killed": (unit_killed, LEASE_S),
    "overload": (overload, LEASE_S),
    "slow links": (slow_links, LEASE_S),
    "crowded link": (crowded_link, LEASE_S),
    "measured rate": (measured_rate, LEASE_S),
    "lossy links": (lossy_links, LEASE_S),
    "agent killed": (agent_killed, LEASE_S),
    "clocks": (clocks, LEASE_S),
    "load": (load, LEASE_S),
    "storm": (storm, LEASE_S),
    "host returns": (returning, 1.0),
    "cut for good": (cut_for_good, 1.0),
    "source swapped in a cut": (source_in_cut, 4.0),
    "source ends in a cut": (source_ends_in_cut, 4.0),
    "swap in a long cut": (swap_in_cut, 4.0),
}
"""Each case, and the lease it is played with."""
LOSING = (agent_killed, partition, storm, returning, cut_for_good)
"""Cases whose lost hosts are noticed after a lease."""


def played(network: Network, names: Sequence[str], short: bool) -> bool:
    """Run cases on a network, from within it. Returns whether all passed."""
    from cfgplan_runtime.fleet.certificates import make

    from cfgplan.errors import CfgplanError

    all_hold = True
    with tempfile.TemporaryDirectory(prefix="fleet") as folder, contextlib.ExitStack() as stack:
        os.environ["XDG_RUNTIME_DIR"] = folder
        secrets = Path(folder) / "secrets"
        make(secrets, {host: [network.address[host]] for host in HOSTS}, days=1)
        fleet: Fleet | None = None
        for name in names:
            case, lease_s = CASES[name]
            if short and case not in LOSING:
                lease_s = PATIENT_LEASE_S
            if fleet is None or fleet.lease_s != lease_s:
                stack.close()
                fleet = stack.enter_context(Fleet(network, secrets, lease_s=lease_s))
            try:
                seen = case(fleet, short)
            except (TimeoutError, CfgplanError) as error:
                seen = Seen(str(error), is_right=False)
            word = "FAILS" if not seen.is_right else "holds" if seen.is_in_time else "late "
            all_hold = all_hold and seen.is_right and (short or seen.is_in_time)
            print(f"{word}  {name}: {seen.text}", flush=True)
            fleet.restart()
    return all_hold


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--case", action="append", choices=CASES, help="this one only (several: once for each)")
    parser.add_argument("--short", action="store_true", help="few swaps, short cuts")
    parser.add_argument("--within", help=argparse.SUPPRESS)
    options = parser.parse_args()
    return run_within(
        HOSTS, options.within, lambda network: played(network, options.case or list(CASES), options.short)
    )


if __name__ == "__main__":
    sys.exit(main())
