"""The command line: it parses, calls, prints and exits; nothing else in cfgplan prints."""

from cfgplan.cli.main import main

__all__ = ["main"]
