"""Unit code that is a program, which reads and writes messages on its standard streams (the manual's page `programs`).

The program gets a message for each step, several before it has answered the first, and answers each in turn. It runs
in the process group of the unit that hosts it, and its standard error is the unit's.
"""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Final, NamedTuple

import msgspec

from cfgplan.errors import InputError
from cfgplan_runtime.children.exit_status import end_of_process
from cfgplan_runtime.children.messages import UnitOrder
from cfgplan_runtime.children.program_messages import Answer, Message, Request, program_output
from cfgplan_runtime.children.program_source import ProgramSource
from cfgplan_runtime.children.started_usage import started_usage
from cfgplan_runtime.children.unit_code import Given
from cfgplan_runtime.errors import ProgramEndedError, ProgramFaultError
from cfgplan_runtime.streams.channel import socket_pair
from cfgplan_runtime.streams.element import Buffer, Moment

MOST_IN_FLIGHT = 32
"""Steps that wait for the answers of a program at most; `queue` may say fewer."""
_BYTES_IN_FLIGHT = 1 << 20
"""Bytes of the steps in flight from which no other is asked for, but for a second one: more would leave the caches."""
_PIPE_BYTES = 1 << 20
"""The most that the system allows a pipe of most users to hold."""
_MOST_PARTS = 64
"""Parts of messages that are written at once."""
_LARGE = 1 << 16
"""Bytes of messages that are written before others join them."""
_END_S = 1.0
"""Seconds within which a program whose output has ended is to end itself."""
_LOOK_S = 0.02
"""Seconds until it is looked again whether a program has ended whose output somebody else holds open."""
_SET_PIPE_SIZE = 1031


class _Asked(NamedTuple):
    """A step without an answer; its moment is None if its results have the time at which they come."""

    step: int
    moment: Moment | None
    size: int
    """Bytes of its message."""


NOT_READY: Final = 'the program has not written `{"ready": true}`: it must write and flush it before anything else'


class Reply(NamedTuple):
    """The results of a step, or of a source; `moment` is that of the step."""

    moment: Moment | None
    results: Iterator[Given]


