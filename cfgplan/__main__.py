"""`python -m cfgplan`: the command line."""

import sys

from cfgplan.cli import main

if __name__ == "__main__":
    sys.exit(main())
