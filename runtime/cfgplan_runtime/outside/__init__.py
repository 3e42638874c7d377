"""Shared code of units and targets that speak with programs outside of a run."""
