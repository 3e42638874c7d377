"""What a plan can be made of, and what it costs.

`keys` compares plans. Bounds forget who feeds whom: in a `network` labels (transformations) have weights, and need and
give facts (sets of those who may feed the same inputs), as arrays (`core`). `greedy` makes plans of labels.
"""
