"""The office's processing units: a converter of temperature units, and a thermostat."""

from __future__ import annotations


def celsius(fahrenheit: float) -> float:
    """Convert degrees Fahrenheit to degrees Celsius, rounded to hundredths."""
    return round((fahrenheit - 32) / 1.8, 2)


class Thermostat:
    """Maps temperatures in degrees Celsius to "ON" or "OFF" for the heater.

    It switches on below `wanted_c - band_c`, and off at or above `wanted_c + band_c`.
    """

    def __init__(self, wanted_c: float, band_c: float = 0.2) -> None:
        self._wanted_c, self._band_c = wanted_c, band_c
        self._is_on = False

    def __call__(self, temperature: float) -> str:
        band_c = self._band_c if self._is_on else -self._band_c
        self._is_on = temperature < self._wanted_c + band_c
        return "ON" if self._is_on else "OFF"
