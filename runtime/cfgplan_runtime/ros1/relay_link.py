"""The run's side of its relay of topics: started, and again with all that it leads if it has died."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from collections.abc import Iterator

import msgspec

from cfgplan_runtime.children.control import ControlConnection
from cfgplan_runtime.ros1.relay_messages import FromTopicRelay, RelayOrder, ToTopicRelay

_RELAY_CODE = "from cfgplan_runtime.ros1.topic_relay import main; main()"
_END_S = 5.0


class RelayLink:
    """A relay and the connection to it. It ends with the thread that made it. Raises OSError if it can't start."""

    def __init__(self, order: RelayOrder) -> None:
        ours, theirs = socket.socketpair()
        number = theirs.fileno()
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-c", _RELAY_CODE, str(number), str(os.getpid()), msgspec.json.encode(order).decode()],
                pass_fds=[number],
                stdin=subprocess.DEVNULL,
                start_new_session=True,
            )
        except OSError:
            ours.close()
            raise
        finally:
            theirs.close()
        self.control: ControlConnection[FromTopicRelay] = ControlConnection(ours, FromTopicRelay)

    @property
    def pid(self) -> int:
        return self._process.pid

    def tell(self, message: ToTopicRelay) -> None:
        """Have the relay do something."""
        self.control.send(message)

    def hear(self) -> Iterator[FromTopicRelay]:
        """What it has said."""
        self.control.flush()
        for message, _ in self.control.receive():
            yield message

    def close(self) -> int:
        """End it. Returns its exit status."""
        self._process.kill()
        status = self._process.wait(_END_S)
        self.control.close()
        return status
