"""Estimates of the costs of units, learned from observations (paper, section IV-C)."""