class ProgramCode:
    """A program that was started and is ready. Raises ProgramEndedError.

    `fault` is called with faults of the program's output.
    """

    def __init__(self, order: UnitOrder, fault: Callable[[Exception], None]) -> None:
        self._outputs = tuple(order.outputs)
        self._is_source = not order.inputs
        self.sets_its_pace = self._is_source and order.period_ns is None
        # A source answers when it is asked: what it says of later steps would be old by then.
        self._most_in_flight = 1 if self._is_source else min(MOST_IN_FLIGHT, order.queue)
        self._fault = fault
        self._output = program_output(order.format)
        self._last_ns: dict[str, int] = {}
        self._step = 0
        self._asked: deque[_Asked] = deque()
        self._asked_bytes = 0
        self._since_ns = 0
        """When the program answered last, or was asked last while it owed nothing; monotonic."""
        self._unsent: deque[memoryview] = deque()
        self._unsent_bytes = 0
        self._is_deaf = False
        self.replies: deque[Reply] = deque()
        """The results that the unit has not taken yet, in order."""
        self._file, self._process, self.input, self.end = _start(order)
        """`end` can be read when the program has said something."""
        self._await_readiness()

    @property
    def has_room(self) -> bool:
        """Whether it may be asked for one more step. A source that sets its own pace is never asked."""
        return (
            len(self._asked) < self._most_in_flight
            and (self._asked_bytes < _BYTES_IN_FLIGHT or len(self._asked) < 2)
            and self._unsent_bytes < _LARGE
            and not (self.sets_its_pace or self._is_over)
        )

    @property
    def owes(self) -> bool:
        """Whether the program has steps to answer."""
        return bool(self._asked)

    @property
    def debt(self) -> str:
        """A sentence about the answer that the program owes."""
        owed = f"step {self._asked[0].step} has" if self._asked else "no step has"
        return f"{owed} waited for an answer of the program"

    @property
    def is_sending(self) -> bool:
        """Whether messages wait for `flush`, which is due when `input` can be written."""
        return bool(self._unsent)

    @property
    def is_heard(self) -> bool:
        """Whether to read more of the output: not while results wait in `replies`."""
        return not self._output.has_ended and not self.replies

    def silent_ns(self) -> int:
        """Nanoseconds for which the program has owed an answer; 0 while earlier answers wait in `replies`."""
        return 0 if self.replies or not self._asked else time.monotonic_ns() - self._since_ns

    def ask(self, values: dict[str, object], time_ns: int, moment: Moment | None) -> None:
        """Ask for a step; it is sent by `flush`, or now if it is large. Raises EncodingError."""
        self._step += 1
        parts = self._output.encode(Request(self._step, time_ns, values))
        if not self._asked:
            self._since_ns = time.monotonic_ns()
        size = sum(map(len, parts))
        self._asked.append(_Asked(self._step, moment, size))
        self._asked_bytes += size
        self._unsent.extend(map(memoryview, parts))
        self._unsent_bytes += size
        if self._unsent_bytes >= _LARGE:
            self.flush()

    def flush(self) -> None:
        """Write what the program takes of the messages to it."""
        while self._unsent:
            parts: list[Buffer] = [self._unsent[n] for n in range(min(len(self._unsent), _MOST_PARTS))]
            try:
                sent = os.writev(self.input, parts)
            except BlockingIOError:
                return
            except OSError:
                self._is_deaf = True
                self._unsent.clear()
                self._unsent_bytes = 0
                return
            self._unsent_bytes -= sent
            while self._unsent and sent >= len(self._unsent[0]):
                sent -= len(self._unsent.popleft())
            if sent:
                self._unsent[0] = self._unsent[0][sent:]
                return

    def hear(self) -> None:
        """Read what the program has said, and sort it into replies."""
        self._output.read(self.end)
        self._sort()

    def has_ended(self) -> bool:
        """Return whether a source has ended with exit status 0 and its results were taken.

        Raises ProgramEndedError if a program has ended in another way and its results were taken.
        """
        if not self._is_over or self.replies:
            return False
        if self._is_source and self._has_ended_well():
            return True
        raise self._cause_of_end()

    def close(self) -> None:
        """Close the program's standard input and wait for its end; one that would not notice gets SIGTERM."""
        os.close(self.input)
        if self.sets_its_pace or self._asked:
            self.interrupt()
        while self._process.poll() is None and not self._output.has_ended:
            select.select([self.end], [], [], _LOOK_S)
            self._output.read(self.end)
            self._output.complete.clear()
        os.close(self.end)
        status = self._process.wait()
        if status not in (0, -signal.SIGTERM, -signal.SIGPIPE):
            raise ProgramFaultError("exit status", f"at its stop the program: {end_of_process(status)}")

    def interrupt(self) -> None:
        """End a program that still runs after its standard input was closed."""
        self._process.terminate()

    def cpu_ns(self) -> int:
        """The CPU time of the program and its children."""
        return started_usage(os.getpid())[0] * 1000

    def files(self) -> dict[str, int]:
        """The program's file, and when it was changed (nanoseconds)."""
        return {str(self._file): self._file.stat().st_mtime_ns}

    @property
    def _is_over(self) -> bool:
        return self._output.has_ended or self._is_deaf

    def _await_readiness(self) -> None:
        """Wait for the message that says that the program is ready. Raises ProgramEndedError."""
        said = self._output.complete
        while True:
            while said:
                message = said.popleft()
                if self._output.is_readiness(message):
                    self._sort()
                    return
                self._fault(ProgramFaultError("not ready yet", 'before `{"ready": true}`', message.shown))
            if self._output.has_ended:
                raise self._cause_of_end()
            if not self._output.read(self.end):
                select.select([self.end], [], [])

    def _sort(self) -> None:
        while self._output.complete:
            self._take(self._output.complete.popleft())

    def _take(self, message: Message) -> None:
        """Settle the step that a message answers; a wrong answer settles the first one, and gives nothing.

        Only an answer with the number of a step that waits gives results, so that none is taken for another step's.
        """
        if not self.sets_its_pace and not self._asked:
            self._fault(ProgramFaultError(_NOT_ASKED, "no step waits for an answer", message.shown))
            return
        try:
            answers = self._output.answers(message)
            moment = None if self.sets_its_pace else self._settle(answers, message)
        except ProgramFaultError as error:
            self._fault(error)
            if self._asked and not message.is_stray and error.what != _NOT_ASKED:
                self._settled()
            return
        right = [answer for answer in answers if self._is_right(answer, message)]
        if any(answer.outputs for answer in right):
            self.replies.append(Reply(moment, _given(right)))

    def _settle(self, answers: list[Answer], message: Message) -> Moment | None:
        """The moment of the step that is answered. Raises ProgramFaultError."""
        step = answers[0].step if answers else None
        if step is None:
            told = f"its `step` is missing; the step that waits is {self._asked[0].step}"
            raise ProgramFaultError("no answer", told, message.shown)
        if any(answer.step not in (None, step) for answer in answers):
            raise ProgramFaultError("no answer", "all answers of a list must have one `step`", message.shown)
        if not self._asked[0].step <= step <= self._asked[-1].step:
            raise ProgramFaultError(_NOT_ASKED, f"step {step} does not wait for an answer", message.shown)
        while self._asked[0].step < step:
            told = f"step {self._asked[0].step} got no answer before step {step}"
            self._fault(ProgramFaultError("no answer", told, message.shown))
            self._settled()
        return self._settled().moment

    def _settled(self) -> _Asked:
        self._since_ns = time.monotonic_ns()
        settled = self._asked.popleft()
        self._asked_bytes -= settled.size
        return settled

    def _is_right(self, answer: Answer, message: Message) -> bool:
        """Whether ports and time of an answer are right; if not, that is told, and the answer does not count."""
        fault: ProgramFaultError | None = None
        for port in answer.outputs:
            if port not in self._outputs:
                known = ", ".join(self._outputs) or "none"
                told = f"there is no output port {port!r}, only {known}"
                fault = ProgramFaultError("unknown port", told, message.shown)
            elif answer.time_ns is not None and answer.time_ns < self._last_ns.get(port, answer.time_ns):
                told = f"the time {answer.time_ns} is before {self._last_ns[port]}, the last at {port}"
                fault = ProgramFaultError("time going back", told, message.shown)
        if fault is not None:
            self._fault(fault)
        elif answer.time_ns is not None:
            self._last_ns |= dict.fromkeys(answer.outputs, answer.time_ns)
        return fault is None

    def _has_ended_well(self) -> bool:
        with suppress(subprocess.TimeoutExpired):
            return self._process.wait(_END_S) == 0
        return False

    def _cause_of_end(self) -> ProgramEndedError:
        try:
            return ProgramEndedError(f"the program: {end_of_process(self._process.wait(_END_S))}")
        except subprocess.TimeoutExpired:
            return ProgramEndedError("the program has closed its standard input or output, but still runs")


