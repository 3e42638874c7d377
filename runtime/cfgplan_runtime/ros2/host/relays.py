"""Leads topics that nodes publish to those that they listen to, from one source after the other, as wires say.

Each input of a node listens to a topic of its own, on which only the helper publishes, and no node notices a switch.
"""

from __future__ import annotations

import time
from typing import Any

from cfgplan_runtime.nodes.observed_outputs import ObservedOutputs
from cfgplan_runtime.nodes.passed_taps import PassedTaps
from cfgplan_runtime.ros2.host.actions import GOAL_TYPE, SEND_GOAL, LedAction
from cfgplan_runtime.ros2.host.endpoints import Publication, Sample, Source, UnknownTypeError, message_class
from cfgplan_runtime.ros2.host.host import NAMELESS, Host
from cfgplan_runtime.ros2.host.outside import OutsideTopics
from cfgplan_runtime.ros2.host.qos import Quality, mended
from cfgplan_runtime.ros2.host.services import LedService
from cfgplan_runtime.streams.element import BEFORE_ALL, Element, Moment
from cfgplan_runtime.streams.inlet import InputQueue
from cfgplan_runtime.streams.meter import Meter

SIGN_S = 1.0
"""Seconds from one sign of life to the next."""
_SAME_CLOCK_S = 60.0
"""A stamp that is further from now is of another clock, and tells no age."""


class LedInlet:
    """An inlet with the topic on which its messages are published; `reported` is the last wire reported as its source.

    The moment of a message is decided once for the inlet: its own stamp, if the first messages of all sources have
    one, else when it was sent. `by_stamp` is None until the first message.
    """

    def __init__(self, unit: str, name: str, publication: Publication, limit: int) -> None:
        self.unit, self.name, self.publication = unit, name, publication
        self.queue = InputQueue(limit)
        self.reported: int | None = None
        self.elements = 0
        self._by_stamp: bool | None = None
        self._last: Sample | None = None

    def accept(self, wire: int, number: int, sample: Sample) -> list[Sample]:
        """Take a message from a wire. Returns the messages to hand on now.

        A latched topic is a state, not a stream: the first message of a new source counts, whatever its stamp.
        """
        if sample.source.quality.is_latched:
            time_ns, turn = self.queue.last[0], self.queue.last[1] + 1
            elements = self.queue.accept(wire, Element(time_ns, turn, number, sample))  # type: ignore[arg-type]
            if wire == self.queue.standby:
                elements += self.queue.switch()
            return self._handed_on(elements)
        self._decide(wire, sample)
        if sample.begins_anew and self._by_stamp and wire == self.queue.active:
            self.queue.last = BEFORE_ALL
        time_ns, turn = sample.stamped if self._by_stamp else sample.timed
        element = Element(time_ns, turn, number, sample)  # type: ignore[arg-type]
        return self._handed_on(self.queue.accept(wire, element))

    def switch(self) -> list[Sample]:
        """Switch to the standby without waiting for the present source."""
        now: Moment = (self.queue.last[0], self.queue.last[1] + 1) if self._by_stamp else (time.time_ns(), 0)
        return self._handed_on(self.queue.switch(now))

    def end(self, wire: int) -> list[Sample]:
        """Take a wire away."""
        return self._handed_on(self.queue.end(wire))

    def _decide(self, wire: int, sample: Sample) -> None:
        if self._by_stamp is None:
            self._by_stamp = sample.has_stamp
        elif self._by_stamp and not sample.has_stamp and wire in (self.queue.active, self.queue.standby):
            self._by_stamp = False
            self.queue.last = BEFORE_ALL if self._last is None else self._last.timed

    def _handed_on(self, elements: list[Element]) -> list[Sample]:
        samples: list[Sample] = [element.payload for element in elements]  # type: ignore[misc]
        if samples:
            self._last = samples[-1]
        return samples


