"""What a plan can be made of, and what it costs.

`keys` compares plans. Bounds forget who feeds whom: in a `network` labels (transformations) need and give facts (sets
of those who may feed the same inputs), in arrays (`core`, `crowds`). `weighing` says what a label weighs, `greedy`
makes plans of labels.
"""
