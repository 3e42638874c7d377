"""A warehouse with crates that move about and two robots that look at them: the truth, the pictures, and the map."""
