"""The process of one unit: waits, takes steps of the unit code, sends the results; rewires between two steps."""

from __future__ import annotations

import socket
import time
from collections.abc import Iterator
from pathlib import Path

import msgspec

from cfgplan.rows import ALL
from cfgplan_runtime.children import messages
from cfgplan_runtime.children.control import ControlConnection
from cfgplan_runtime.children.failures import Failures
from cfgplan_runtime.children.handover import Handover
from cfgplan_runtime.children.ports import Ports, UnitInput, UnitOutput
from cfgplan_runtime.children.program import ProgramCode
from cfgplan_runtime.children.program_source import names_program
from cfgplan_runtime.children.steps import Step, StepQueue
from cfgplan_runtime.children.unit_code import Given, UnitCode, imported_files
from cfgplan_runtime.children.unit_order import SIGN_NS
from cfgplan_runtime.errors import ProgramEndedError, ProgramFaultError
from cfgplan_runtime.streams.element import Element, Moment, Outgoing
from cfgplan_runtime.streams.inlet import InputQueue, port_of
from cfgplan_runtime.streams.payload import PayloadEncoder, decode
from cfgplan_runtime.streams.said_qualities import SaidQualities

_LONGEST_WORK_NS = 1_000_000
"""Nanoseconds of back-to-back steps after which sockets are looked at again."""
_BLOCKED_NS = 500_000_000
_SLOW_NS = 100_000_000
"""A source whose last call took so long tells its counts before the next one, during which it can tell nothing."""
_NEVER_NS = 1 << 63
"""A time that never comes."""
_LATEST_TICK_NS = 100_000_000
"""A source that is later than this skips ticks instead of catching up."""


def _value(element: Element) -> object:
    return decode(element.payload)


