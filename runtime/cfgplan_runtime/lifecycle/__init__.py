"""The configuration life-cycle: perturbations, reviews, and the manager that goes from the one to the other."""