class Relays:
    """All wires of a run. `remembered` are the qualities of service of ports, by transformation and port."""

    def __init__(self, host: Host) -> None:
        self._host = host
        self._sources: dict[str, Source] = {}
        self._wires: dict[int, tuple[Source, LedInlet]] = {}
        self._inlets: dict[str, LedInlet] = {}
        self._publications: dict[str, Publication] = {}
        self._meters: dict[str, Meter] = {}
        self._services: dict[str, LedService | LedAction] = {}
        """Services and actions by the name that callers know."""
        self._service_of: dict[int, dict[str, Any]] = {}
        """The orders of wires that lead services."""
        self._waiting_services: dict[int, dict[str, Any]] = {}
        """Orders to lead services that nobody offers yet, by wire."""
        self.outside = OutsideTopics(host, self)
        self._observed = ObservedOutputs(lambda unit, text: host.say("Unsaid", unit=unit, text=text), is_aligned=True)
        self._taps = PassedTaps()
        self._remembered: dict[str, Quality] = {}
        self._refused: set[tuple[str, str]] = set()
        host.handlers.update(
            Lead=self._lead,
            Cut=lambda order: self._end(order["wire"], drains=False),
            End=lambda order: self._end(order["wire"], drains=True),
            SwitchNow=self._switch_now,
            OpenOutlet=lambda order: self._meters.update({order["topic"]: Meter(time.monotonic())}),
            CloseOutlet=self._close_outlet,
            CloseInlets=self._close_inlets,
            Observe=self._observe,
            Tap=self._tap,
            Untap=self._untap,
        )
        host.waiting.later(SIGN_S, self._sign)

    # For those who attend nodes.

    def hold_source(self, unit: str, topic: str, key: str, kind: str | None) -> Source:
        """Listen to a topic that a unit is about to publish on, until `let_go`."""
        source = self._source(topic, key, kind)
        source.holders.add(unit)
        self._look_at(source)
        return source

    def hold_publication(self, unit: str, topic: str, key: str, kind: str | None, queue: int) -> Publication:
        """Publish on a topic that a unit is about to listen to, until its inlets are closed."""
        publication = self._publication(topic, is_own=True)
        publication.depth = queue
        publication.key, publication.kind = key, publication.kind or kind or ""
        publication.holders.add(unit)
        self._look_at(publication)
        return publication

    def let_go(self, unit: str, topic: str) -> None:
        """Undo `hold_source` for a unit: the topic is still listened to if something else needs it."""
        source = self._sources.get(topic)
        if source is not None:
            source.holders.discard(unit)
            self._drop_unused(source)

    def is_led(self, topic: str) -> bool:
        """Whether wires lead to a topic, or a target has it."""
        return topic in self._publications or topic in self._meters

    def rename_holder(self, old: str, new: str) -> None:
        """Note that the spare `old` is the unit `new` from now on."""
        self.outside.rename(old, new)
        ends: list[Source | Publication] = [*self._sources.values(), *self._publications.values()]
        for end in ends:
            if old in end.holders:
                end.holders = end.holders - {old} | {new}

    def look(self) -> None:
        """Look for publishers and subscriptions on all topics, and open endpoints whose types are known now."""
        ends: list[Source | Publication] = [*self._sources.values(), *self._publications.values()]
        for end in ends:
            self._look_at(end)
        for inlet in list(self._inlets.values()):
            self._tell_switch(inlet)
        self.outside.look()
        waiting, self._waiting_services = self._waiting_services, {}
        for order in waiting.values():
            self._lead_service(order)

    # The run calls these.

    def _lead_service(self, order: dict[str, Any]) -> None:
        """Have calls of a service, or goals of an action, answered by another one, once its type is known."""
        found = dict(self._host.node.get_service_names_and_types())
        source, target = order["source"], order["target"]
        kind = next(iter(found.get(source, ())), None)
        goal = next(iter(found.get(source + SEND_GOAL, ())), None)
        if kind is None and goal is None:
            self._waiting_services[order["wire"]] = order
            return
        try:
            led = self._services.get(target)
            if led is None and kind is not None:
                led = LedService(self._host, target, message_class(kind))
            elif led is None and goal is not None:
                led = LedAction(self._host, target, message_class(goal.removesuffix(GOAL_TYPE)))
        except UnknownTypeError as error:
            self._refuse(order["target"], str(error))
            return
        assert led is not None
        self._services[target] = led
        led.lead(source)
        self._service_of[order["wire"]] = order
        self._host.say("Switched", port=order["inlet"], wire=order["wire"])

    def _end_service(self, wire: int, *, drains: bool) -> None:
        self._waiting_services.pop(wire, None)
        order = self._service_of.pop(wire, None)
        if order is not None and drains and self._services[order["target"]].source == order["source"]:
            self._host.say("Lost", port=order["inlet"], wire=wire)

    def _close_services(self, unit: str) -> None:
        for wire, order in list(self._service_of.items()):
            if order["unit"] == unit:
                del self._service_of[wire]
                led = self._services.pop(order["target"], None)
                if led is not None:
                    led.close()

    def _lead(self, order: dict[str, Any]) -> None:
        if order["is_service"]:
            self._lead_service(order)
            return
        if order["inlet"] not in self._inlets:
            publication = self._publication(order["target"], is_own=False)
            publication.holders.add(order["inlet"])
            publication.depth = max(publication.depth, order["queue"])
            inlet = LedInlet(order["unit"], order["inlet"], publication, order["queue"])
            self._inlets[order["inlet"]] = inlet
        inlet = self._inlets[order["inlet"]]
        source = self._source(order["source"], order["source"], order["message"])
        self._wires[order["wire"]] = source, inlet
        source.offered[order["wire"]] = 0
        inlet.queue.attach(order["wire"])
        self._look_at(source)
        self._tell_switch(inlet)
        if source.latched is not None:
            self._offer(order["wire"], source.latched)

    def _end(self, wire: int, *, drains: bool) -> None:
        if wire not in self._wires:
            self._end_service(wire, drains=drains)
            return
        source, inlet = self._wires[wire]
        if drains:
            source.take()
        del self._wires[wire], source.offered[wire]
        was_active = wire == inlet.queue.active
        self._hand_on(inlet, inlet.end(wire))
        if was_active and inlet.queue.active is None and drains:
            inlet.reported = None
            self._host.say("Lost", port=inlet.name, wire=wire)
        self._drop_unused(source)

    def _observe(self, order: dict[str, Any]) -> None:
        """Read from now on what an output's messages say of its quality."""
        self._observed.observe(order["unit"], order["port"], order["topic"], order["fields"])
        self._look_at(self._source(order["topic"], order["topic"], None))

    def _tap(self, order: dict[str, Any]) -> None:
        """Pass on messages of a source to the run, the last one of a latched topic at once."""
        source = self._source(order["source"], order["source"], order["message"])
        self._taps.open(order["topic"], order["source"])
        self._look_at(source)
        if source.latched is not None:
            self._pass_on(source.latched)

    def _untap(self, order: dict[str, Any]) -> None:
        source = self._taps.close(order["topic"])
        if source in self._sources:
            self._drop_unused(self._sources[source])

    def _pass_on(self, sample: Sample) -> None:
        """Show a message to those who look."""
        time_ns = time.time_ns() - round(_age_s(sample) * 1e9)
        source = sample.source
        for topic, skipped in self._taps.due(source.topic, time.monotonic()):
            self._host.say("Tapped", sample.raw, topic=topic, message=source.kind, time_ns=time_ns, skipped=skipped)

    def _switch_now(self, order: dict[str, Any]) -> None:
        inlet = self._inlets.get(order["port"])
        if inlet is not None:
            self._hand_on(inlet, inlet.switch())

    def _close_outlet(self, order: dict[str, Any]) -> None:
        self._meters.pop(order["topic"], None)
        self._close_inlet(order["topic"])

    def _close_inlets(self, order: dict[str, Any]) -> None:
        self.outside.remove(order["unit"])
        for topic in self._observed.forget(order["unit"]):
            if topic in self._sources:
                self._drop_unused(self._sources[topic])
        self._close_services(order["unit"])
        for name in [name for name, inlet in self._inlets.items() if inlet.unit == order["unit"]]:
            self._close_inlet(name)
        for publication in list(self._publications.values()):
            self._release(publication, order["unit"])
        for source in list(self._sources.values()):
            self.let_go(order["unit"], source.topic)

    def _close_inlet(self, name: str) -> None:
        inlet = self._inlets.pop(name, None)
        if inlet is None:
            return
        for wire in [wire for wire, (_, to) in self._wires.items() if to is inlet]:
            source, _ = self._wires.pop(wire)
            del source.offered[wire]
            self._drop_unused(source)
        self._release(inlet.publication, name)

    # Ends of topics.

    def _source(self, topic: str, key: str, kind: str | None) -> Source:
        if topic not in self._sources:
            self._sources[topic] = Source(self._host, topic, self._remembered, self._take)
            self._sources[topic].key = key
        source = self._sources[topic]
        source.kind = source.kind or kind or ""
        return source

    def _publication(self, topic: str, *, is_own: bool) -> Publication:
        if topic not in self._publications:
            self._publications[topic] = Publication(self._host, topic, self._remembered, is_own=is_own)
        return self._publications[topic]

    def _look_at(self, end: Source | Publication) -> None:
        try:
            end.look()
        except UnknownTypeError as error:
            self._refuse(end.topic, str(error))

    def _release(self, publication: Publication, holder: str) -> None:
        publication.holders.discard(holder)
        if not publication.holders and self._publications.pop(publication.topic, None) is publication:
            publication.close()

    def _drop_unused(self, source: Source) -> None:
        is_used = source.offered or source.holders or source.topic in self._observed or source.topic in self._taps
        if not is_used and self._sources.pop(source.topic, None) is source:
            source.close()

    # Nodes' messages come here.

    def _take(self, sample: Sample) -> None:
        self.outside.pass_on(sample)
        if sample.source.topic in self._observed:
            self._observed.note(sample.source.topic, _age_s(sample))
            try:
                self._observed.take(sample.source.topic, sample.raw, sample.source.layout)
            except UnknownTypeError as error:
                self._refuse(sample.source.topic, str(error))
        if sample.source.topic in self._taps:
            self._pass_on(sample)
        for wire in list(sample.source.offered):
            self._offer(wire, sample)

    def _offer(self, wire: int, sample: Sample) -> None:
        source, inlet = self._wires[wire]
        number = source.offered[wire]
        source.offered[wire] = number + 1
        self._hand_on(inlet, inlet.accept(wire, number, sample))

    def _hand_on(self, inlet: LedInlet, samples: list[Sample]) -> None:
        self._tell_switch(inlet)
        meter = None if inlet.unit else self._meters.get(inlet.name)
        for sample in samples:
            inlet.elements += 1
            if sample.source.topic != inlet.publication.topic:  # else it has come there by itself
                inlet.publication.publish(sample.raw)
            if meter is not None:
                meter.note(_age_s(sample), time.monotonic())

    def _tell_switch(self, inlet: LedInlet) -> None:
        """Report that an inlet has switched to another wire, once the type of that is known."""
        active = inlet.queue.active
        if active is None or active == inlet.reported:
            return
        source, _ = self._wires[active]
        publication = inlet.publication
        if not source.is_open:
            return
        inlet.reported = active
        if source.topic != publication.topic:
            publication.kind, publication.is_latched = source.kind, source.quality.is_latched
            try:
                publication.look(turns=True)
            except UnknownTypeError as error:
                self._refuse(publication.topic, str(error))
        self._host.say("Switched", port=inlet.name, wire=active)
        self._tell_of_ends(source, publication)

    def _tell_of_ends(self, source: Source, publication: Publication) -> None:
        """Tell what the relay makes good between two topics, and whose types differ.

        An endpoint is found before its node's name is. The next sign tells of it.
        """
        if not publication.ends or any(one.node_name == NAMELESS for one in publication.ends):
            return
        for one in publication.ends:
            if one.topic_type != publication.kind:
                wants = f"{one.node_name} expects {one.topic_type}, but the topic has {publication.kind}"
                self._refuse(publication.topic, wants)
        for words in mended(source.ends, publication.ends):
            listener = publication.ends[0].node_name
            text = f"{listener} {words}: {source.topic} does not fit it, and reaches it only by the run's relay"
            self._refuse(publication.topic, text)

    def _refuse(self, topic: str, cause: str) -> None:
        if (topic, cause) not in self._refused:
            self._refused.add((topic, cause))
            self._host.say("Refused", topic=topic, cause=cause)

    # Reports to the run.

    def _sign(self) -> None:
        self._host.waiting.later(SIGN_S, self._sign)
        self.look()
        for inlet in self._inlets.values():
            if inlet.reported is not None and inlet.reported in self._wires:
                self._tell_of_ends(self._wires[inlet.reported][0], inlet.publication)
        now_s = time.monotonic()
        self._host.say(
            "Passed",
            sources={source.topic: source.messages for source in self._sources.values()},
            inlets={
                inlet.name: {
                    "elements": inlet.elements,
                    "dropped": inlet.queue.dropped,
                    "stale": inlet.queue.stale,
                }
                for inlet in self._inlets.values()
            },
            flows={
                topic: meter.figures(self._inlets[topic].queue.dropped if topic in self._inlets else 0, now_s)
                for topic, meter in self._meters.items()
            },
            qualities=self._observed.taken(),
        )


def _age_s(sample: Sample) -> float:
    """How old a message is: since its stamp, if that is of this clock, else since it was sent."""
    now_ns = time.time_ns()
    stamped_s = (now_ns - sample.stamped[0]) / 1e9
    return stamped_s if sample.has_stamp and abs(stamped_s) < _SAME_CLOCK_S else (now_ns - sample.timed[0]) / 1e9
