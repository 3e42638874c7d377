"""Figures in everyday units, for every output: times, rates, shares of a core, data rates, times of day."""

from __future__ import annotations

import math
import time

MICROSECONDS = 1_000_000
"""In a second."""
_MINUTE_S, _HOUR_S, _DAY_S = 60, 3600, 86400


def span(seconds: float) -> str:
    """A time: `0.8 ms`, `12 ms`, `4.2 s`, `45 s`, `3 min`, `2 h 5 min`, `3 d 4 h`."""
    if seconds < 0:
        return f"-{span(-seconds)}"
    if seconds == 0:
        return "0 s"
    if seconds < 0.9995:
        return f"{_short(seconds * 1e3)} ms"
    if seconds < 9.95:
        return f"{_short(seconds)} s"
    if seconds < 2 * _MINUTE_S:
        return f"{seconds:.0f} s"
    if seconds < 2 * _HOUR_S:
        return f"{seconds / _MINUTE_S:.0f} min"
    if seconds < 2 * _DAY_S:
        return _two(seconds, _HOUR_S, "h", _MINUTE_S, "min")
    return _two(seconds, _DAY_S, "d", _HOUR_S, "h")


def rate(hertz: float) -> str:
    """A rate, by its period if that is longer: `100 Hz`, `2.5 Hz`, `every 8 s`; `never` for 0."""
    if hertz <= 0:
        return "never"
    return f"{_short(hertz)} Hz" if hertz >= 0.95 else f"every {span(1 / hertz)}"


def core_share(cpu_us_per_s: float) -> str:
    """CPU time per second of time, in microseconds, as a share of a core: `5 % of a core`, `2.35 cores`."""
    return short_core_share(cpu_us_per_s, " of a core")


def short_core_share(cpu_us_per_s: float, of: str = "") -> str:
    """The same where it is clear that a core is meant: `5 %`, `2.35 cores`. `of` follows a percentage."""
    percent = cpu_us_per_s / 1e4
    return f"{_three(percent / 100)} cores" if percent >= 199.95 else f"{_three(percent)} %{of}"


def mbit(bytes_per_s: float) -> str:
    """A data rate: `48 Mbit/s`, `0.8 Mbit/s`."""
    rate_mbit = 8 * bytes_per_s / 1e6
    return f"{rate_mbit:.0f} Mbit/s" if rate_mbit >= 10 else f"{rate_mbit:.2g} Mbit/s"


def clock_time(time_s: float) -> str:
    """The local time of day of seconds since 1970: `14:03:59`."""
    return time.strftime("%H:%M:%S", time.localtime(time_s))


def exact_clock_time(time_ns: int) -> str:
    """The local time of day of nanoseconds since 1970, with milliseconds: `14:03:59.042`."""
    return f"{clock_time(time_ns / 1e9)}.{time_ns // 1_000_000 % 1000:03}"


def _short(value: float) -> str:
    """Two figures, or all those before the point: `0.81`, `0.8`, `2.5`, `12`, `120`."""
    return f"{value:.0f}" if abs(value) >= 9.95 else f"{value:.2g}"


def _three(value: float) -> str:
    """Three figures, or all those before the point, without an exponent: `0.0764`, `12.3`, `1234`."""
    if value == 0:
        return "0"
    places = max(0, 2 - math.floor(math.log10(abs(value))))
    text = f"{value:.{places}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


def _two(seconds: float, large_s: int, large: str, small_s: int, small: str) -> str:
    """A whole number of the large unit, and the remainder as a whole number of the small one."""
    left = int(seconds % large_s // small_s)
    return f"{int(seconds // large_s)} {large}" + (f" {left} {small}" if left else "")
