"""The problem without the parts that no plan can use, and without the keys that can't matter."""
