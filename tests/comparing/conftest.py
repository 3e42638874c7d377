"""The peers live in `experiments/`, beside the package; small worlds are drawn by `tests/planners/worlds.py`."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1] / "planners"))
