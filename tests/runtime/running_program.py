"""A program for the tests of programs, which knows nothing of cfgplan.

The first argument says what it does; a second one, `msgpack`, that it writes frames instead of lines.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

PORT = json.loads(os.environ["CFGPLAN_OUTPUTS"])[0]
NOTES = json.loads(os.environ["CFGPLAN_PARAMS"]).get("notes")


IS_MSGPACK = sys.argv[2:] == ["msgpack"]
if IS_MSGPACK:
    import msgspec


def framed(payload: bytes) -> bytes:
    return b"\xc1CFG" + len(payload).to_bytes(4, "little") + payload


def message(value: object) -> bytes:
    if not IS_MSGPACK:
        return json.dumps(value).encode() + b"\n"
    body = msgspec.msgpack.encode(value)
    return framed(len(body).to_bytes(4, "little") + body)


def write(data: bytes) -> None:
    sys.stdout.buffer.write(data)
    sys.stdout.flush()


def say(value: object) -> None:
    write(message(value))


def requests() -> Iterator[dict[str, Any]]:
    """What is asked; in frames without arrays."""
    if not IS_MSGPACK:
        yield from map(json.loads, sys.stdin)
    while IS_MSGPACK and (head := sys.stdin.buffer.read(8)):
        payload = sys.stdin.buffer.read(int.from_bytes(head[4:], "little"))
        yield msgspec.msgpack.decode(payload[4:])


def note(name: str) -> None:
    """Leave a file in the folder that the test has named, if it has."""
    if NOTES is not None:
        (Path(NOTES) / name).write_text("")


def end(*_: object) -> None:
    note("terminated")
    sys.exit(0)


def wrong(deed: str, step: int, number: int) -> None:
    """Say something wrong at step 5, and what is right at every other."""
    right: dict[str, Any] = {"step": step, "outputs": {PORT: number}}
    large = "x" * (1 << 26) if deed == "large" else ""  # to make it takes long
    messages: dict[str, list[object]] = {
        "chatter": [b"loading the model\n", right],
        "broken": [framed(b"\x02\0\0\0\x92\xc1") if IS_MSGPACK else b"{'outputs': {}}\n"],
        "no utf-8": [b"\xff\xfe\n", right] if IS_MSGPACK else [b"{\xff\xfe}\n"],
        "deep": [
            framed(b"\xff\xff\0\0" + b"\x91" * 65535) if IS_MSGPACK else b'{"outputs": {"y": ' + b"[" * 9999 + b"\n"
        ],
        "no answer": [{"step": step, "output": {PORT: number}}],
        "no step": [{"outputs": {PORT: number}}],
        "two steps": [[right, right | {"step": step - 1}]],
        "skips": [],
        "port": [right | {"outputs": {"z": number}}],
        "time": [[right | {"time_ns": 2}, right | {"time_ns": 1}]],
        "no time": [right | {"time_ns": 1 << 64 - 1}],
        "large": [right | {"outputs": {PORT: large}}],
        "twice": [right, right],
        "late": [right, {"step": step - 1, "outputs": {PORT: -1}}],
        "early": [right | {"step": step + 1000, "outputs": {PORT: -1}}, right],
    }
    for each in messages[deed] if number % 5 == 0 else [right]:
        write(each if isinstance(each, bytes) else message(each))


def answer(deed: str, request: dict[str, Any]) -> None:
    step = request["step"]
    value = next(iter(request["inputs"].values()), step)
    if deed in ("same", "ignores stops", "writes into foreign descriptors"):
        say({"step": step, "outputs": {PORT: value}})
    elif deed == "request":
        say({"step": step, "outputs": {PORT: request}})
    elif deed == "several":
        say([{"step": step, "outputs": {PORT: value}}, {}, {"outputs": {PORT: [value]}}])
    elif deed == "nothing":
        say({"step": step, "outputs": {PORT: None}})
    elif deed == "burn":
        until = time.process_time() + 0.1
        while time.process_time() < until:
            pass
        say({"step": step})
    elif deed == "exit":
        sys.exit(3)
    elif deed == "crash":
        os.kill(os.getpid(), signal.SIGSEGV)
    elif deed == "hang":
        time.sleep(3600)
    elif deed == "memory of two":
        hoard = [b"x" * (n + (1 << 20)) for n in range(150)]
        os.fork()
        time.sleep(3600 * len(hoard))
    elif deed == "memory":
        hoard = [b"x" * (n + (1 << 20)) for n in range(300)]
        time.sleep(3600 * len(hoard))
    else:
        wrong(deed, step, value)


def flood(segment: bytes) -> None:
    """Write without end, as fast as it is read, until the reader is gone."""
    with suppress(OSError):
        while True:
            sys.stdout.buffer.write(segment)


def misbehave(deed: str) -> None:
    """Be hostile before any step, or for ever."""
    if deed == "not ready":
        time.sleep(3600)
    elif deed == "floods before it is ready":
        flood(b"loading the model\n")
    elif deed == "floods with lines":
        say({"ready": True})
        flood(b"y\n")
    elif deed == "floods with a line":
        say({"ready": True})
        flood(b"y" * 4096)
    elif deed == "floods with answers":
        say({"ready": True})
        flood(message({"step": 1, "outputs": {PORT: -1}}))
    elif deed == "floods its log":
        say({"ready": True})
        os.dup2(2, 1)
        flood(b"y\n")
    elif deed == "promises":
        say({"ready": True})
        write(b"\xc1CFG" + (1 << 26).to_bytes(4, "little") if IS_MSGPACK else b'{"step": 1, ')
        time.sleep(3600)
    elif deed == "writes into foreign descriptors":
        for number in range(3, 64):
            with suppress(OSError):
                os.write(number, b"\x05\0\0\0\0\0\0\0hello" * 3)
    elif deed == "ignores stops":
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
    elif deed == "closes its input":
        say({"ready": True})
        os.close(0)
        time.sleep(3600)
    elif deed == "closes its output":
        say({"ready": True})
        os.close(1)
        time.sleep(3600)


def main(deed: str) -> None:
    sys.stderr.write(f"log: {os.environ['CFGPLAN_PARAMS']}\n")
    if deed == "never ready":
        sys.exit(4)
    misbehave(deed)
    write(b"a banner\n")
    say({"ready": True})
    if deed in ("own pace", "ends", "fails"):
        signal.signal(signal.SIGTERM, end)
        for number in range(1 << 60 if deed == "own pace" else 3):
            say({"outputs": {PORT: number}, "time_ns": time.time_ns()})
            time.sleep(0.005)
        sys.exit(1 if deed == "fails" else 0)
    if deed == "pairs":
        arriving = requests()
        for first, second in zip(arriving, arriving, strict=False):
            answer("same", first)
            answer("same", second)
    for request in requests():
        answer(deed, request)
    note("ended")
    while deed in ("stubborn", "ignores stops"):
        time.sleep(3600)


if __name__ == "__main__":
    main(sys.argv[1])
