"""The units that watch the building, as `alarm_units.yaml` names them; their measurements are functions of time.

Smoke appears for a second in one room, then in the other; every other second the cellar is wet.
"""

from __future__ import annotations

import time
from typing import Any

ROOMS = ("room101", "room102")
Alarm = dict[str, Any]


def smoke_sensor(room: str) -> float:
    """Return the density of the smoke in a room, from 0 (clear) to 1."""
    return 0.8 if (time.time() - ROOMS.index(room)) % 2 < 1 else 0.05


def thermometer(room: str) -> float:
    """Return the temperature of a room in degrees Celsius."""
    return 21 + 20 * smoke_sensor(room)


def people_counter(room: str) -> int:
    """Return the number of people in a room."""
    return 3 + ROOMS.index(room)


def fire_alarm(
    room: str, smoke: float, settings: dict[str, float] | None, temperature: float | None, people: int | None
) -> Alarm | None:
    """Return an alarm while the smoke of a room is at its limit or above, with temperature and people if measured; else
    None.

    `settings` has the limit of each room; without it the limit is 0.5.
    """
    if smoke < (settings or {}).get(room, 0.5):
        return None
    known = {"temperature": temperature, "people": people}
    return {"what": "fire", "where": room, **{name: value for name, value in known.items() if value is not None}}


def water_alarm() -> Alarm | None:
    """Return an alarm while the cellar is wet, otherwise None."""
    return {"what": "water", "where": "cellar"} if time.time() % 2 < 1 else None


def logger(alarms: list[Alarm]) -> None:
    """Print each alarm as a line: its kind, its place, and the measurements that it has."""
    for alarm in alarms:
        print(*alarm.values())


class Configuration:
    """Computes the smoke limit of each room: 0.5, raised by 0.001 with each alarm there, up to 0.7."""

    def __init__(self) -> None:
        self.number = dict.fromkeys(ROOMS, 0)

    def __call__(self, alarms: list[Alarm]) -> dict[str, float]:
        for alarm in alarms:
            self.number[alarm["where"]] += 1
        return {room: min(0.5 + number / 1000, 0.7) for room, number in self.number.items()}