class UnitChild:
    """One unit. Constructing it constructs the unit code, and raises whatever that raises."""

    def __init__(
        self, order: messages.UnitOrder, control: ControlConnection[messages.ToChild], *, is_spare: bool = False
    ) -> None:
        self._order = order
        self._ports = Ports(control, self._obey, self._one_more_input, order.clock_offset_ns)
        self._is_source = not order.inputs
        self._steps = StepQueue(
            order.inputs,
            start=order.start,
            tolerance_ns=order.tolerance_ns,
            limit=order.queue,
            optional=order.optional,
            services=order.services,
            counts=order.counts,
        )
        self._handover = Handover(self._steps, self._ports, order.queue)
        self._errors = 0
        self._failures = Failures()
        self._program_faults = set[str]()
        """The kinds of faults of a program that were told."""
        self.step = 0
        """How many steps have begun."""
        self._moment: Moment | None = None
        self._begun: str | None = None if is_spare else order.unit
        self._program: ProgramCode | None = None
        self._code: UnitCode | None
        self._stateful: UnitCode | None = None
        """The unit code whose state is kept."""
        if names_program(order.source):
            self._program = ProgramCode(order, self._fail)
            self._code = None
        else:
            self._code = code = UnitCode(
                order.source, order.params, order.outputs, folder=order.folder, is_source=self._is_source
            )
            self._stateful = code if order.state_name is not None and code.has_state else None
        self._set_state(order.state)
        for inlet in self._steps.inlets:
            self._ports.inputs[inlet] = self._input_port(inlet)
        for port in order.outputs:
            self._ports.outputs[port] = UnitOutput()
        self._encoder = PayloadEncoder()
        self._qualities = SaidQualities(order.qualities)
        self._last: dict[str, Moment] = {}
        self._results: Iterator[Given] | None = None
        self._next_step: Step | None = None
        self._is_active = False
        """Whether all its streams are connected. Before, elements that it gives would be lost, and its state is older
        than that of the unit that it replaces.
        """
        self._is_exhausted = self._is_finishing = self._is_interrupted = self._is_closing = False
        self._since_ns = _NEVER_NS
        """When the present call of unit code began; _NEVER_NS while it is not called."""
        self._raised: Exception | None = None
        """The last exception of a source that has given nothing since; the cause if the source then ends."""
        self._tick_ns = 0
        self._said_elements = 0
        """The elements that its outputs had given by the last sign of life."""
        self._is_slow = False
        """Whether the last call of a source's code took long."""
        self._may_rest = False
        """Whether a source pauses, so that this unit may pause too, and its subscribers do not know it yet."""
        self._is_idle = False
        """Whether nothing has come and nothing was due since the last sign of life."""

    def await_beginning(self) -> str | None:
        """Wait, as a spare, until told to be a unit. Returns its id; None if the supervisor is gone."""
        files = imported_files(Path(self._order.folder)) | (self._program.files() if self._program else {})
        self._ports.say(messages.Prepared(self._cpu_ns(), files))
        while self._begun is None and not self._ports.has_ended:
            self._watch_program()
            self._ports.ends.wait(None)
            if self._program is not None and self._begun is None:
                self._program.replies.clear()
        return self._begun

    def run(self) -> None:
        """Work from `Activate` on, until told to finish or until the supervisor is gone.

        Raises SystemExit if unit code does, and the last exception of a source that gives nothing after it.
        """
        self._ports.say(messages.Ready(self._cpu_ns()))
        self._said_ns = self._status_ns = time.monotonic_ns()
        try:
            self._go_on()
        except SystemExit:
            if not self._is_interrupted:
                raise
            self._close_code()
            self._say_status()
        finally:
            self._tell_repeats(is_last=True)

    def close(self) -> None:
        """Close the sockets of its ports. A child needs no call of it, since its process ends."""
        self._ports.close()

    @property
    def debt(self) -> str:
        """A sentence about what a unit of a program waits for."""
        return self._program.debt if self._program else ""

    def interrupt(self) -> None:
        """Leave unit code that blocks. Called by a signal's handler once the unit was told to finish.

        Code that goes from step to step is not interrupted: it processes the elements that have arrived.
        """
        silent_ns = self._program.silent_ns() if self._program else time.monotonic_ns() - self._since_ns
        if self._is_closing and self._program is not None:
            self._program.interrupt()
        elif not self._is_interrupted and silent_ns > _BLOCKED_NS:
            self._is_interrupted = True
            raise SystemExit(0)

    def _go_on(self) -> None:
        while not self._ports.has_ended:
            self._watch_program()
            self._ports.ends.wait(self._patience_s())
            if time.monotonic_ns() < self._status_ns:  # something has come or is due, and will be counted soon
                self._is_idle = False
                self._status_ns = min(self._status_ns, self._said_ns + SIGN_NS)
            if time.monotonic_ns() >= self._status_ns:
                self._give_sign()
            self._work()
            if self._is_finishing and not self._has_work and self._ports.is_flushed:
                self._close_code()
                self._say_status()
                return

    def _cpu_ns(self) -> int:
        return time.process_time_ns() + (self._program.cpu_ns() if self._program else 0)

    def _watch_program(self) -> None:
        """Watch the ends of a program: read its output while no result waits, write while messages wait.

        Raises ProgramEndedError if it has ended unasked.
        """
        program = self._program
        if program is None:
            return
        ends = self._ports.ends
        if program.is_heard and not (self._is_finishing and program.sets_its_pace):
            ends.watch(program.end, program.hear)
        else:
            ends.unwatch(program.end)
        if program.is_sending:
            ends.watch(program.input, program.flush, to_write=True)
        else:
            ends.unwatch(program.input)
        if not self._is_exhausted and self._results is None and program.has_ended() and self._begun is not None:
            self._exhaust()

    def _close_code(self) -> None:
        self._since_ns, self._is_closing = _NEVER_NS, True
        if self._program is not None:
            self._ports.ends.unwatch(self._program.end)
            self._ports.ends.unwatch(self._program.input)
        code = self._program or self._code
        assert code is not None
        try:
            code.close()
        except Exception as error:
            self._fail(error)

    def _obey(self, message: messages.ToChild, _: list[socket.socket]) -> None:
        match message:
            case messages.BeginUnit(unit, state):
                self._set_state(state)
                self._begun = unit
            case messages.Activate():
                self._is_active, self._tick_ns = True, time.monotonic_ns()
            case messages.Deactivate():
                self._is_active = False
            case messages.HoldSteps():
                self._handover.hold()
                # A source may be at a step, and elements may wait in a unit that an undone update has kept: both belong
                # to the state before.
                self._results = self._next_step = None
                self._steps.clear()
            case messages.TellPlaces(inlets):
                self._handover.ask_places(inlets)
            case messages.TellState(until):
                self._handover.ask_state(until)
            case messages.TakeState(state, inputs, outputs) if self._handover.is_waiting:
                self._set_state(state)
                self._handover.begin(inputs)
                self._last.update(outputs)
            case messages.TakeState():
                self._handover.stay()
            case messages.Finish():
                self._ports.drain()
                self._is_finishing = True

    @property
    def _may_give(self) -> bool:
        return self._is_active or self._is_finishing

    @property
    def _has_work(self) -> bool:
        """Whether a step is under way or waits."""
        return self._results is not None or self._has_replies or self._owes or self._pending is not None

    @property
    def _has_results(self) -> bool:
        return self._may_give and self._results is not None

    @property
    def _has_replies(self) -> bool:
        return self._may_give and self._program is not None and bool(self._program.replies)

    @property
    def _owes(self) -> bool:
        return self._program is not None and self._program.owes

    @property
    def _sets_its_pace(self) -> bool:
        return self._program is not None and self._program.sets_its_pace

    @property
    def _has_room(self) -> bool:
        """Whether one more step may begin."""
        return self._program is None or self._program.has_room

    @property
    def _pending(self) -> Step | None:
        may = self._may_give and not self._is_source and not self._handover.is_still
        if self._next_step is None and may:
            self._handover.refill()
            self._next_step = self._steps.next()
        return self._next_step

    @property
    def _may_tick(self) -> bool:
        may = self._is_active and self._is_source and not self._is_exhausted and not self._is_finishing
        return may and self._has_room and not self._handover.is_still

    def _patience_s(self) -> float:
        now = time.monotonic_ns()
        until = self._status_ns
        if not self._ports.must_wait:
            if self._has_results or self._has_replies or (self._has_room and self._pending is not None):
                return 0.0
            if self._may_tick:
                until = min(until, self._tick_ns)
        return max(0.0, (until - now) / 1e9)

    def _work(self) -> None:
        start = time.monotonic_ns()
        while not self._ports.must_wait and (now := time.monotonic_ns()) - start < _LONGEST_WORK_NS:
            self._since_ns = now
            self._answer()
            if self._has_results:
                self._give_next()
            elif self._program is not None and self._has_replies:
                self.step += self._program.sets_its_pace
                self._moment, self._results = self._program.replies.popleft()
                self._give_next()
            elif self._has_room and self._pending is not None:
                self._begin(self._pending)
            elif self._may_tick:
                if not self._tick():
                    break
            else:
                break
        self._answer()
        if self._may_rest:
            self._rest()
        self._since_ns = _NEVER_NS
        if self._program is not None:
            self._program.flush()
        self._ports.resume()

    def _answer(self) -> None:
        """Answer the questions of a hand-over whose answers are known by now."""
        places = self._handover.places()
        if places is not None:
            self._ports.say(messages.Places(places))
        if self._handover.is_state_due and self._results is None and self._next_step is None:
            self._handover.tell(None if self._program is not None else self._state() or b"", self._last)

    def _rest(self) -> None:
        """Tell the subscribers of a pause once no step can begin before a source that pauses gives an element."""
        inlets = {name: port.inlet for name, port in self._ports.inputs.items()}
        self._may_rest = any(inlet.is_paused for inlet in inlets.values())
        still = [name for name, inlet in inlets.items() if inlet.is_paused or inlet.active is None]
        is_at_work = self._has_work or self._handover.is_keeping or self._sets_its_pace
        if self._may_rest and not is_at_work and self._steps.rests_on(still):
            self._may_rest = False
            for name in self._ports.outputs:
                self._ports.pause(name)

    def _begin(self, step: Step) -> None:
        self._next_step = None
        self.step += 1
        try:
            values: dict[str, object] = dict.fromkeys(self._order.inputs)
            for port, found in step.elements.items():
                values[port] = list(map(_value, found)) if isinstance(found, list) else _value(found)
            if self._program is not None:
                self._program.ask(values, step.moment[0], step.moment)
                return
            assert self._code is not None
            self._moment = step.moment
            self._results = self._code.step(values)
            self._give_next()
        except Exception as error:
            self._fail(error)

    def _tick(self) -> bool:
        """Let a source produce if it is due. Returns whether it was."""
        now = time.monotonic_ns()
        if now < self._tick_ns:
            return False
        period = self._order.period_ns
        if period is not None:
            self._tick_ns += period
            if now - self._tick_ns > _LATEST_TICK_NS:
                self._tick_ns = now
        self.step += 1
        if self._program is not None:
            self._program.ask({}, self._ports.now_ns(), None)
            return True
        assert self._code is not None
        self._moment = None
        if (self._is_slow or not self._said_elements) and self._given_elements > self._said_elements:
            self._say_status()
        try:
            self._results = self._code.produce()
            self._is_slow = time.monotonic_ns() - now > _SLOW_NS
            self._raised = None
        except StopIteration:
            if self._raised is not None:
                raise self._raised from None
            self._exhaust()
        except Exception as error:
            if self._code.can_not_go_on:
                raise
            self._raised = error
            self._fail(error)
        return True

    @property
    def _given_elements(self) -> int:
        return sum(output.elements for output in self._ports.outputs.values())

    def _exhaust(self) -> None:
        self._is_exhausted = True
        self._ports.say(messages.Exhausted())

    def _give_next(self) -> None:
        assert self._results is not None
        try:
            given = next(self._results, None)
            if given is None:
                self._results = None
                return
            time_ns, turn = self._moment_of(given)
            self._ports.emit(given.port, Outgoing(time_ns, turn, self._encoder.encode(given.value)))
            self._qualities.note(given.port, (self._ports.now_ns() - time_ns) / 1e9)
            for fault in self._qualities.take(given.port, given.value, given.quality):
                self._ports.say(messages.Trouble("no quality", self.step, fault))
        except Exception as error:
            self._results = None
            self._fail(error)

    def _moment_of(self, given: Given) -> Moment:
        """Return a result's moment. Moments rise along a stream: at equal times, later elements get later turns."""
        if given.time_ns is not None:
            moment = (given.time_ns, 0)
        elif self._moment is not None:
            moment = self._moment
        else:
            moment = (self._ports.now_ns(), 0)
        last = self._last.get(given.port)
        if last is not None and moment <= last:
            moment = (last[0], last[1] + 1)
        self._last[given.port] = moment
        return moment

    def _fail(self, error: Exception) -> None:
        """Count and report a failure. Raises the error if unit code can't go on after it."""
        if isinstance(error, ProgramEndedError):
            raise error
        self._errors += 1
        if isinstance(error, ProgramFaultError):
            if error.what not in self._program_faults:
                self._program_faults.add(error.what)
                self._ports.say(messages.Trouble(error.what, self.step, str(error)))
            return
        trouble = self._failures.take(error, self.step, time.monotonic_ns())
        if trouble is not None:
            self._ports.say(trouble)

    def _give_sign(self) -> None:
        """Give a sign of life, unless a program is silent though it has been asked."""
        if self._program is not None and self._program.silent_ns() > SIGN_NS:
            self._status_ns = time.monotonic_ns() + SIGN_NS
        else:
            self._say_status()

    def _say_status(self) -> None:
        self._said_ns = time.monotonic_ns()
        self._status_ns = self._said_ns + (self._order.idle_sign_ns if self._is_idle else SIGN_NS)
        self._is_idle = True
        self._said_elements = self._given_elements
        self._tell_repeats()
        self._ports.say(
            messages.UnitSign(
                self.step,
                self._errors,
                self._input_counts(),
                self._ports.output_counts(),
                self._state() if self._is_active and not self._handover.is_still else None,
                self._qualities.taken(),
            )
        )

    def _tell_repeats(self, *, is_last: bool = False) -> None:
        for trouble in self._failures.due(time.monotonic_ns(), is_last=is_last):
            self._ports.say(trouble)

    def _input_counts(self) -> dict[str, messages.PortCounts]:
        """The counts of each port, of all its streams together."""
        steps, by_inlet = self._steps, self._ports.input_counts()
        counts: dict[str, messages.PortCounts] = {}
        for port in self._order.inputs:
            elements, dropped, stale = 0, steps.dropped[port], 0
            for inlet, one in by_inlet.items():
                if port_of(inlet) == port:
                    elements, dropped, stale = elements + one.elements, dropped + one.dropped, stale + one.stale
            waiting = steps.waiting(port) + self._handover.waiting(port)
            counts[port] = messages.PortCounts(elements, dropped, stale, steps.skipped[port], waiting)
        return counts

    def _set_state(self, state: bytes | None) -> None:
        if self._stateful is not None and state is not None:
            self._stateful.set_state(msgspec.msgpack.decode(state))

    def _state(self) -> bytes | None:
        if self._stateful is None:
            return None
        try:
            return msgspec.msgpack.encode(self._stateful.get_state())
        except Exception as error:
            self._fail(error)
            return None

    def _one_more_input(self, inlet: str) -> UnitInput | None:
        """The input of one more stream, at a port that takes all streams."""
        return self._input_port(inlet) if self._order.counts.get(port_of(inlet)) == ALL else None

    def _input_port(self, name: str) -> UnitInput:
        def take(element: Element) -> None:
            put = self._handover.keep if self._handover.is_keeping else self._steps.put
            put(name, element, may_drop=not self._order.blocks)

        def pause() -> None:
            self._may_rest = True

        def has_room() -> bool:
            return not (self._order.blocks and self._handover.is_full(name))

        return UnitInput(name, InputQueue(self._order.queue), take, has_room, lambda: self._steps.forget(name), pause)
