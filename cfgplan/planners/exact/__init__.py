"""The exact planner: bounds and a first plan from arrays, then CP-SAT with lazily added groundedness.

Begin with `session`, which lists the stages; `fleet` has them for problems that ask more than the paper. `standing`,
`structure`, `prepared` and `rest` hold what is known on the way. `candidates` are the units that a plan may have,
`model` has their booleans, `rules` what these must be, and `search` solves that. `deciding` needs no model: it searches
where only labels have to be chosen. The rooms `networks`, `bounding`, `closing`, `solving` can be read by themselves.
"""
