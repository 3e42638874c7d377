"""What planners that call CP-SAT share: the clock, one run of the engine, who supports whom."""
