"""The configuration life-cycle: perturbations, reviews, and the manager that answers perturbations by reviews."""
