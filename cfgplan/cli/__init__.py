"""The command line: it parses, calls, prints and exits; nothing else in cfgplan prints."""

import gc
import os

gc.set_threshold(200_000)  # a short command makes no garbage worth a search, nor do the imports of a planner

try:
    from cfgplan.cli.main import main
except KeyboardInterrupt:
    # Nothing is there yet that would have to be cleared away.
    os._exit(130)

__all__ = ["main"]
