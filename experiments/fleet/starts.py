"""How often a link between two Zenoh sessions stays silent in one direction if it opens as late as possible.

    python experiments/fleet/starts.py [--trials 60] [--as-zenoh]

A proxy delays the last message of the first attempt to connect until the connecting session is about to give up: 6 ms
earlier to 2 ms later. Zenoh then leaves some links open that no session reads. With --as-zenoh cfgplan does not close
these.
"""

from __future__ import annotations

import argparse
import contextlib
import socket
import struct
import threading
import time

from cfgplan_runtime.fleet import links
from cfgplan_runtime.streams import zenoh_link
from cfgplan_runtime.streams.zenoh_link import ZenohLink

HEARD_S = 2.5
FIRST_S, LAST_S = -0.006, 0.002
"""When the last message is let through, from the moment when the attempt is given up."""
_SIZE = struct.Struct("<H")
LAST_OF_OPENING = 2
"""The messages of who listens with which a link is open."""


class Proxy:
    """Relays messages between a new port and an existing one, and delays one message of the first connection."""

    def __init__(self, port: int, late_s: float) -> None:
        self._port, self._late_s = port, late_s
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port = self._server.getsockname()[1]
        self.connections = 0
        threading.Thread(target=self._accept, daemon=True).start()

    def close(self) -> None:
        self._server.close()

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                near, _ = self._server.accept()
                due_s = time.monotonic() + self._late_s
                far = socket.create_connection(("127.0.0.1", self._port))
                is_first = self.connections == 0
                self.connections += 1
                threading.Thread(target=pass_on, args=(near, far), daemon=True).start()
                threading.Thread(target=pass_on, args=(far, near, due_s if is_first else 0.0), daemon=True).start()


def pass_on(source: socket.socket, sink: socket.socket, due_s: float = 0.0) -> None:
    """Relay messages until an end is closed; hold the last message of the handshake until `due_s`."""
    number = 0
    with contextlib.suppress(OSError, EOFError):
        while True:
            size = received(source, _SIZE.size)
            message = received(source, *_SIZE.unpack(size))
            number += 1
            if number == LAST_OF_OPENING:
                time.sleep(max(0.0, due_s - time.monotonic()))
            sink.sendall(size + message)
    for end in (source, sink):
        with contextlib.suppress(OSError):
            end.shutdown(socket.SHUT_RDWR)


def received(source: socket.socket, size: int) -> bytes:
    data = b""
    while len(data) < size:
        more = source.recv(size - len(data))
        if not more:
            raise EOFError
        data += more
    return data


def hears(late_s: float) -> bool:
    """Return whether the connecting session receives from the listening one."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    listening = ZenohLink(links.config([f"tcp/127.0.0.1:{port}"]))
    listening.live("cfgplan/one/alive")
    proxy, is_heard = Proxy(port, late_s), threading.Event()
    connecting = ZenohLink(links.config(connect=[f"tcp/127.0.0.1:{proxy.port}"]))
    connecting.watch("cfgplan/*/alive", lambda *_: is_heard.set())
    found = is_heard.wait(HEARD_S)
    for end in (connecting, listening, proxy):
        end.close()
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=60)
    parser.add_argument("--as-zenoh", action="store_true", help="leave links that nobody reads as they are")
    options = parser.parse_args()
    if options.as_zenoh:
        zenoh_link._GIVE_UP = None
    open_s, step_s = links._OPEN_MS / 1000, (LAST_S - FIRST_S) / options.trials
    silent = sum(not hears(open_s + FIRST_S + number * step_s) for number in range(options.trials))
    print(f"{silent} of {options.trials} links are silent after {HEARD_S} s")


if __name__ == "__main__":
    main()
