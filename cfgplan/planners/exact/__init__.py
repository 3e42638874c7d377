"""The exact planner: bounds and a first plan from arrays, then CP-SAT with lazily added groundedness.

Begin with `session`, which says what is done when; `fleet` does it where more is asked than in the paper. What is
known on the way is in `standing`, `structure`, `prepared` and `rest`. `candidates` are the units that a plan may have,
`model` has their booleans, `rules` what these must be, and `search` solves that. Where nothing more than labels has to
be chosen `deciding` needs no model. The rooms `networks`, `bounding`, `closing`, `solving` can be read by themselves.
"""
