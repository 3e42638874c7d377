"""The small worlds of the planners' tests are good for explanations too."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1] / "planners"))
