"""The command line: it parses, calls, prints and exits; nothing else in cfgplan prints."""

import os

try:
    from cfgplan.cli.main import main
except KeyboardInterrupt:
    # Nothing is there yet that would have to be cleared away.
    os._exit(130)

__all__ = ["main"]
