"""States on their way from one unit to the next."""

from __future__ import annotations

import time
from typing import Any

from cfgplan_runtime import Runtime


def delay_states(runtime: Runtime) -> None:
    """Let each state that is handed over be under way for a while, in which elements come."""
    backend = runtime.supervisor.backend
    give_state = backend.give_state

    def give(*given: Any) -> None:
        time.sleep(0.1)
        give_state(*given)

    backend.give_state = give  # type: ignore[method-assign]
