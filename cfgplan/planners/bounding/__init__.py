"""Lower bounds on a plan's cost by landmarks: every plan contains at least one label of a landmark, or several.

`landmarks` finds them, `bounds` charges them with their members' costs and decides when to stop. `branching` is a
search that branches over landmarks on plain lists. `disjoint` needs no landmarks: it adds up disjoint parts of a plan.
`contraction` joins labels that are used only together into one part; the solver chooses among the parts.
"""
