"""What units are observed to cost, and what they are expected to cost (paper, section IV-C)."""