_NOT_ASKED = "not asked for"


def _given(answers: list[Answer]) -> Iterator[Given]:
    for answer in answers:
        for port, value in answer.outputs.items():
            if value is not None:
                yield Given(port, value, answer.time_ns, answer.quality.get(port, {}))


def _start(order: UnitOrder) -> tuple[Path, subprocess.Popen[bytes], int, int]:
    """Start a program in its folder. Returns its file, its process, and our ends of its standard input and output.

    Raises ProgramEndedError.
    """
    folder = Path(order.folder)
    told = {"PARAMS": order.params, "INPUTS": order.inputs, "OUTPUTS": order.outputs}
    try:
        source = ProgramSource.read(order.source)
        assert source is not None
        file = source.file(folder)
    except InputError as error:
        raise ProgramEndedError(str(error)) from None
    make = _sockets if order.format == "msgpack" else os.pipe
    (stdin, input_end), (end, stdout) = make(), make()
    try:
        process = subprocess.Popen(
            [str(file), *source.arguments],
            stdin=stdin,
            stdout=stdout,
            cwd=folder,
            env=os.environ | {f"CFGPLAN_{key}": msgspec.json.encode(value).decode() for key, value in told.items()},
        )
    except OSError as error:
        raise ProgramEndedError(f"{file} can't be started: {error.strerror}") from None
    finally:
        os.close(stdin)
        os.close(stdout)
    for ours in (input_end, end):
        os.set_blocking(ours, False)
        _enlarge(ours)
    return file, process, input_end, end


def _sockets() -> tuple[int, int]:
    """The ends to read and to write of a connection, through which large messages go with less work than by a pipe.

    Others get pipes: shells may open these by the name /dev/stdin.
    """
    writer, reader = socket_pair()
    return reader.detach(), writer.detach()


def _enlarge(end: int) -> None:
    """Let a pipe hold an image, where the system allows it."""
    if sys.platform == "linux":
        import fcntl

        with suppress(OSError):
            fcntl.fcntl(end, _SET_PIPE_SIZE, _PIPE_BYTES)
