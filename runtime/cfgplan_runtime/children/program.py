"""Unit code that is a program: lines of JSON on its standard input and output (the manual's page `programs`).

The program gets a line for each step and answers each by one line. It runs in the process group of the unit that hosts
it, and its standard error is the unit's.
"""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import msgspec

from cfgplan.errors import InputError
from cfgplan_runtime.children.exit_status import end_of_process
from cfgplan_runtime.children.messages import UnitOrder
from cfgplan_runtime.children.program_lines import LONGEST_LINE, PIPE_BYTES, Line, Lines
from cfgplan_runtime.children.program_source import ProgramSource
from cfgplan_runtime.children.started_usage import started_usage
from cfgplan_runtime.children.unit_code import Given
from cfgplan_runtime.errors import EncodingError, ProgramEndedError, ProgramFaultError

_END_S = 1.0
"""Seconds within which a program whose output has ended is to end itself."""
_LOOK_S = 0.02
"""Seconds until it is looked again whether a program has ended whose output somebody else holds open."""
_SET_PIPE_SIZE = 1031


class Answer(msgspec.Struct, forbid_unknown_fields=True):
    """The results of a step or of a source, one for each port at most."""

    outputs: dict[str, Any] = {}
    time_ns: int | None = None


class Readiness(msgspec.Struct, forbid_unknown_fields=True):
    """The first line: the program is ready for steps."""

    ready: bool


_ANSWERS = msgspec.json.Decoder(Answer | list[Answer])


