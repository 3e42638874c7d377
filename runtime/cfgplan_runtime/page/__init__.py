"""A page about a run, served to browsers: what runs and how fast, drawn anew as it changes, and buttons to steer it."""
