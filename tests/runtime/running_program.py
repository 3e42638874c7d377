"""A program for the tests of programs, which knows nothing of cfgplan: the first argument says what it does."""

from __future__ import annotations

import json
import os
import signal
import sys
import time
from pathlib import Path
from typing import Any

PORT = json.loads(os.environ["CFGPLAN_OUTPUTS"])[0]
NOTES = json.loads(os.environ["CFGPLAN_PARAMS"]).get("notes")


def say(line: object) -> None:
    sys.stdout.write(f"{line if isinstance(line, str) else json.dumps(line)}\n")
    sys.stdout.flush()


def note(name: str) -> None:
    """Leave a file in the folder that the test has named, if it has."""
    if NOTES is not None:
        (Path(NOTES) / name).write_text("")


def end(*_: object) -> None:
    note("terminated")
    sys.exit(0)


def wrong(deed: str, number: int) -> None:
    """Say something wrong at step 5, and what is right at every other."""
    right: dict[str, Any] = {"outputs": {PORT: number}}
    lines: dict[str, list[object]] = {
        "chatter": ["loading the model", right],
        "broken": ["{'outputs': {}}"],
        "no answer": [{"output": {PORT: number}}],
        "port": [{"outputs": {"z": number}}],
        "time": [[right | {"time_ns": 2}, right | {"time_ns": 1}]],
        "large": ['{"outputs": {"' + PORT + '": "' + "x" * (1 << 26) + '"}}'],
        "twice": [right, right],
        "no utf-8": [],
    }
    if number % 5:
        say(right)
    elif deed == "no utf-8":
        os.write(1, b"{\xff\xfe}\n")
    else:
        for line in lines[deed]:
            say(line)


def answer(deed: str, request: dict[str, Any]) -> None:
    value = next(iter(request["inputs"].values()), request["step"])
    if deed == "same":
        say({"outputs": {PORT: value}})
    elif deed == "request":
        say({"outputs": {PORT: request}})
    elif deed == "several":
        say([{"outputs": {PORT: value}}, {}, {"outputs": {PORT: [value]}}])
    elif deed == "nothing":
        say({"outputs": {PORT: None}})
    elif deed == "burn":
        until = time.process_time() + 0.5
        while time.process_time() < until:
            pass
        say({})
    elif deed == "exit":
        sys.exit(3)
    elif deed == "crash":
        os.kill(os.getpid(), signal.SIGSEGV)
    elif deed == "hang":
        time.sleep(3600)
    else:
        wrong(deed, value)


def main(deed: str) -> None:
    sys.stderr.write(f"log: {os.environ['CFGPLAN_PARAMS']}\n")
    if deed == "never ready":
        sys.exit(4)
    say("a banner")
    say({"ready": True})
    if deed in ("own pace", "ends", "fails"):
        signal.signal(signal.SIGTERM, end)
        for number in range(1 << 60 if deed == "own pace" else 3):
            say({"outputs": {PORT: number}, "time_ns": time.time_ns()})
            time.sleep(0.005)
        sys.exit(1 if deed == "fails" else 0)
    for line in sys.stdin:
        answer(deed, json.loads(line))
    note("ended")
    while deed == "stubborn":
        time.sleep(3600)


if __name__ == "__main__":
    main(sys.argv[1])