class ProgramCode:
    """A program that was started and is ready. Raises ProgramEndedError.

    `time_ns` returns the time of the present step; `fault` is called with faults of the program's output.
    """

    can_not_go_on = False

    def __init__(self, order: UnitOrder, time_ns: Callable[[], int], fault: Callable[[Exception], None]) -> None:
        self._outputs = tuple(order.outputs)
        self._is_source = not order.inputs
        self._sets_its_pace = self._is_source and order.period_ns is None
        self._time_ns = time_ns
        self._fault = fault
        self._encoder = msgspec.json.Encoder(enc_hook=_plain)
        self._lines = Lines()
        self._last_ns: dict[str, int] = {}
        self._step = 0
        self._is_asked = False
        self._file, self._process = _start(order)
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._in, self.end = self._process.stdin.fileno(), self._process.stdout.fileno()
        """`end` can be read when the program has said something."""
        for end in (self._in, self.end):
            os.set_blocking(end, False)
            _enlarge(end)
        while (line := self._next_line()) is not None and not self._is_readiness(line):
            pass
        if line is None:
            raise self._cause_of_end()

    @property
    def has_more(self) -> bool:
        """Whether a source has something to give, or its end to tell; one that gives when asked always has."""
        return not self._sets_its_pace or bool(self._lines.complete) or self._lines.has_ended

    @property
    def is_heard(self) -> bool:
        """Whether to read the program's output while no step is under way."""
        return not self._lines.has_ended and not (self._sets_its_pace and self._lines.complete)

    def hear(self, *, is_spare: bool) -> None:
        """Read what the program has said without being asked; a spare's is thrown away.

        Raises ProgramEndedError if it has ended, unless it is a source that had no more.
        """
        self._lines.read(self.end)
        if is_spare:
            self._lines.complete.clear()
        elif not self._sets_its_pace:
            self._refuse_unasked()
        if self._lines.has_ended and not (self._is_source and self._has_ended_well()):
            raise self._cause_of_end()

    def step(self, values: Mapping[str, object]) -> Iterator[Given]:
        """The results of one step. Raises EncodingError and ProgramEndedError."""
        self._step += 1
        self._lines.read(self.end)
        self._refuse_unasked()
        request = {"step": self._step, "time_ns": self._time_ns(), "inputs": values}
        try:
            line = self._encoder.encode(request) + b"\n"
        except (TypeError, ValueError, OverflowError, RecursionError, msgspec.MsgspecError) as error:
            raise EncodingError(f"step {self._step} can't be a line of JSON: {error}") from None
        self._is_asked = True
        self._write(line)
        answer = self._answer()
        self._is_asked = False
        return self._given(answer)

    def produce(self) -> Iterator[Given]:
        """A source's next results. Raises StopIteration when the program has ended well, else ProgramEndedError."""
        if not self._sets_its_pace and not self._lines.has_ended:
            try:
                return self.step({})
            except ProgramEndedError:
                pass
        answer = self._answer_in(self._lines.complete.popleft()) if self._lines.complete else None
        if answer is None and self._lines.has_ended and not self._lines.complete:
            if self._has_ended_well():
                raise StopIteration
            raise self._cause_of_end()
        return self._given(answer or [])

    def close(self) -> None:
        """Close the program's standard input and wait for its end; one that would not notice gets SIGTERM."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        with suppress(OSError):
            self._process.stdin.close()
        if self._sets_its_pace or self._is_asked:
            self.interrupt()
        while self._process.poll() is None and not self._lines.has_ended:
            select.select([self.end], [], [], _LOOK_S)
            self._lines.read(self.end)
            self._lines.complete.clear()
        self._process.stdout.close()
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

    def _is_readiness(self, line: Line) -> bool:
        with suppress(msgspec.MsgspecError):
            if msgspec.json.decode(line.text, type=Readiness).ready:
                return True
        self._fault(ProgramFaultError("not ready yet", 'before `{"ready": true}`', line.shown))
        return False

    def _answer(self) -> list[Answer]:
        """The answer to a step; lines that are none are told."""
        while (line := self._next_line()) is not None:
            if (answer := self._answer_in(line)) is not None:
                return answer
        raise self._cause_of_end()

    def _answer_in(self, line: Line) -> list[Answer] | None:
        """The answer that a line has, empty if it is a wrong one; None if it can't have been meant as one."""
        try:
            if line.is_too_large:
                raise ProgramFaultError("too large", f"more than {LONGEST_LINE >> 20} MB in one line", line.shown)
            answer = _ANSWERS.decode(line.text)
        except msgspec.ValidationError as error:
            self._fault(ProgramFaultError("no answer", str(error), line.shown))
        except msgspec.MsgspecError as error:
            self._fault(ProgramFaultError("no JSON", str(error), line.shown))
        except ProgramFaultError as error:
            self._fault(error)
        else:
            answers = answer if isinstance(answer, list) else [answer]
            return [one for one in answers if self._is_right(one, line)]
        return [] if line.text.startswith((b"{", b"[")) else None

    def _is_right(self, answer: Answer, line: Line) -> bool:
        """Whether ports and time of an answer are right; if not, that is told, and the answer does not count."""
        fault: ProgramFaultError | None = None
        for port in answer.outputs:
            if port not in self._outputs:
                known = ", ".join(self._outputs) or "none"
                fault = ProgramFaultError("unknown port", f"there is no output port {port!r}, only {known}", line.shown)
            elif answer.time_ns is not None and answer.time_ns < self._last_ns.get(port, answer.time_ns):
                told = f"{answer.time_ns} comes after {self._last_ns[port]} at {port}"
                fault = ProgramFaultError("time going back", told, line.shown)
        if fault is not None:
            self._fault(fault)
        elif answer.time_ns is not None:
            self._last_ns |= dict.fromkeys(answer.outputs, answer.time_ns)
        return fault is None

    def _given(self, answers: list[Answer]) -> Iterator[Given]:
        for answer in answers:
            for port, value in answer.outputs.items():
                if value is not None:
                    yield Given(port, value, answer.time_ns)

    def _refuse_unasked(self) -> None:
        while self._lines.complete:
            line = self._lines.complete.popleft()
            self._fault(ProgramFaultError("not asked for", "a line that answers no step", line.shown))

    def _next_line(self) -> Line | None:
        """The next line, waited for; None if the output has ended."""
        while not self._lines.complete:
            if self._lines.has_ended:
                return None
            if not self._lines.read(self.end):
                select.select([self.end], [], [])
        return self._lines.complete.popleft()

    def _write(self, line: bytes) -> None:
        left = memoryview(line)
        while left:
            try:
                left = left[os.write(self._in, left) :]
            except BlockingIOError:
                select.select([self.end] * (not self._lines.has_ended), [self._in], [])
                self._lines.read(self.end)
            except OSError:
                raise self._cause_of_end() from None

    def _has_ended_well(self) -> bool:
        with suppress(subprocess.TimeoutExpired):
            return self._process.wait(_END_S) == 0
        return False

    def _cause_of_end(self) -> ProgramEndedError:
        try:
            return ProgramEndedError(f"the program: {end_of_process(self._process.wait(_END_S))}")
        except subprocess.TimeoutExpired:
            return ProgramEndedError("the program has closed its standard input or output, and goes on")


def _start(order: UnitOrder) -> tuple[Path, subprocess.Popen[bytes]]:
    """Start a program in its folder. Raises ProgramEndedError."""
    folder = Path(order.folder)
    told = {"PARAMS": order.params, "INPUTS": order.inputs, "OUTPUTS": order.outputs}
    try:
        source = ProgramSource.read(order.source)
        assert source is not None
        file = source.file(folder)
        process = subprocess.Popen(
            [str(file), *source.arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            bufsize=0,
            cwd=folder,
            env=os.environ | {f"CFGPLAN_{key}": msgspec.json.encode(value).decode() for key, value in told.items()},
        )
    except InputError as error:
        raise ProgramEndedError(str(error)) from None
    except OSError as error:
        raise ProgramEndedError(f"{file} can't be started: {error.strerror}") from None
    return file, process


def _enlarge(end: int) -> None:
    """Let a pipe hold an image, where the system allows it."""
    if sys.platform == "linux":
        import fcntl

        with suppress(OSError):
            fcntl.fcntl(end, _SET_PIPE_SIZE, PIPE_BYTES)


def _plain(value: Any) -> object:
    """The JSON value in place of an array or a number of numpy."""
    numpy = sys.modules.get("numpy")
    if numpy is not None and isinstance(value, (numpy.ndarray, numpy.generic)):
        return value.tolist()
    raise TypeError(f"JSON has no {type(value).__name__}")
