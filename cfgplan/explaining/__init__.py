"""Answers that people can act on: why there is no plan, why this one, and what else there is."""
