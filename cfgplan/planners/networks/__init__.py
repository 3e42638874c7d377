"""The parts of a plan and their costs, as seen by bounds.

`keys` compares plans. Bounds ignore which unit feeds which: in a `network` labels (transformations) have weights, and
need and give facts (sets of labels that may feed the same inputs), as arrays (`core`). `greedy` makes plans of labels.
"""
