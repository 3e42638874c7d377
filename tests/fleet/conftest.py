"""The world under test is a folder of unit code, and the network that of an experiment; neither is installed."""

import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
sys.path += [str(ROOT / "models" / "fleet"), str(ROOT / "experiments" / "fleet")]
