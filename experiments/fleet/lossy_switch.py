"""A switch in user space between network devices that loses and delays frames, for kernels without netem.

`lossy_switch.py LOSS DELAY_S DEVICE...`: each frame is lost with the probability LOSS, else passed on DELAY_S seconds
later. It prints a line once it works, and ends with its standard input. `lossy_switch.py plain DEVICE` lets a device
send frames as on a wire: with checksums, and no larger than a packet.
"""

from __future__ import annotations

import ctypes
import fcntl
import heapq
import random
import select
import socket
import struct
import sys
import time
from contextlib import suppress

_ALL_PROTOCOLS = 3
_ETHTOOL = 0x8946
_SET_OFF = (0x17, 0x19, 0x1F, 0x21, 0x24, 0x2C)
"""Of ethtool: no checksums, no scatter and gather, no segments by the device."""
_BUFFER = 8 << 20
_FRAMES_AT_ONCE = 200


def main() -> None:
    if sys.argv[1] == "plain":
        make_plain(sys.argv[2])
        return
    loss, delay_s, *devices = float(sys.argv[1]), float(sys.argv[2]), *sys.argv[3:]
    ends = {opened(device): device for device in devices}
    by_device = {device: end for end, device in ends.items()}
    where: dict[bytes, str] = {}
    due: list[tuple[float, int, str, bytes]] = []
    number = 0
    print("ready", flush=True)
    while True:
        while due and due[0][0] <= time.monotonic():
            _, _, device, frame = heapq.heappop(due)
            with suppress(OSError):
                by_device[device].send(frame)
        wait_s = max(0.0, due[0][0] - time.monotonic()) if due else 1.0
        for end in select.select([*ends, sys.stdin], [], [], wait_s)[0]:
            if end is sys.stdin:
                return
            came = ends[end]
            for frame in received(end):
                where[frame[6:12]] = came
                known = None if frame[0] & 1 else where.get(frame[:6])
                for device in [known] if known else devices:
                    if device != came and random.random() >= loss:
                        number += 1
                        heapq.heappush(due, (time.monotonic() + delay_s, number, device, frame))


def make_plain(device: str) -> None:
    """Let a device send frames as on a wire: with checksums, and no larger than a packet."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as control:
        for command in _SET_OFF:
            value = ctypes.create_string_buffer(struct.pack("II", command, 0))
            request = struct.pack("16sP", device.encode(), ctypes.addressof(value)) + bytes(16)
            with suppress(OSError):
                fcntl.ioctl(control, _ETHTOOL, request)


def opened(device: str) -> socket.socket:
    """Return a socket that sends and receives the frames of a device."""
    make_plain(device)
    end = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(_ALL_PROTOCOLS))
    end.bind((device, 0))
    end.setblocking(False)
    end.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER)
    return end


def received(end: socket.socket) -> list[bytes]:
    """Return the frames that a device has received from outside since the last call."""
    frames = []
    for _ in range(_FRAMES_AT_ONCE):
        try:
            frame, (_, _, kind, *_) = end.recvfrom(1 << 16)
        except BlockingIOError:
            break
        if kind != socket.PACKET_OUTGOING:
            frames.append(frame)
    return frames


if __name__ == "__main__":
    main()
