"""Shared by planners that call CP-SAT: the clock, one run of the engine, who supports whom."""
