"""What the office's streams go through: a converter of units, and a thermostat."""

from __future__ import annotations


def celsius(fahrenheit: float) -> float:
    """Gives degrees Celsius."""
    return round((fahrenheit - 32) / 1.8, 2)


class Thermostat:
    """Says whether the heater is to be on: below the wanted temperature, and until it is a little above."""

    def __init__(self, wanted_c: float, band_c: float = 0.2) -> None:
        self._wanted_c, self._band_c = wanted_c, band_c
        self._is_on = False

    def __call__(self, temperature: float) -> str:
        band_c = self._band_c if self._is_on else -self._band_c
        self._is_on = temperature < self._wanted_c + band_c
        return "ON" if self._is_on else "OFF"
