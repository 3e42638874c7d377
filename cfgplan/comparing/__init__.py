"""Planners side by side on one problem: each runs in a process of its own, is judged, and compared with the others."""

from cfgplan.comparing.entrants import REGISTERED, Entrant, entrant
from cfgplan.comparing.runs import Limits, Run, RunFailure, contradictions, run_one

__all__ = ["REGISTERED", "Entrant", "Limits", "Run", "RunFailure", "contradictions", "entrant", "run_one"]
