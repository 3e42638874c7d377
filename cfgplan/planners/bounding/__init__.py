"""Lower bounds on a plan's cost by landmarks: every plan contains at least one label of a landmark, or several.

`landmarks` finds them, `bounds` charges them with their members' costs and decides when to stop. `branching` is a
search that branches over landmarks on plain lists. `disjoint` needs no landmarks: it adds up disjoint parts of a plan.
`contraction` makes one part of labels that are used only together, and has the solver choose among the parts.
"""
