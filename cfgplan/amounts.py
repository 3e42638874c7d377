"""Figures as people say them: times, rates, shares of a core, sizes, hours of the day. For all that shows figures."""

from __future__ import annotations

import time

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
    """How often something comes: `100 Hz`, `2.5 Hz`, `every 8 s`; `never` for 0."""
    if hertz <= 0:
        return "never"
    return f"{_short(hertz)} Hz" if hertz >= 0.95 else f"every {span(1 / hertz)}"


def core_share(cpu_us_per_s: float) -> str:
    """CPU time per second of time, in microseconds, as a share of a core: `5 % of a core`, `2.3 cores`."""
    percent = cpu_us_per_s / 1e4
    return f"{percent / 100:.1f} cores" if percent >= 199.5 else f"{_short(percent)} % of a core"


def clock_time(time_s: float) -> str:
    """The local time of day of seconds since 1970: `14:03:59`."""
    return time.strftime("%H:%M:%S", time.localtime(time_s))


def _short(value: float) -> str:
    """Two figures, or all those before the point: `0.81`, `0.8`, `2.5`, `12`, `120`."""
    return f"{value:.0f}" if abs(value) >= 9.95 else f"{value:.2g}"


def _two(seconds: float, large_s: int, large: str, small_s: int, small: str) -> str:
    """A whole number of the large unit, with what is left in the small one."""
    left = int(seconds % large_s // small_s)
    return f"{int(seconds // large_s)} {large}" + (f" {left} {small}" if left else "")
