"""The command line: it parses, calls, prints and exits; nothing else in cfgplan prints."""

try:
    from cfgplan.cli.main import main
except KeyboardInterrupt:
    raise SystemExit(130) from None

__all__ = ["main"]
