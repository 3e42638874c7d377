"""Units and targets that speak with programs outside of a run, by whatever protocol: what they share."""
