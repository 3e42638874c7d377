"""The exact planner: bounds and a first plan from arrays, then CP-SAT with lazily added groundedness.

Begin with `session`, then `stages`, the list of what is done; `fleet` has the stages for what asks more than the paper.
`memory` is what a session keeps between plans, `work` what one plan works on, `standing` what is proven so far.
`candidates` are the units that a plan may have, `model` has their booleans, `rules` lists what these must be, and
`search` solves that. `stages` first searches without a model where only labels have to be chosen. The rooms
`networks`, `bounding`, `closing`, `solving` can be read by themselves.
"""
