"""What a plan can be made of, and what it costs.

`site` has the candidate units and who may feed whom, `wiring` wires chosen ones, `quality` compares plans.
Bounds forget who feeds whom: in a `network` labels (transformations) need and give facts (sets of those who may feed
the same inputs), in arrays (`core`, `crowds`). `weighing` says what a label weighs, `greedy` makes plans of labels.
"""
