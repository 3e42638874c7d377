"""Fast DDS, ROS 2's usual middleware, in a run: each process gets a profile, and no shared memory is left behind."""

from __future__ import annotations

import fcntl
import os
import socket
import time
from collections.abc import Mapping
from contextlib import suppress
from itertools import chain
from math import inf
from pathlib import Path

_FILE_VARIABLES = ("FASTDDS_DEFAULT_PROFILES_FILE", "FASTRTPS_DEFAULT_PROFILES_FILE")
"""Which file has the profiles: of Fast DDS 2.8 and newer, and of older ones."""
_DEPRECATED = "FASTRTPS_DEFAULT_PROFILES_FILE value is used for participant configuration, but it is deprecated"
_FIRST_NUMBER, _NUMBERS = 10, 120
_PORT, _PER_DOMAIN, _PER_NUMBER = 7410, 250, 2
_MEMORY = Path("/dev/shm")
_YOUNG_S = 0.1
"""A file of shared memory this young may be in the making: its owner has not locked it yet."""
_PROFILE = """\
<?xml version="1.0" encoding="UTF-8" ?>
<profiles xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles">
  <transport_descriptors>
    <transport_descriptor>
      <transport_id>memory</transport_id><type>SHM</type>
      <segment_size>16777216</segment_size><maxMessageSize>8388608</maxMessageSize>
    </transport_descriptor>
    <transport_descriptor><transport_id>network</transport_id><type>UDPv4</type></transport_descriptor>
  </transport_descriptors>
  <participant profile_name="cfgplan" is_default_profile="true">
    <rtps>
      <userTransports><transport_id>memory</transport_id><transport_id>network</transport_id></userTransports>
      <useBuiltinTransports>false</useBuiltinTransports>
{number}      <builtin>
        <discovery_config>
          <leaseDuration><sec>3</sec></leaseDuration>
          <leaseAnnouncement><sec>0</sec><nanosec>500000000</nanosec></leaseAnnouncement>
          <initialAnnouncements><count>60</count><period><nanosec>50000000</nanosec></period></initialAnnouncements>
        </discovery_config>
      </builtin>
    </rtps>
  </participant>
</profiles>
"""


class FastDdsProfiles:
    """Profiles of a run's processes, in its folder. None if the user has some, or another middleware is asked for.

    Each process has a participant number of its own: a new one that took the number of one that has just died, and so
    its ports, would be found seconds later.
    """

    def __init__(self, folder: Path, environment: Mapping[str, str]) -> None:
        asked_for = environment.get("RMW_IMPLEMENTATION", "fastrtps")
        self._is_used = "fastrtps" in asked_for and not any(environment.get(name) for name in _FILE_VARIABLES)
        self._folder, self._domain = folder, _whole(environment.get("ROS_DOMAIN_ID", ""))
        self._last = _FIRST_NUMBER - 1

    def environment(self, name: str, *, has_number: bool = True) -> Mapping[str, str]:
        """Environment variables that give a process a profile of its own, a file of this name.

        A process that makes several participants can't have a number: they would all ask for the same one.
        """
        if not self._is_used:
            return {}
        number = self._free_number() if has_number else None
        line = "" if number is None else f"      <participantID>{number}</participantID>\n"
        path = self._folder / f"{name}.xml"
        path.write_text(_PROFILE.format(number=line))
        return dict.fromkeys(_FILE_VARIABLES, str(path))

    def causes(self, line: str) -> bool:
        """Whether a line is a warning that only the variables of these profiles cause, as in Kilted."""
        return self._is_used and _DEPRECATED in line

    def _free_number(self) -> int | None:
        """The next number whose port is free; None if none is."""
        for number in chain(range(self._last + 1, _NUMBERS), range(_FIRST_NUMBER, self._last + 1)):
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe, suppress(OSError, OverflowError):
                probe.bind(("", _PORT + _PER_DOMAIN * self._domain + _PER_NUMBER * number))
                self._last = number
                return number
        return None


def clean_memory(folder: Path = _MEMORY) -> None:
    """Remove shared memory of Fast DDS whose owners have died: each has a lock file that its owner holds."""
    for name in {path.name.removesuffix("_el").removesuffix("_sl") for path in folder.glob("fastrtps_*")}:
        locks = [folder / f"{name}_el", folder / f"{name}_sl"]
        paths = [folder / name, folder / f"sem.{name}_mutex", *locks]
        with suppress(OSError):
            changed_s = max((path.stat().st_mtime for path in paths if path.exists()), default=inf)
            if time.time() - changed_s > _YOUNG_S and not any(_is_held(lock) for lock in locks if lock.exists()):
                for path in paths:
                    path.unlink(missing_ok=True)


def _is_held(lock: Path) -> bool:
    """Whether a process holds a lock file. Raises OSError."""
    descriptor = os.open(lock, os.O_RDWR | os.O_CLOEXEC)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    finally:
        os.close(descriptor)
    return False


def _whole(text: str) -> int:
    return int(text) if text.isascii() and text.isdigit() else 0
