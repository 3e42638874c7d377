"""How sessions of Zenoh are opened to be among ROS 2 nodes: as `rmw_zenoh` does, by the same variables."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

from cfgplan.errors import InputError

if TYPE_CHECKING:
    import zenoh

USUAL_ROUTER: Final = "tcp/localhost:7447"
_MOST_DOMAIN = 232
_USUAL: Final = {
    "mode": "peer",
    "connect": {"endpoints": [USUAL_ROUTER], "timeout_ms": -1, "exit_on_failure": False},
    "listen": {"endpoints": ["tcp/localhost:0"]},
    "scouting": {
        "multicast": {"enabled": False},
        "gossip": {"enabled": True, "target": ["router"], "autoconnect_strategy": {"to_peer": "greater-zid"}},
    },
    "timestamping": {"enabled": True},
    "transport": {"shared_memory": {"enabled": False}},
}


def zenoh_config(connect: Sequence[str] = ()) -> zenoh.Config:
    """How a session is opened. Its router is at `connect`, or else where the variables say, or on this computer.

    Raises InputError for variables that can't be used.
    """
    import zenoh

    told = os.environ.get("ZENOH_SESSION_CONFIG_URI")
    try:
        if told:
            config = zenoh.Config.from_file(told.removeprefix("file://"))
        else:
            config = zenoh.Config.from_json5(json.dumps(_USUAL))
        if connect:
            config.insert_json5("connect/endpoints", json.dumps(list(connect)))
        for part in filter(None, os.environ.get("ZENOH_CONFIG_OVERRIDE", "").split(";")):
            key, _, value = part.partition("=")
            config.insert_json5(key.strip(), value.strip())
    except zenoh.ZError as error:
        mend = "see ZENOH_SESSION_CONFIG_URI (a file of Zenoh's) and ZENOH_CONFIG_OVERRIDE (key=value;key=value)"
        raise InputError.of(f"Zenoh can't be configured: {first_line(error)}", mend=mend) from None
    return config


def ros_domain(given: int | None = None) -> int:
    """The domain of ROS 2, that of ROS_DOMAIN_ID if none is given. Raises InputError."""
    told = os.environ.get("ROS_DOMAIN_ID") or "0" if given is None else str(given)
    if not told.isdecimal() or int(told) > _MOST_DOMAIN:
        raise InputError.of(f"`{told}` is no domain of ROS 2", mend=f"it is a number from 0 to {_MOST_DOMAIN}")
    return int(told)


def first_line(error: Exception) -> str:
    """What Zenoh says is wrong, without where in its own code it was noticed."""
    return str(error).strip().partition("\n")[0].partition(" at /")[0]
