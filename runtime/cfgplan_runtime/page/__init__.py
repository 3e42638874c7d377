"""A control room for a run, served to browsers: health, figures, the picture of units, peeks, reviews, what-if."""
