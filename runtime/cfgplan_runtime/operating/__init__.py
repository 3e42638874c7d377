"""A run in operation: the control socket, what is shown of it, and its recording."""

import sys

if sys.platform == "win32":
    from cfgplan_runtime.errors import UnsupportedPlatformError

    raise UnsupportedPlatformError("running needs Linux or macOS; on Windows use WSL")
