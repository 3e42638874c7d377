"""Carries out cfgplan's plans: units are processes, and change sets are applied without a gap in the streams.

import cfgplan_runtime

for received in cfgplan_runtime.subscribe("/result"):
    print(received.value)
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

from cfgplan.exports import exports

if TYPE_CHECKING:
    from cfgplan_runtime.children.unit_code import At as At
    from cfgplan_runtime.children.unit_code import WithQuality as WithQuality
    from cfgplan_runtime.errors import ApplyError as ApplyError
    from cfgplan_runtime.errors import NoSuchTopicError as NoSuchTopicError
    from cfgplan_runtime.errors import RuntimeFaultError as RuntimeFaultError
    from cfgplan_runtime.errors import StaleChangeSetError as StaleChangeSetError
    from cfgplan_runtime.lifecycle.file_watch import watch_file as watch_file
    from cfgplan_runtime.lifecycle.manager import Manager as Manager
    from cfgplan_runtime.lifecycle.policy import Policy as Policy
    from cfgplan_runtime.runtime import Runtime as Runtime
    from cfgplan_runtime.runtime import SimulatedRuntime as SimulatedRuntime
    from cfgplan_runtime.streams.subscription import Received as Received
    from cfgplan_runtime.streams.subscription import subscribe as subscribe
    from cfgplan_runtime.supervision.events import Applied as Applied
    from cfgplan_runtime.supervision.events import InputLost as InputLost
    from cfgplan_runtime.supervision.events import UnitDied as UnitDied
    from cfgplan_runtime.supervision.observation import Observation as Observation
    from cfgplan_runtime.supervision.simulated_backend import SimulatedBackend as SimulatedBackend
    from cfgplan_runtime.supervision.supervisor import Supervisor as Supervisor
    from cfgplan_runtime.supervision.updates import Patience as Patience
    from cfgplan_runtime.supervision.wiring import wanted_feeds as wanted_feeds

__all__, _exported, __dir__ = exports(
    __name__,
    {
        "supervision.updates": "Patience",
        "supervision.events": "Applied InputLost UnitDied",
        "supervision.observation": "Observation",
        "errors": "ApplyError NoSuchTopicError RuntimeFaultError StaleChangeSetError",
        "lifecycle.manager": "Manager",
        "lifecycle.policy": "Policy",
        "lifecycle.file_watch": "watch_file",
        "runtime": "Runtime SimulatedRuntime",
        "supervision.simulated_backend": "SimulatedBackend",
        "streams.subscription": "Received subscribe",
        "supervision.supervisor": "Supervisor",
        "supervision.wiring": "wanted_feeds",
        "children.unit_code": "At WithQuality",
    },
)


def __getattr__(name: str) -> Any:
    """Import a name from its module at its first use. Raises UnsupportedPlatformError on Windows."""
    if sys.platform == "win32" and name in ("Runtime", "subscribe"):
        from cfgplan_runtime.errors import UnsupportedPlatformError

        raise UnsupportedPlatformError(
            "the runtime needs Linux or macOS: Windows can't hand open sockets to processes this way; use WSL"
        )
    return _exported(name)
