"""The world under test is a folder of unit code, not an installed package."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parents[2] / "models" / "fleet"))
