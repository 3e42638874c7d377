"""A run in operation: its control socket, its recording and its metrics."""

import sys

if sys.platform == "win32":
    from cfgplan_runtime.errors import UnsupportedPlatformError

    raise UnsupportedPlatformError("running needs Linux or macOS; on Windows use WSL")
