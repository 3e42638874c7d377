"""Test whether Zenoh's routing connects two sessions that are linked only through a third one.

    python experiments/fleet/third.py [--trials 15]

`r1`, `r2` and `manager` connect to `base`, at about the same time. Then `r1` and `r2` end, and restart at once. The
table counts the trials in which, 5 s later, a session does not reach every other one, or does not seem alive to it.
"""

from __future__ import annotations

import argparse
import random
import socket
import threading
import time
from collections.abc import Callable, Iterable
from typing import Any

from cfgplan_runtime.fleet import links
from cfgplan_runtime.streams.zenoh_link import ZenohLink

NAMES = ("base", "r1", "r2", "manager")
PATIENCE_S = 5.0
GOSSIP = {"enabled": True, "multihop": True}
WAYS: dict[str, tuple[str, str, dict[str, Any]]] = {
    "all are routers": ("router", "router", {}),
    "all are peers that gossip": ("peer", "peer", GOSSIP),
    "base is a router, the others peers that gossip": ("router", "peer", GOSSIP),
    "base is a peer, the others clients (as agents do it)": ("peer", "client", {}),
}
"""The mode of the base and of the others, and what each says of whom it knows."""


class Session:
    """A session, the sessions that it receives from, and the sessions that seem alive to it."""

    def __init__(self, name: str, base: str, way: tuple[str, str, dict[str, Any]]) -> None:
        self.heard, self.alive = set[str](), set[str]()
        is_base = name == "base"
        config = links.config([base] if is_base else [], [] if is_base else [base])
        config["mode"] = way[0] if is_base else way[1]
        config["scouting"]["gossip"] |= way[2]
        self.link = ZenohLink(config)
        self.link.hear(f"cfgplan/*/data/{name}/*", lambda key, *_: self.heard.add(key.split("/")[1]))
        self.link.watch("cfgplan/*/alive", self._note_life)
        self.link.live(f"cfgplan/{name}/alive")

    def _note_life(self, key: str, is_alive: bool) -> None:
        (self.alive.add if is_alive else self.alive.discard)(key.split("/")[1])


def opened(names: Iterable[str], sessions: dict[str, Session], make: Callable[[str], Session]) -> None:
    """Open sessions at about the same time."""

    def run(name: str) -> None:
        time.sleep(random.random() * 0.3)
        sessions[name] = make(name)

    threads = [threading.Thread(target=run, args=(name,)) for name in names]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()


def is_whole(sessions: dict[str, Session]) -> bool:
    """Return whether, before a deadline, each session receives from all others, and sees that they are alive."""
    pairs = [(one, other) for one in NAMES for other in NAMES if one != other]
    puts = [sessions[one].link.publisher(f"cfgplan/{one}/data/{other}/x", "small") for one, other in pairs]
    for session in sessions.values():
        session.heard.clear()
    end_s = time.monotonic() + PATIENCE_S
    while time.monotonic() < end_s:
        for put in puts:
            put(b"", b"x")
        if all(one in sessions[other].heard & sessions[other].alive for one, other in pairs):
            return True
        time.sleep(0.02)
    return False


def trial(way: tuple[str, str, dict[str, Any]]) -> tuple[bool, bool]:
    """Return whether all sessions reach each other, at first and after two have restarted."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        base = f"tcp/127.0.0.1:{free.getsockname()[1]}"
    sessions: dict[str, Session] = {}
    if way[1] == "client":  # which fails without anybody to go through
        sessions["base"] = Session("base", base, way)
    opened([name for name in NAMES if name not in sessions], sessions, lambda name: Session(name, base, way))
    first = is_whole(sessions)
    for name in ("r1", "r2"):
        sessions[name].link.close()
    opened(("r1", "r2"), sessions, lambda name: Session(name, base, way))
    again = is_whole(sessions)
    for session in sessions.values():
        session.link.close()
    return first, again


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=15)
    trials = parser.parse_args().trials
    for name, way in WAYS.items():
        found = [trial(way) for _ in range(trials)]
        firsts, agains = (sum(not one for one in ones) for ones in zip(*found, strict=True))
        print(f"{name}: not whole in {firsts} of {trials}, after two came again in {agains}", flush=True)


if __name__ == "__main__":
    main()
