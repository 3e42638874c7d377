"""The exact planner: bounds and a first plan from arrays, then CP-SAT with lazily added groundedness.

Begin with `session`, then `stages`, the list of steps; `fleet` has the stages for problems beyond the paper. `memory`
is kept between the plans of a session, `solve_run` is the work on one plan, `solve_state` its incumbent and proven
bounds. `candidates` are the units that a plan may have, `model` has their booleans, `rules` lists the constraints on
them, and `search` solves the model. `stages` first searches without a model if only labels have to be chosen. The rooms
`networks`, `bounding`, `closing`, `solving` can be read by themselves.
"""
