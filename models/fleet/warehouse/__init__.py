"""A simulated warehouse: moving crates, two robots that look at them, their pictures, and the map."""
